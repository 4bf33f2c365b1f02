"""The layer ``exact``: the same tokens.

Two sources are equal in this layer if they have the same tokens in the same statements. Comments, docstrings, blank
lines, trailing spaces, the width of indents and line breaks within a statement do not count; every name and every
constant does. Sources that cannot be tokenised are compared byte by byte.
"""

from __future__ import annotations

import hashlib

from envcraft.similarity.reading import read_tokens

#: Version of the keys. A new version invalidates stored keys.
VERSION = 1


def key(source: bytes) -> bytes:
    """The key of a source, 16 bytes."""
    tokens = read_tokens(source)
    parts = b"bytes\0" + source if tokens is None else b"tokens\0" + "\0".join(tokens).encode("utf-8", "surrogatepass")
    return hashlib.blake2b(parts, digest_size=16).digest()
