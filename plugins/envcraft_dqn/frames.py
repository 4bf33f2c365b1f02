"""Storage for the frames of a replay: raw or compressed, in memory, in a mapped file, or on the learning device.

A store has numbered slots for one frame each. A slot keeps its frame until it is written again.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError

Frames = NDArray[np.uint8]
Slots = NDArray[np.int64]
#: Bytes per object and per reference of CPython, which a compressed frame takes besides its data.
_OVERHEAD = 33 + 8


class FrameStore(Protocol):
    """Slots for frames of one shape."""

    shape: tuple[int, ...]

    def write(self, slots: Slots, frames: Frames) -> None:
        """Store `frames` [n, *shape] in distinct `slots` [n]."""

    def read(self, slots: Slots) -> Any:
        """The frames in `slots`, [n, *shape]: a tensor, or an array that the next call may overwrite."""

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        """The contents of the slots from `first` up to `end`, as named arrays."""

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore what :meth:`dump` returned."""

    @property
    def nbytes(self) -> int:
        """The size of the store in bytes."""


class RawFrames:
    """Uncompressed frames, in memory or in the file `path`, which is overwritten."""

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


class CompressedFrames:
    """Frames in memory, each compressed by Zstandard."""

    def __init__(self, size: int, shape: tuple[int, ...]) -> None:
        import zstandard

        self.shape = shape
        self._data: list[bytes] = [b""] * size
        self._compressor = zstandard.ZstdCompressor()
        self._decompressor = zstandard.ZstdDecompressor()
        self._buffers: dict[int, Frames] = {}

    def write(self, slots: Slots, frames: Frames) -> None:
        for slot, frame in zip(slots.tolist(), np.ascontiguousarray(frames), strict=True):
            self._data[slot] = self._compressor.compress(frame.data)

    def read(self, slots: Slots) -> Frames:
        buffer = _buffer(self._buffers, len(slots), self.shape)
        for row, slot in zip(buffer.reshape(len(slots), -1), slots.tolist(), strict=True):
            row[:] = np.frombuffer(self._decompressor.decompress(self._data[slot]), np.uint8)
        return buffer

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        data = self._data[first:end]
        return {
            "zstd": np.frombuffer(b"".join(data), np.uint8),
            "zstd_lengths": np.array([len(one) for one in data], np.int64),
        }

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        if "encoded" in arrays:
            arrays = self._migrated(arrays)
        for slot, data in zip(itertools.count(first), _split(arrays["zstd"], arrays["zstd_lengths"]), strict=False):
            self._data[slot] = data

    def _migrated(self, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Convert a dump of version 0.1, which has palettes and runs, and Zstandard where these are longer."""
        from envcraft_dqn.palette import decode

        data = _split(arrays["apart"], arrays["apart_lengths"])
        for slot, encoded in enumerate(_split(arrays["encoded"], arrays["lengths"])):
            if encoded:
                data[slot] = self._compressor.compress(decode(np.frombuffer(encoded, np.uint8), self.shape).data)
        lengths = np.array([len(one) for one in data], np.int64)
        return {"zstd": np.frombuffer(b"".join(data), np.uint8), "zstd_lengths": lengths}

    @property
    def nbytes(self) -> int:
        return sum(map(len, self._data)) + _OVERHEAD * len(self._data)


class DeviceFrames:
    """Uncompressed frames in the memory of the learning device, so that reading needs no transfer."""

    def __init__(self, size: int, shape: tuple[int, ...], device: Any) -> None:
        import torch

        self.shape = shape
        try:
            self._frames = torch.zeros((size, *shape), dtype=torch.uint8, device=device)
        except RuntimeError:
            needed = size * math.prod(shape) / 1e9
            raise UsageError(
                f"--replay device needs {needed:,.1f} GB of free memory on {device}: use a smaller --capacity than "
                f"{size:,}, or --replay packed"
            ) from None

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
    """Make a frame store.

    Args:
        kind: ``packed`` (compressed), ``ram``, ``mapped`` (a file in `folder`) or ``device``.
        size: The number of slots.
        shape: The shape of a frame.
        folder: The folder of a mapped file.
        device: The learning device.

    Raises:
        UsageError: The kind does not exist, or the device has too little memory.
        OSError: The file cannot be written.
    """
    if kind == "packed":
        return CompressedFrames(size, shape)
    if kind == "mapped":
        return RawFrames(size, shape, folder / "frames.bin")
    if kind == "device":
        return DeviceFrames(size, shape, device)
    if kind == "ram":
        return RawFrames(size, shape)
    raise UsageError(f"unknown replay {kind!r}; choose from packed, ram, mapped, device")


def _split(data: NDArray[np.uint8], lengths: NDArray[Any]) -> list[bytes]:
    """Cut concatenated byte strings at their lengths."""
    ends = np.cumsum(lengths, dtype=np.int64).tolist()
    text = data.tobytes()
    return [text[start:end] for start, end in itertools.pairwise([0, *ends])]


def _buffer(known: dict[int, Frames], count: int, shape: tuple[int, ...]) -> Frames:
    # A new array of this size costs page faults on every call.
    if count not in known:
        known.clear()
        known[count] = np.empty((count, *shape), np.uint8)
    return known[count]
