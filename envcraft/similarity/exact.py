"""The layer ``exact``: the same text, but for what says nothing to Python.

Two sources are the same here if they have the same tokens in the same statements. Comments, docstrings, blank lines,
trailing space, the width of indents and the breaks within a statement make no difference; every name and every constant
does. What is no Python text is compared byte by byte.
"""

from __future__ import annotations

import hashlib

from .reading import read_tokens

#: Of the keys: another one makes those that were kept worthless.
VERSION = 1


def key(source: bytes) -> bytes:
    """The key of a source, 16 bytes."""
    tokens = read_tokens(source)
    parts = b"bytes\0" + source if tokens is None else b"tokens\0" + "\0".join(tokens).encode("utf-8", "surrogatepass")
    return hashlib.blake2b(parts, digest_size=16).digest()
