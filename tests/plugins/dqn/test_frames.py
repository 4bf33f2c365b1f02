"""Frames are read as they were written, in every store."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from envcraft_dqn.frames import CompressedFrames, FrameStore, RawFrames, make_store
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envcraft.errors import UsageError

SHAPE = (84, 84, 3)
#: The start of the SHA-256 of the frames in a dump that version 0.1 wrote, into slots 1 to 8 of 9.
_DIGESTS = [
    "e08aeaf1c0701784",
    "ae9b8d3fe66f10ef",
    "ccfcc9099a73bcba",
    "4b63318fb638f5e2",
    "f3110e1a4bc12b6d",
    "996e6b0567b96b1a",
    "cbd84b7dc80c7ace",
    "be1144c725286749",
]


def flat(rng: np.random.Generator, count: int, shapes: int = 12) -> NDArray[np.uint8]:
    """Frames of a few rectangles."""
    frames = np.zeros((count, *SHAPE), np.uint8)
    for frame in frames:
        frame[:] = rng.integers(0, 256, 3)
        for _ in range(shapes):
            top, left, height, width = rng.integers(0, 84, 4)
            frame[top : top + height, left : left + width] = rng.integers(0, 256, 3)
    return frames


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(0, 200), st.integers(0, 84 * 84))
def test_compressed_frames_are_lossless(seed: int, shapes: int, noise: int) -> None:
    rng = np.random.default_rng(seed)
    frames = flat(rng, 3, shapes)
    # Single random pixels, up to a frame of noise.
    places = rng.integers(0, 84, (noise, 2))
    frames[1, places[:, 0], places[:, 1]] = rng.integers(0, 256, (noise, 3))
    store = CompressedFrames(8, SHAPE)
    slots = np.array([5, 0, 7])
    store.write(slots, frames)
    assert (store.read(slots[::-1].copy()) == frames[::-1]).all()
    # Slots can be overwritten.
    store.write(slots, frames[::-1].copy())
    assert (store.read(slots) == frames[::-1]).all()


def test_size_counts_compressed_frames() -> None:
    store = CompressedFrames(10, SHAPE)
    empty = store.nbytes
    rng = np.random.default_rng(0)
    store.write(np.arange(5), flat(rng, 5))
    compressed = store.nbytes
    assert empty < compressed < empty + 5 * 1_000
    store.write(np.array([9]), rng.integers(0, 256, (1, *SHAPE), np.uint8))
    assert store.nbytes > compressed + 20_000
    store.write(np.array([9]), flat(rng, 1))
    assert store.nbytes < compressed + 1_000


@pytest.mark.parametrize("shape", [SHAPE, (300, 40, 1)])
@pytest.mark.parametrize("kind", ["packed", "ram", "mapped", "device"])
def test_dump_is_restored(kind: str, shape: tuple[int, ...], tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frames = np.full((6, *shape), 7, np.uint8)
    frames[4] = rng.integers(0, 256, shape)
    slots = np.arange(2, 8)

    def make(folder: str) -> FrameStore:
        (tmp_path / folder).mkdir()
        return make_store(kind, 10, shape, tmp_path / folder, "cpu")

    store, again = make("one"), make("other")
    store.write(slots, frames)
    again.load(2, {name: np.array(part) for name, part in store.dump(2, 8).items()})
    assert (np.asarray(again.read(slots)) == frames).all()


def test_dump_of_version_0_1_is_restored() -> None:
    import safetensors.numpy

    arrays = safetensors.numpy.load_file(Path(__file__).parent / "data" / "frames-palette-v1.safetensors")
    assert arrays["apart_lengths"].any()
    store = CompressedFrames(20, SHAPE)
    store.load(10, arrays)
    frames = store.read(np.arange(11, 19))
    assert [sha256(frame.tobytes()).hexdigest()[:16] for frame in frames] == _DIGESTS


def test_mapped_store_is_a_file(tmp_path: Path) -> None:
    store = RawFrames(4, SHAPE, tmp_path / "frames.bin")
    frames = flat(np.random.default_rng(0), 4)
    store.write(np.arange(4), frames)
    assert (tmp_path / "frames.bin").stat().st_size == frames.nbytes
    assert (store.read(np.array([3, 1])) == frames[[3, 1]]).all()


def test_unknown_kind_is_reported(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown replay 'tape'; choose from packed, ram, mapped, device"):
        make_store("tape", 4, SHAPE, tmp_path, "cpu")


def test_frames_that_a_device_cannot_hold_are_reported(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--replay device needs 21,168,000,000\.0 GB of free memory on cpu: use a"):
        make_store("device", 10**15, SHAPE, tmp_path, "cpu")
