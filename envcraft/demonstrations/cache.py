"""The frame cache of a recording: a file that is mapped into memory and has each different frame once, compressed.

A file has a magic number, the length of a header, the header (JSON), arrays and the frames, all little-endian::

    ECFRAME1 · u64 · {"arrays": {name: [dtype, shape, offset]}, "frame": [dtype, shape], ...} · arrays · frames

Frames are compressed by Zstandard with a dictionary of some frames of the same recording, because most frames repeat
parts of others. Reading is faster than without a dictionary, with Blosc or with a palette, and the size is a third of
that of the first two (``python -m benchmarks.demonstrations``).
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

from envcraft.demonstrations.format import DIGEST_SIZE, Episode, Recording, rewards
from envcraft.errors import Skip, UsageError

MAGIC = b"ECFRAME1"
#: The level of compression, and the number of frames in the dictionary.
LEVEL, SAMPLES = 12, 12
_ALIGN = 64


class CacheDamaged(ValueError):
    """A cache has changed since it was written, or is incomplete."""


def ensure_zstandard() -> None:
    """Raises UsageError if zstandard is not installed."""
    if importlib.util.find_spec("zstandard") is None:
        raise UsageError("frame caches need zstandard: pip install 'envcraft-rl[demos]'")


class Writer:
    """Builds the cache of a recording from its episodes, in order, and their frames."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._numbers: dict[bytes, int] = {}
        self._frames: list[NDArray[Any]] = []
        self._shown: list[int] = []
        self._after: list[int] = []

    def add(self, episode: Episode, frames: Sequence[NDArray[Any]]) -> None:
        """Add an episode of T steps with its T + 1 frames.

        Raises:
            Skip: Frames are missing or differ in shape, so that the recording can have no cache.
        """
        if len(frames) != episode.steps + 1:
            raise Skip("its observations are not arrays of moderate size, so its frames cannot be cached")
        if self._frames and any(frame.shape != self._frames[0].shape for frame in frames):
            raise Skip("its observations differ in shape, so its frames cannot be cached")
        numbers = []
        for step, frame in enumerate(frames):
            digest = episode.frames[step * DIGEST_SIZE : (step + 1) * DIGEST_SIZE]
            if digest not in self._numbers:
                self._numbers[digest] = len(self._frames)
                self._frames.append(frame)
            numbers.append(self._numbers[digest])
        self._shown += numbers[:-1]
        self._after += numbers[1:]

    def to_bytes(self) -> bytes:
        """The content of the file."""
        ensure_zstandard()
        recording, frames = self._recording, self._frames
        shared = dictionary(frames)
        packed = _compress(frames, shared)
        offsets = np.cumsum([0, *map(len, packed)])
        episodes = recording.episodes
        steps = np.array([episode.steps for episode in episodes])
        last = np.cumsum(steps) - 1
        ended = np.zeros((2, recording.steps), np.uint8)
        for step, episode in zip(last, episodes, strict=True):
            ended[0, step], ended[1, step] = episode.terminated, episode.truncated
        arrays: dict[str, NDArray[Any]] = {
            "dictionary": np.frombuffer(_compress_dictionary(shared), np.uint8),
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
    """The bytes of frames that are spread evenly over the recording."""
    picked = np.linspace(0, len(frames) - 1, min(SAMPLES, len(frames))).round().astype(int)
    return b"".join(frames[number].tobytes() for number in picked)


def _compress_dictionary(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(level=LEVEL).compress(data)


def _compress(frames: Sequence[NDArray[Any]], dictionary: bytes) -> list[bytes]:
    import zstandard

    shared = zstandard.ZstdCompressionDict(dictionary, dict_type=zstandard.DICT_TYPE_RAWCONTENT)
    shared.precompute_compress(level=LEVEL)
    compressor = zstandard.ZstdCompressor(dict_data=shared)
    return [compressor.compress(frame.tobytes()) for frame in frames]


def _file(arrays: dict[str, NDArray[Any]], extra: dict[str, Any]) -> bytes:
    body, layout = bytearray(), {}
    for name, array in arrays.items():
        body += bytes(-len(body) % _ALIGN)
        layout[name] = [array.dtype.str, list(array.shape), len(body)]
        body += array.tobytes()
    digest = hashlib.sha256(body).hexdigest()
    header = json.dumps({"arrays": layout, "size": len(body), "sha256": digest, **extra}).encode()
    # Pads the header, so that the arrays are aligned in the file too.
    header += b" " * (-(len(MAGIC) + 8 + len(header)) % _ALIGN)
    return MAGIC + len(header).to_bytes(8, "little") + header + body


class Cache:
    """A frame cache, mapped into memory.

    Attributes:
        arrays: Views of the file: ``observation``, ``next_observation`` (numbers of frames), ``action`` (rows of
            ``table``), ``reward``, ``terminated``, ``truncated`` and ``episode``, each of shape (T,) for T transitions;
            ``table``, the different actions; and the arrays that locate the frames.
        frame: The shape of a frame.
        dtype: The dtype of a frame.
    """

    def __init__(self, file: Path) -> None:
        """Map a file into memory. Raises CacheDamaged if it is not a complete cache, OSError."""
        ensure_zstandard()
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
        shared = zstandard.ZstdCompressionDict(dictionary, dict_type=zstandard.DICT_TYPE_RAWCONTENT)
        self._decompressor = zstandard.ZstdDecompressor(dict_data=shared)

    def __len__(self) -> int:
        return len(self.arrays["observation"])

    def read(self, number: int) -> NDArray[Any]:
        """The frame with this number, as a read-only array."""
        start, end = self._offsets[number : number + 2].tolist()
        data = self._decompressor.decompress(self._frames[start:end].data, max_output_size=self._size)
        return np.frombuffer(data, self.dtype).reshape(self.frame)


def check(file: Path) -> None:
    """Raises CacheDamaged if a file differs from what was written, OSError."""
    data = file.read_bytes()
    header, start = _header(data)
    if hashlib.sha256(memoryview(data)[start:]).hexdigest() != header["sha256"]:
        raise CacheDamaged("has changed since it was written")


def _header(data: bytes | mmap.mmap) -> tuple[dict[str, Any], int]:
    """The header, and the offset of the arrays. Raises CacheDamaged."""
    start = len(MAGIC) + 8
    end = start + int.from_bytes(data[len(MAGIC) : start], "little")
    try:
        header: dict[str, Any] = json.loads(data[start:end])
        whole = data[: len(MAGIC)] == MAGIC and len(data) - end == header["size"]
    except (ValueError, KeyError, TypeError):
        whole = False
    if not whole:
        raise CacheDamaged("is not a complete frame cache")
    return header, end
