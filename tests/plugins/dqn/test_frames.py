"""Frames come back as they were put in, however they are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from envcraft_dqn.frames import FrameStore, PackedFrames, RawFrames, make_store
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from envcraft.errors import UsageError

SHAPE = (84, 84, 3)


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
def test_packed_frames_come_back(seed: int, shapes: int, noise: int) -> None:
    rng = np.random.default_rng(seed)
    frames = flat(rng, 3, shapes)
    # Pixels of their own, up to a frame that is nothing else.
    places = rng.integers(0, 84, (noise, 2))
    frames[1, places[:, 0], places[:, 1]] = rng.integers(0, 256, (noise, 3))
    store = PackedFrames(8, SHAPE)
    slots = np.array([5, 0, 7])
    store.write(slots, frames)
    assert (store.read(slots[::-1].copy()) == frames[::-1]).all()
    # What a cell had before does not matter.
    store.write(slots, frames[::-1].copy())
    assert (store.read(slots) == frames[::-1]).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32), st.integers(100, 1_200))
def test_an_arena_that_is_too_small_loses_nothing(seed: int, mean: int) -> None:
    rng = np.random.default_rng(seed)
    store = PackedFrames(24, SHAPE, mean)
    kept: dict[int, NDArray[np.uint8]] = {}
    for _ in range(12):
        slots = rng.permutation(24)[: rng.integers(1, 13)]
        frames = flat(rng, len(slots), int(rng.integers(0, 30)))
        store.write(slots, frames)
        kept |= dict(zip(slots.tolist(), frames, strict=True))
        again = PackedFrames(24, SHAPE, mean)
        again.load(0, store.dump(0, 24))
        for one in (store, again):
            assert (one.read(np.array(list(kept))) == np.stack(list(kept.values()))).all()


def test_a_ring_finds_its_oldest_behind_frames_that_stay() -> None:
    # Those that stay are more than are looked at for a gap.
    size, stay = 1_200, 1_000
    rng = np.random.default_rng(0)
    frames = flat(rng, 100)
    lengths = PackedFrames(100, SHAPE)
    lengths.write(np.arange(100), frames)
    mean = int(lengths.dump(0, 100)["lengths"].mean()) + 100
    store = PackedFrames(size, SHAPE, mean)
    for begin in range(0, 3 * size, 100):
        slots = np.arange(begin, begin + 100)
        store.write(np.where(slots < size, slots, stay + slots % (size - stay)), frames)
    assert not store.dump(0, size)["apart"].size


def test_flat_frames_lie_in_the_arena_and_others_apart() -> None:
    store = PackedFrames(10, SHAPE)
    empty = store.nbytes
    rng = np.random.default_rng(0)
    store.write(np.arange(5), flat(rng, 5))
    assert store.nbytes == empty
    store.write(np.array([9]), rng.integers(0, 256, (1, *SHAPE), np.uint8))
    assert store.nbytes > empty + 20_000
    store.write(np.array([9]), flat(rng, 1))
    assert store.nbytes == empty


@pytest.mark.parametrize("kind", ["packed", "ram", "mapped", "device"])
def test_a_dump_is_put_back(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frames = flat(rng, 6)
    frames[4] = rng.integers(0, 256, SHAPE)
    slots = np.arange(2, 8)

    def make(folder: str) -> FrameStore:
        (tmp_path / folder).mkdir()
        return make_store(kind, 10, SHAPE, tmp_path / folder, "cpu")

    store, again = make("one"), make("other")
    store.write(slots, frames)
    again.load(2, {name: np.array(part) for name, part in store.dump(2, 8).items()})
    assert (np.asarray(again.read(slots)) == frames).all()


def test_a_mapped_store_is_a_file(tmp_path: Path) -> None:
    store = RawFrames(4, SHAPE, tmp_path / "frames.bin")
    frames = flat(np.random.default_rng(0), 4)
    store.write(np.arange(4), frames)
    assert (tmp_path / "frames.bin").stat().st_size == frames.nbytes
    assert (store.read(np.array([3, 1])) == frames[[3, 1]]).all()


def test_what_cannot_be_packed_is_told() -> None:
    with pytest.raises(UsageError, match="--replay ram"):
        PackedFrames(4, (300, 84, 3))
