"""What both sides of the trust boundary import: the messages between host and worker, the limits that both enforce, and
how an environment is made from a class, adapted to its contract and described.

Host and worker share one implementation, so a user gets the environment that was judged. The package imports only
NumPy, Gymnasium, Pillow and the standard library: the worker loads it inside the sandbox, and exported packages contain
a copy.
"""
