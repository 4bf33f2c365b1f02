"""The untrusted side: a fork server that runs one job, in one child, at a time.

Nothing here is believed by the host. These modules need Python, NumPy and Gymnasium and nothing else of EnvCraft.
"""
