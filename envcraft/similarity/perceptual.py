"""Perceptual hashes: 64 bits of what is to be seen in a frame, alike where frames look alike.

A picture is made grey and brought to 32x32 by area; of its cosine transform the 8x8 lowest frequencies are kept, and
each bit says whether one of them is above the median (pHash [1]_). Half of the bits are ones whatever is shown, so that
frames of different games differ in about 32 bits even if both are mostly black, where hashes of brightness itself would
agree.

.. [1] Zauner, Implementation and benchmarking of perceptual image hash functions, 2010.
"""

from __future__ import annotations

import hashlib
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What stands for a picture without contrast, such as a black one.
BLANK = 0
#: Levels of grey, of 256, between which nothing is seen.
_CONTRAST = 4.0
_GREY = np.array([0.299, 0.587, 0.114], np.float32)
_SIDE, _LOW = 32, 8


def frame_hash(frame: NDArray[np.uint8]) -> int:
    """Of a picture, shape ``(H, W)``, ``(H, W, 1)`` or ``(H, W, 3)``; :data:`BLANK` where it shows nothing."""
    grey = frame @ _GREY if frame.ndim == 3 and frame.shape[2] == 3 else frame.reshape(frame.shape[:2])
    if float(grey.max()) - float(grey.min()) < _CONTRAST:
        return BLANK
    low = _projection(grey.shape[0]) @ grey.astype(np.float32, copy=False) @ _projection(grey.shape[1]).T
    # Symmetric pictures have frequencies that are zero but for noise.
    low = np.round(low.ravel(), 2)
    bits = np.packbits(low > np.median(low))
    return int.from_bytes(bits.tobytes(), "big") or 1


def value_hash(value: Any) -> int:
    """Of an observation that is no picture: equal where its numbers are, to about three digits."""
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
            # Adding makes one zero of two.
            digest.update((np.asarray(value).astype("<f2") + np.float16(0)).tobytes())
    elif isinstance(value, np.ndarray | np.generic):
        digest.update(value.tobytes())
    else:
        digest.update(repr(value).encode("utf-8", "surrogatepass"))


@cache
def _projection(length: int) -> NDArray[np.float32]:
    """What brings one axis to its lowest frequencies, shape ``(8, length)``: area resize, then the cosine transform."""
    edges = np.linspace(0, length, _SIDE + 1)
    pixel = np.arange(length)
    overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    resize = np.clip(overlap, 0, None) * _SIDE / length
    frequency, place = np.arange(_LOW)[:, None], np.arange(_SIDE)
    cosine = np.cos(np.pi * frequency * (2 * place + 1) / (2 * _SIDE))
    return np.asarray(cosine @ resize, np.float32)
