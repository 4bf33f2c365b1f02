"""The frames of a recording in one file that is mapped into memory: each frame once, compressed by itself.

A file is a magic number, the length of a header and the header (JSON), then arrays and the frames, all little-endian::

    ECFRAME1 · u64 · {"arrays": {name: [dtype, shape, offset]}, "frame": [dtype, shape], ...} · arrays · frames

Zstandard with a dictionary of some of the environment's own frames, which the others mostly repeat: quicker to read
than without, than Blosc and than any palette, and about a third of the size of the former two. Indices into a palette
are a little smaller still, but take ten times as long to become a picture (``python -m benchmarks.demonstrations``).
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft.check import Skip
from envcraft.demonstrations.form import FRAME, Episode, Recording, rewards
from envcraft.errors import UsageError

MAGIC = b"ECFRAME1"
#: Zstandard's level, and the frames that its dictionary is made of.
LEVEL, SAMPLES = 12, 12
_ALIGN = 64


class CacheDamaged(ValueError):
    """A cache is not what it was when it was written."""


def ensure() -> None:
    """Raises UsageError where frames can be neither written nor read."""
    if importlib.util.find_spec("zstandard") is None:
        raise UsageError("frames are kept by zstandard: pip install 'envcraft-rl[demos]'")


class Writer:
    """Takes in the episodes of a recording, in their order, with their frames."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._numbers: dict[bytes, int] = {}
        self._frames: list[NDArray[Any]] = []
        self._shown: list[int] = []
        self._after: list[int] = []

    def add(self, episode: Episode, frames: Sequence[NDArray[Any]]) -> None:
        """Take in an episode of T steps with its T + 1 frames. Raises Skip where it has not as many, or others."""
        if len(frames) != episode.steps + 1:
            raise Skip("its observations are no arrays of moderate size, so that no frames can be kept")
        if self._frames and any(frame.shape != self._frames[0].shape for frame in frames):
            raise Skip("its observations differ in shape, so that no frames can be kept")
        numbers = []
        for place, frame in enumerate(frames):
            digest = episode.frames[place * FRAME : (place + 1) * FRAME]
            if digest not in self._numbers:
                self._numbers[digest] = len(self._frames)
                self._frames.append(frame)
            numbers.append(self._numbers[digest])
        self._shown += numbers[:-1]
        self._after += numbers[1:]

    def to_bytes(self) -> bytes:
        """The whole file."""
        ensure()
        recording, frames = self._recording, self._frames
        kept = dictionary(frames)
        packed = _compress(frames, kept)
        offsets = np.cumsum([0, *map(len, packed)])
        episodes = recording.episodes
        steps = np.array([episode.steps for episode in episodes])
        last = np.cumsum(steps) - 1
        ended = np.zeros((2, recording.steps), np.uint8)
        for place, episode in zip(last, episodes, strict=True):
            ended[0, place], ended[1, place] = episode.terminated, episode.truncated
        arrays: dict[str, NDArray[Any]] = {
            "dictionary": np.frombuffer(_packed(kept), np.uint8),
            "offsets": offsets.astype("<u8"),
            "observation": np.array(self._shown, "<u4"),
            "next_observation": np.array(self._after, "<u4"),
            "action": np.concatenate([recording.numbers(episode) for episode in episodes]).astype("<u4"),
            "reward": np.concatenate([rewards(episode) for episode in episodes]),
            "terminated": ended[0],
            "truncated": ended[1],
            "episode": np.repeat(np.arange(len(episodes)), steps).astype("<u4"),
            "table": np.array(recording.table),
            "frames": np.frombuffer(b"".join(packed), np.uint8),
        }
        return _file(arrays, {"frame": [frames[0].dtype.str, list(frames[0].shape)]})


def dictionary(frames: Sequence[NDArray[Any]]) -> bytes:
    """Frames spread over the recording; the compressor looks for what repeats among them."""
    picked = np.linspace(0, len(frames) - 1, min(SAMPLES, len(frames))).round().astype(int)
    return b"".join(frames[place].tobytes() for place in picked)


def _packed(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(level=LEVEL).compress(data)


def _compress(frames: Sequence[NDArray[Any]], dictionary: bytes) -> list[bytes]:
    import zstandard

    kept = zstandard.ZstdCompressionDict(dictionary, dict_type=zstandard.DICT_TYPE_RAWCONTENT)
    kept.precompute_compress(level=LEVEL)
    compressor = zstandard.ZstdCompressor(dict_data=kept)
    return [compressor.compress(frame.tobytes()) for frame in frames]


def _file(arrays: dict[str, NDArray[Any]], about: dict[str, Any]) -> bytes:
    body, told = bytearray(), {}
    for name, array in arrays.items():
        body += bytes(-len(body) % _ALIGN)
        told[name] = [array.dtype.str, list(array.shape), len(body)]
        body += array.tobytes()
    digest = hashlib.sha256(body).hexdigest()
    header = json.dumps({"arrays": told, "size": len(body), "sha256": digest, **about}).encode()
    # The arrays begin at a multiple of what they are aligned to.
    header += b" " * (-(len(MAGIC) + 8 + len(header)) % _ALIGN)
    return MAGIC + len(header).to_bytes(8, "little") + header + body


class Cache:
    """A file of frames, mapped into memory.

    Attributes:
        arrays: views of the file: ``observation``, ``next_observation``, ``action``, ``reward``, ``terminated``,
            ``truncated`` and ``episode``, one value for each of the T transitions; ``table``, whose rows the actions
            number; and those that the frames are read by.
        frame: the shape of a frame, and `dtype` the type of its values.
    """

    def __init__(self, file: Path) -> None:
        """Raises CacheDamaged where the file is none, OSError."""
        ensure()
        import zstandard

        with open(file, "rb") as stream:
            if not os.fstat(stream.fileno()).st_size:
                raise CacheDamaged("is empty")
            self._map = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        self.header, start = _header(self._map)
        body = memoryview(self._map)[start:]
        self.arrays: dict[str, NDArray[Any]] = {
            name: np.frombuffer(body, dtype, int(np.prod(shape)), offset).reshape(shape)
            for name, (dtype, shape, offset) in self.header["arrays"].items()
        }
        self.dtype, self.frame = np.dtype(self.header["frame"][0]), tuple(self.header["frame"][1])
        self._size = int(np.prod(self.frame)) * self.dtype.itemsize
        self._frames = self.arrays["frames"]
        self._offsets = self.arrays["offsets"]
        dictionary = zstandard.ZstdDecompressor().decompress(self.arrays["dictionary"].tobytes())
        kept = zstandard.ZstdCompressionDict(dictionary, dict_type=zstandard.DICT_TYPE_RAWCONTENT)
        self._decompressor = zstandard.ZstdDecompressor(dict_data=kept)

    def __len__(self) -> int:
        return len(self.arrays["observation"])

    def read(self, number: int) -> NDArray[Any]:
        """A frame by its number, to be read only."""
        start, end = self._offsets[number : number + 2].tolist()
        data = self._decompressor.decompress(self._frames[start:end].data, max_output_size=self._size)
        return np.frombuffer(data, self.dtype).reshape(self.frame)


def check(file: Path) -> None:
    """Raises CacheDamaged where a file is not what was written, OSError."""
    data = file.read_bytes()
    header, start = _header(data)
    if hashlib.sha256(memoryview(data)[start:]).hexdigest() != header["sha256"]:
        raise CacheDamaged("is not what was written")


def _header(data: bytes | mmap.mmap) -> tuple[dict[str, Any], int]:
    """The header, and where the arrays begin. Raises CacheDamaged."""
    start = len(MAGIC) + 8
    end = start + int.from_bytes(data[len(MAGIC) : start], "little")
    try:
        header: dict[str, Any] = json.loads(data[start:end])
        whole = data[: len(MAGIC)] == MAGIC and len(data) - end == header["size"]
    except (ValueError, KeyError, TypeError):
        whole = False
    if not whole:
        raise CacheDamaged("is no cache of frames, or not a whole one")
    return header, end
