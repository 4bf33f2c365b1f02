"""Select the observations that are sent as digests, because no rule looks at their pixels, and digest them."""

from __future__ import annotations

from typing import Any

import numpy as np
import xxhash
from envcraft_protocol.adapters import contiguous, resized
from envcraft_protocol.jobs import Job, Pictures
from envcraft_protocol.wire import LONG, MAX_OBSERVATION, array_identity, is_shown
from numpy.typing import NDArray

_UINT8 = np.dtype(np.uint8)
_NO_PICTURES: Pictures = {"first": 0, "every": 1, "until": -1}
#: Bytes from which on a frame is read in its memory order. A copy in the other order takes as long as a step of a game.
_LONG_FRAME = 64 * 1024
# Bound before any untrusted module can replace them.
_digest, _seed = xxhash.xxh3_128_digest, xxhash.xxh3_64_intdigest
_is_shown, _resized, _contiguous, _as_array = is_shown, resized, contiguous, np.asarray
_Array, _issubclass = np.ndarray, issubclass


class Frames:
    """A job's settings for frames, see :class:`envcraft_protocol.jobs.Job`."""

    def __init__(self, job: Job | None = None) -> None:
        contract = job["contract"] if job is not None and "contract" in job else {}
        size = (contract.get("adapter") or {}).get("resize")
        self._size: tuple[int, int] | None = (size[0], size[1]) if size else None
        self._shape = tuple(job["frame"]) if job is not None and "frame" in job else None
        self._pictures = job.get("pictures", _NO_PICTURES) if job is not None else _NO_PICTURES
        self._columns = job.get("columns") if job is not None else None

    def layout(self, value: Any) -> tuple[dict[str, Any], int, bool] | None:
        """Return the layout of an observation that is sent as a digest, the digest's seed, and whether its columns are
        read. Return None for any other observation.
        """
        if not is_long_frame(value):
            return None
        if self._shape is None or not (value.shape == self._shape if self._size is None else self._is_resized(value)):
            return None
        columns = None
        if value.nbytes >= _LONG_FRAME and value.ndim == 3:
            if self._columns is None:
                self._columns = not value.flags.c_contiguous and value.transpose(1, 0, 2).flags.c_contiguous
            columns = self._columns
        return describe(value, columns)

    def is_resized(self, value: Any) -> bool:
        """Whether an agent sees a resized copy of a value."""
        return self._size is not None and _issubclass(type(value), _Array) and self._is_resized(value)

    def adapted(self, value: Any) -> Any:
        """Return a value as an agent sees it."""
        return value if self._size is None else _resized(value, *self._size)

    def picture(self, frame: Any, number: int) -> bytes:
        """Return observation `number` as an agent sees it, or no bytes if the host does not need its picture."""
        if not _is_shown(self._pictures, number):
            return b""
        return _as_array(self.adapted(frame)).tobytes()

    def _is_resized(self, value: NDArray[Any]) -> bool:
        return value.dtype == _UINT8 and value.ndim == 3 and value.shape[2] == 3


def is_long_frame(value: Any) -> bool:
    """Whether a value is an array of uint8 that is long enough for a digest. Its `__class__` is only a claim."""
    return _issubclass(type(value), _Array) and value.dtype == _UINT8 and LONG <= value.nbytes <= MAX_OBSERVATION


def describe(value: NDArray[Any], columns: bool | None = None) -> tuple[dict[str, Any], int, bool]:
    """Return the layout of a frame, the digest's seed, and whether its columns are read. A short frame has no order."""
    shape = tuple(map(int, value.shape))
    layout: dict[str, Any] = {"k": "frame", "dtype": "|u1", "shape": list(shape)}
    if columns is not None:
        layout["columns"] = columns
    return layout, _seed(array_identity("uint8", shape)), bool(columns)


def digest(frame: NDArray[Any], seed: int, columns: bool) -> bytes:
    """Return the digest of a frame, without a copy if its rows or `columns` are contiguous."""
    if columns:
        frame = frame.transpose(1, 0, 2)
    lying: Any = frame if frame.flags.c_contiguous else _contiguous(frame)
    digest: bytes = _digest(lying, seed)
    return digest
