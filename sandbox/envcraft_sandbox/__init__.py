"""Sandbox drivers, and the worker that runs inside a sandbox (:mod:`envcraft_sandbox.worker`).

The import of this package costs nothing: drivers start the worker with ``python -m envcraft_sandbox.worker`` inside a
sandbox that has no ``envcraft``.
"""
