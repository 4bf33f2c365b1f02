"""The untrusted side: a fork server that runs one job at a time, each in one child.

The host trusts nothing that comes from here. These modules import Python, NumPy, Gymnasium and ``envcraft_protocol``.
"""
