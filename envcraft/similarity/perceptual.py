"""Perceptual hashes of 64 bits: similar frames have similar hashes.

A picture is converted to grey and resized to 32x32 by area. Each bit says whether one of the 8x8 lowest frequencies of
its cosine transform is above their median (pHash [1]_). Half of the bits are ones in every hash, so frames of different
games differ in about 32 bits even if both are mostly black. Hashes of brightness would agree there.

.. [1] Zauner, Implementation and benchmarking of perceptual image hash functions, 2010.
"""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: The hash of a picture without contrast, such as a black one.
BLANK = 0
#: A range of grey levels, of 256, below which a picture counts as blank.
_CONTRAST = 4.0
_GREY = np.array([0.299, 0.587, 0.114], np.float32)
_SIDE, _LOW = 32, 8


def frame_hash(frame: NDArray[np.uint8]) -> int:
    """The hash of a picture of shape ``(H, W)``, ``(H, W, 1)`` or ``(H, W, 3)``; :data:`BLANK` without contrast."""
    grey = frame @ _GREY if frame.ndim == 3 and frame.shape[2] == 3 else frame.reshape(frame.shape[:2])
    if float(grey.max()) - float(grey.min()) < _CONTRAST:
        return BLANK
    low = _projection(grey.shape[0]) @ grey.astype(np.float32, copy=False) @ _projection(grey.shape[1]).T
    # Frequencies that are zero in symmetric pictures have rounding noise.
    low = np.round(low.ravel(), 2)
    bits = np.packbits(low > np.median(low))
    return int.from_bytes(bits.tobytes(), "big") or 1


def value_hash(value: Any) -> int:
    """The hash of any other observation: equal if its numbers are equal to about three digits."""
    digest = hashlib.blake2b(digest_size=8)
    _feed(digest, value)
    return int.from_bytes(digest.digest(), "big") or 1


def _feed(digest: hashlib.blake2b, value: Any) -> None:
    if isinstance(value, dict):
        for key in sorted(value):
            digest.update(str(key).encode("utf-8", "surrogatepass"))
            _feed(digest, value[key])
    elif isinstance(value, tuple | list):
        for item in value:
            _feed(digest, item)
    elif isinstance(value, np.ndarray | np.generic) and value.dtype.kind == "f":
        with np.errstate(over="ignore"):
            # Adding 0 turns -0.0 into 0.0.
            digest.update((np.asarray(value).astype("<f2") + np.float16(0)).tobytes())
    elif isinstance(value, np.ndarray | np.generic):
        digest.update(value.tobytes())
    else:
        digest.update(repr(value).encode("utf-8", "surrogatepass"))


@cache
def _projection(length: int) -> NDArray[np.float32]:
    """The matrix, shape ``(8, length)``, that maps one axis to its lowest frequencies after an area resize."""
    edges = np.linspace(0, length, _SIDE + 1)
    pixel = np.arange(length)
    overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    resize = np.clip(overlap, 0, None) * _SIDE / length
    frequency, place = np.arange(_LOW)[:, None], np.arange(_SIDE)
    cosine = np.cos(np.pi * frequency * (2 * place + 1) / (2 * _SIDE))
    return np.asarray(cosine @ resize, np.float32)
