"""What makes an environment of a class: one implementation for the worker, where it is judged, and for wherever it is
used afterwards, so that what is used is what was judged.

NumPy and Gymnasium only: the worker imports it inside the sandbox, and exported packages carry a copy.
"""
