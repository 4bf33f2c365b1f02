"""Drivers that put a worker behind isolation, and the worker itself (:mod:`envcraft_sandbox.worker`).

Importing this package costs nothing: the worker is started with ``python -m envcraft_sandbox.worker`` inside a
sandbox that has no ``envcraft``.
"""
