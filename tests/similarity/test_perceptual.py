"""Hashes of frames: similar for similar frames and different for others, at any size."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from envcraft.similarity.perceptual import BLANK, frame_hash, value_hash


def scene(seed: int, size: int = 84) -> NDArray[np.uint8]:
    """A dark picture with a few bright sprites."""
    rng = np.random.default_rng(seed)
    frame = np.zeros((12, 12, 3), np.uint8)
    for _ in range(6):
        frame[tuple(rng.integers(0, 12, 2))] = rng.integers(120, 255, 3)
    return frame.repeat(size // 12, axis=0).repeat(size // 12, axis=1)


def apart(one: NDArray[np.uint8], two: NDArray[np.uint8]) -> int:
    return (frame_hash(one) ^ frame_hash(two)).bit_count()


def test_other_scenes_are_far_apart() -> None:
    distances = [apart(scene(one), scene(two)) for two in range(12) for one in range(two)]
    assert 24 < np.mean(distances) < 40
    assert min(distances) > 8


@pytest.mark.parametrize(
    "change",
    [
        lambda frame: (frame * 0.8).astype(np.uint8),
        lambda frame: frame // 2 + 40,
        lambda frame: np.clip(frame + np.random.default_rng(1).integers(0, 6, frame.shape), 0, 255).astype(np.uint8),
    ],
    ids=["darker", "paler", "noise"],
)
def test_small_changes_are_few_bits(change: object) -> None:
    for seed in range(6):
        assert apart(scene(seed), change(scene(seed))) <= 6  # type: ignore[operator]


def test_sizes_and_channels() -> None:
    frame = scene(3)
    assert apart(frame, scene(3, 168)) <= 4
    assert apart(frame[:, :, :1], frame[:, :, 0]) == 0
    frame_hash(frame[:5, :3])
    frame_hash(frame[:1, :1])


@pytest.mark.parametrize("level", [0, 128, 255])
def test_without_contrast_a_frame_is_blank(level: int) -> None:
    assert frame_hash(np.full((84, 84, 3), level, np.uint8)) == BLANK
    assert frame_hash(scene(0)) != BLANK


def test_values_that_are_no_pictures() -> None:
    numbers = np.array([0.12345678, -3.0])
    assert value_hash(numbers) == value_hash(numbers + 1e-7)
    assert value_hash(np.array([0.0])) == value_hash(np.array([-0.0]))
    assert value_hash(numbers) != value_hash(numbers + 0.01)
    assert value_hash({"a": 1, "b": (2, "c")}) == value_hash({"b": (2, "c"), "a": 1})
    assert value_hash({"a": 1}) != value_hash({"a": 2})
    odd_ones: tuple[object, ...] = (None, np.array(["x"]), np.array([np.nan, np.inf, 1e300]), np.int64(3), [])
    for odd in odd_ones:
        assert value_hash(odd) != BLANK
