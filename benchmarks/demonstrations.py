"""``python -m benchmarks.demonstrations``: size and speed of recorded transitions beside Minari's HDF5 and NumPy files.

The benchmark writes the same transitions of random play in one Tetris variant as a recording with its frame cache, as a
Minari data set (``minari.create_dataset_from_buffers``) and as ``.npy`` files. It then reads single transitions at
random with each format's own reader; the smallest unit of Minari is an episode. A separate table compares codecs on the
frames alone. Reading is in CPU time. Writing is in wall-clock time, because the game runs in the sandbox while the
recording and the cache are written.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from envcraft_sandbox.process import ProcessDriver
from envcraft_tetris.family import TetrisFamily
from numpy.typing import NDArray

from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.store import Store, environments
from envcraft.corpus.store.demonstrations import named
from envcraft.demonstrations import cache, recorder
from envcraft.demonstrations.dataset import Demonstrations
from envcraft.demonstrations.store import cache_path, recording_path
from envcraft.plugins import plugins

_READS = 400
#: The number of frames, spread over the episodes, on which codecs are measured.
_FRAMES = 300
Frames = list[NDArray[np.uint8]]


class Line(NamedTuple):
    """One format: bytes per transition, transitions written a second, transitions read a second in random order."""

    name: str
    size: float
    written: float | None
    read: float | None


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--variant", type=int, default=5)
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        corpus = _corpus(Path(folder, "corpus"), chosen.variant)
        lines = _own(corpus, chosen.steps)
        episodes = _episodes(corpus)
        frames = [frame for episode in episodes for frame in episode["observations"]]
        for line in _codecs(frames):
            print(f"{line[0]:44}{line[1]:9.0f} bytes per frame{line[2]:9.1f} microseconds to read one")
        print()
        lines += [_raw(Path(folder), episodes), *_minari(Path(folder), episodes)]
    print(f"{'':34}{'bytes each':>12}{'written/s':>12}{'read/s':>12}")
    for one in lines:
        written, read = ("" if value is None else f"{value:,.0f}" for value in (one.written, one.read))
        print(f"{one.name:34}{one.size:12,.1f}{written:>12}{read:>12}")
    return 0


def _corpus(place: Path, number: int) -> Path:
    written = list(TetrisFamily().generate(number + 1, 0))[number]
    with Store.create(place) as store:
        store.add(f"{written.name}.py", written.source.encode(), origin={"family": "tetris"})
    return place


def _own(corpus: Path, steps: int) -> list[Line]:
    """The recording and the cache; the time to write them includes the play in the sandbox."""
    driver = ProcessDriver()
    (player,) = (found for found in plugins().collect("envcraft_players") if found.name == "random")
    with Store(corpus, write=True) as store:
        chosen = environments.every(store)
        started = time.perf_counter()
        recorder.record(store, chosen, player, ARCADE, driver, steps)
        recorded = time.perf_counter() - started
        rows = named(store)
        started = time.perf_counter()
        recorder.replay(store, rows, ARCADE, driver, frames=True)
        cached = time.perf_counter() - started
        sizes = [path(store, rows[0][1].file).stat().st_size for path in (recording_path, cache_path)]
    demonstrations = Demonstrations(corpus)
    read = _rate(demonstrations.transition, len(demonstrations))
    return [
        Line("recording (with play)", sizes[0] / steps, steps / recorded, None),
        Line("frame cache (with replay)", sizes[1] / steps, steps / cached, read),
    ]


def _episodes(corpus: Path) -> list[dict[str, Any]]:
    """Whole episodes as arrays: T + 1 observations, T of the rest."""
    (source,) = Demonstrations(corpus).sources
    arrays, found = source.cache.arrays, []
    for number in range(int(arrays["episode"][-1]) + 1):
        places = np.flatnonzero(arrays["episode"] == number)
        shown = [*arrays["observation"][places], arrays["next_observation"][places[-1]]]
        found.append(
            {
                "observations": np.stack([source.cache.read(int(one)) for one in shown]),
                "actions": arrays["table"][arrays["action"][places]],
                "rewards": arrays["reward"][places],
                "terminations": arrays["terminated"][places].astype(bool),
                "truncations": arrays["truncated"][places].astype(bool),
            }
        )
    return found


def _raw(folder: Path, episodes: Sequence[dict[str, Any]]) -> Line:
    """Memory-mapped ``.npy`` files with observations and next observations."""
    steps = sum(len(one["actions"]) for one in episodes)
    started = time.perf_counter()
    arrays = {
        "observation": np.concatenate([one["observations"][:-1] for one in episodes]),
        "next_observation": np.concatenate([one["observations"][1:] for one in episodes]),
        **{
            name: np.concatenate([one[name] for one in episodes])
            for name in ("actions", "rewards", "terminations", "truncations")
        },
    }
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", array)
    written = time.perf_counter() - started
    size = sum((folder / f"{name}.npy").stat().st_size for name in arrays)
    mapped = [np.load(folder / f"{name}.npy", mmap_mode="r") for name in arrays]

    def read(number: int) -> list[Any]:
        return [np.array(array[number]) for array in mapped]

    return Line("raw NumPy, mapped", size / steps, steps / written, _rate(read, steps))


def _minari(folder: Path, episodes: Sequence[dict[str, Any]]) -> list[Line]:
    try:
        import minari
    except ImportError:
        print("Minari is not installed: pip install 'envcraft-rl[minari]'", file=sys.stderr)
        return []
    import os

    import gymnasium

    os.environ["MINARI_DATASETS_PATH"] = str(folder / "minari")
    steps = sum(len(one["actions"]) for one in episodes)
    buffers = [
        minari.data_collector.EpisodeBuffer(
            id=number,
            **{name: value if name in ("observations", "actions") else value.tolist() for name, value in one.items()},
        )
        for number, one in enumerate(episodes)
    ]
    ends = np.cumsum([len(one["actions"]) for one in episodes])
    found = []
    for words, jpeg in (("Minari's HDF5", False), ("Minari's HDF5, JPEG (lossy)", True)):
        name = f"benchmark/tetris/{'jpeg' if jpeg else 'exact'}-v0"
        started = time.perf_counter()
        with warnings.catch_warnings():
            # It warns that the author and the link are missing.
            warnings.simplefilter("ignore", UserWarning)
            dataset = minari.create_dataset_from_buffers(
                name,
                buffers,
                observation_space=gymnasium.spaces.Box(0, 255, (84, 84, 3), np.uint8),
                action_space=gymnasium.spaces.MultiDiscrete([5, 2, 2]),
                jpeg_encoding=jpeg,
            )
        written = time.perf_counter() - started
        size = sum(file.stat().st_size for file in (folder / "minari" / name).rglob("*") if file.is_file())

        def read(number: int, dataset: Any = dataset) -> Any:
            which = int(np.searchsorted(ends, number, "right"))
            place = number - (int(ends[which - 1]) if which else 0)
            return dataset[which].observations[place : place + 2]

        found.append(Line(words, size / steps, steps / written, _rate(read, steps, 60)))
    return found


def _codecs(frames: Frames) -> list[tuple[str, float, float]]:
    """For each codec its name, the bytes per frame, and the microseconds to read one."""
    import zstandard

    found = []
    dictionary = cache.dictionary(frames)
    frames = frames[:: max(len(frames) // _FRAMES, 1)]
    indices, palette = _palette(frames)
    flat = np.empty((frames[0].size // 3, 3), np.uint8)
    for level in (3, 12):
        for words, data, kept in (
            (f"zstandard {level}", frames, b""),
            (f"zstandard {level}, frames as dictionary", frames, dictionary),
            (f"zstandard {level}, palette", indices, b""),
            (f"zstandard {level}, palette, dictionary", indices, cache.dictionary(indices)),
        ):
            raw = zstandard.ZstdCompressionDict(kept, dict_type=zstandard.DICT_TYPE_RAWCONTENT) if kept else None
            if raw is not None:
                raw.precompute_compress(level=level)
            compressor = zstandard.ZstdCompressor(**({"dict_data": raw} if raw else {"level": level}))
            unpack = zstandard.ZstdDecompressor(dict_data=raw).decompress
            packed = [compressor.compress(frame.tobytes()) for frame in data]

            def read(number: int, packed: Any = packed, unpack: Any = unpack, paletted: bool = data is indices) -> Any:
                one = np.frombuffer(unpack(packed[number]), np.uint8)
                return np.take(palette, one, axis=0, out=flat, mode="clip") if paletted else one

            found.append((words, sum(map(len, packed)) / len(packed), 1e6 / _rate(read, len(packed))))
    return [*found, *_blosc(frames)]


def _blosc(frames: Frames) -> list[tuple[str, float, float]]:
    try:
        import blosc2
    except ImportError:
        return []
    found = []
    for words, codec in (("blosc2 lz4", blosc2.Codec.LZ4), ("blosc2 zstd", blosc2.Codec.ZSTD)):
        packed = [blosc2.compress2(frame.tobytes(), codec=codec, clevel=9, typesize=1, nthreads=1) for frame in frames]

        def read(number: int, packed: Any = packed) -> Any:
            return blosc2.decompress2(packed[number], nthreads=1)

        found.append((words, sum(map(len, packed)) / len(packed), 1e6 / _rate(read, len(packed))))
    return found


def _palette(frames: Frames) -> tuple[Frames, NDArray[np.uint8]]:
    """Frames as indices of shape (H, W), and the colours; no more than 256."""
    packed = np.stack(frames).astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    colours = np.unique(packed)
    indices = np.searchsorted(colours, packed).astype(np.uint8)
    return list(indices), np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1).astype(np.uint8)


def _rate(read: Callable[[int], Any], count: int, reads: int = _READS) -> float:
    """Reads per CPU second, in random order."""
    numbers = np.random.default_rng(0).integers(count, size=reads).tolist()
    read(numbers[0])
    started = time.process_time()
    for number in numbers:
        read(number)
    return reads / (time.process_time() - started)


if __name__ == "__main__":
    sys.exit(main())
