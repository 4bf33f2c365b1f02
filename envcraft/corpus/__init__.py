"""Corpora: folders with thousands of environments and every verdict on them, judged anew only where something changed.

Imported only by the commands that need it.
"""
