"""Where a replay keeps its frames: raw or packed, in memory or in a mapped file, or on the device that learns.

Each store has numbered slots for one frame; what was written into a slot is there until it is written again.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft_dqn import codec

Frames = NDArray[np.uint8]
Slots = NDArray[np.int64]
#: Bytes of a packed frame on average, for which there is room; what goes beyond is kept apart.
MEAN = 768


class FrameStore(Protocol):
    """Slots for frames of one shape."""

    shape: tuple[int, ...]

    def write(self, slots: Slots, frames: Frames) -> None:
        """Keep `frames`, [n, *shape], in `slots`, no two of which are the same."""

    def read(self, slots: Slots) -> Any:
        """The frames in `slots`, [n, *shape]: an array that the next call may overwrite, or a tensor."""

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        """What is in the slots from `first` to before `end`, as arrays."""

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        """Put back what :meth:`dump` gave."""

    @property
    def nbytes(self) -> int:
        """Bytes that all slots take, those of frames kept apart included."""


class RawFrames:
    """Frames as they are, in memory, or in the file `path`, which is overwritten."""

    def __init__(self, size: int, shape: tuple[int, ...], path: Path | None = None) -> None:
        self.shape = shape
        self._frames: Frames = (
            np.zeros((size, *shape), np.uint8)
            if path is None
            else np.memmap(path, np.uint8, "w+", shape=(size, *shape))
        )
        self._buffers: dict[int, Frames] = {}

    def write(self, slots: Slots, frames: Frames) -> None:
        self._frames[slots] = frames

    def read(self, slots: Slots) -> Frames:
        buffer = _buffer(self._buffers, len(slots), self.shape)
        return np.take(self._frames, slots, axis=0, out=buffer, mode="clip")

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        return {"frames": np.asarray(self._frames[first:end])}

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        self._frames[first : first + len(arrays["frames"])] = arrays["frames"]

    @property
    def nbytes(self) -> int:
        return int(self._frames.nbytes)


class PackedFrames:
    """Frames encoded by :mod:`envcraft_dqn.codec` in an arena; those that it leaves out, compressed by Zstandard,
    apart.
    """

    def __init__(self, size: int, shape: tuple[int, ...], mean: int = MEAN) -> None:
        import zstandard

        if len(shape) != 3 or shape[2] != 3 or max(shape) > codec.LONGEST:
            raise UsageError(f"frames of shape {shape} cannot be packed: keep them with --replay ram or mapped")
        self.shape: tuple[int, ...] = shape
        self._arena = codec.Arena(size, mean)
        self._apart: dict[int, bytes] = {}
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._decompressor = zstandard.ZstdDecompressor()
        self._buffers: dict[int, Frames] = {}

    def write(self, slots: Slots, frames: Frames) -> None:
        self._arena.write(slots, frames)
        lengths = self._arena.lengths[slots]
        if self._apart or not lengths.all():
            for slot, length, frame in zip(slots.tolist(), lengths.tolist(), frames, strict=True):
                self._apart.pop(slot, None)
                if not length:
                    self._apart[slot] = self._compressor.compress(np.ascontiguousarray(frame).tobytes())

    def read(self, slots: Slots) -> Frames:
        buffer = _buffer(self._buffers, len(slots), self.shape)
        self._arena.read(slots, buffer)
        for at in np.flatnonzero(self._arena.lengths[slots] == 0) if self._apart else ():
            data = self._decompressor.decompress(self._apart[int(slots[at])])
            buffer[at] = np.frombuffer(data, np.uint8).reshape(self.shape)
        return buffer

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        apart = [self._apart.get(slot, b"") for slot in range(first, end)]
        return {
            "encoded": self._arena.dump(first, end),
            "lengths": self._arena.lengths[first:end],
            "apart": np.frombuffer(b"".join(apart), np.uint8),
            "apart_lengths": np.array([len(data) for data in apart], np.int64),
        }

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        self._arena.load(first, arrays["lengths"], arrays["encoded"])
        apart = arrays["apart"].tobytes()
        ends = np.cumsum(arrays["apart_lengths"]).tolist()
        for slot, begin, stop in zip(itertools.count(first), [0, *ends], ends, strict=False):
            self._apart.pop(slot, None)
            if stop > begin:
                self._apart[slot] = apart[begin:stop]

    @property
    def nbytes(self) -> int:
        return self._arena.nbytes + sum(len(data) for data in self._apart.values())


class DeviceFrames:
    """Frames as they are, in the memory of the device that learns: reading them copies nothing to it."""

    def __init__(self, size: int, shape: tuple[int, ...], device: Any) -> None:
        import torch

        self.shape = shape
        self._frames = torch.zeros((size, *shape), dtype=torch.uint8, device=device)

    def write(self, slots: Slots, frames: Frames) -> None:
        import torch

        device = self._frames.device
        self._frames[torch.from_numpy(slots).to(device)] = torch.from_numpy(np.ascontiguousarray(frames)).to(device)

    def read(self, slots: Slots) -> Any:
        import torch

        return self._frames[torch.from_numpy(slots).to(self._frames.device)]

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        return {"frames": self._frames[first:end].cpu().numpy()}

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        import torch

        self._frames[first : first + len(arrays["frames"])] = torch.from_numpy(arrays["frames"]).to(self._frames.device)

    @property
    def nbytes(self) -> int:
        return int(self._frames.nbytes)


def make_store(kind: str, size: int, shape: tuple[int, ...], folder: Path, device: Any) -> FrameStore:
    """The store ``packed``, ``ram``, ``mapped`` (a file in `folder`) or ``device``. Raises UsageError, OSError."""
    if kind == "packed":
        return PackedFrames(size, shape)
    if kind == "mapped":
        return RawFrames(size, shape, folder / "frames.bin")
    if kind == "device":
        return DeviceFrames(size, shape, device)
    if kind == "ram":
        return RawFrames(size, shape)
    raise UsageError(f"there is no replay {kind!r}; there are packed, ram, mapped, device")


def _buffer(known: dict[int, Frames], count: int, shape: tuple[int, ...]) -> Frames:
    # A new array of this size has to be fetched from the system page by page, each time.
    if count not in known:
        known.clear()
        known[count] = np.empty((count, *shape), np.uint8)
    return known[count]
