"""The adapter of ``arcade-native``: area resize against plain references."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from envcraft_protocol.adapters import AreaResize, StepLimit, contiguous, resized
from numpy.typing import NDArray


class Still(gymnasium.Env[Any, Any]):
    def __init__(self, frame: NDArray[np.uint8]) -> None:
        self.frame = frame

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self.frame.copy(), {}

    def step(self, action: Any) -> Any:
        return self.frame.copy(), 0.0, False, False, {}


def area_mean(frame: NDArray[np.uint8], height: int, width: int) -> NDArray[np.float64]:
    """Each target pixel's mean over the source area that it covers, where the areas are whole pixels."""
    rows, columns, _ = frame.shape
    blocks = frame.reshape(height, rows // height, width, columns // width, 3)
    means: NDArray[np.float64] = blocks.mean(axis=(1, 3))
    return means


def centre_mean(frame: NDArray[np.uint8], height: int, width: int) -> NDArray[np.float64]:
    """Each target pixel's mean over the source pixels whose centres it covers, pixel by pixel."""
    rows, columns, _ = frame.shape
    result = np.zeros((height, width, 3))
    centres = [(np.arange(length) + 0.5) * size / length for length, size in ((rows, height), (columns, width))]
    for y in range(height):
        for x in range(width):
            inside = (centres[0] // 1 == y)[:, None] & (centres[1] // 1 == x)[None, :]
            result[y, x] = frame[inside].mean(axis=0)
    return result


@pytest.mark.parametrize("size", [(9, 9), (18, 45), (400, 640), (84 * 2, 84 * 3)])
def test_resize_is_the_area_mean_of_whole_pixels(size: tuple[int, int]) -> None:
    height, width = (20, 32) if size == (400, 640) else (84, 84) if size[0] % 84 == 0 else (9, 9)
    frame = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    resized, _ = AreaResize(Still(frame), height, width).reset()
    assert resized.dtype == np.uint8
    assert np.abs(resized - area_mean(frame, height, width)).max() <= 1


@pytest.mark.parametrize("size", [(30, 20), (17, 41), (100, 64)])
def test_resize_shares_no_pixel(size: tuple[int, int]) -> None:
    frame = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    resized, _ = AreaResize(Still(frame), 9, 9).reset()
    assert np.abs(resized - centre_mean(frame, 9, 9)).max() <= 1


@pytest.mark.parametrize("shape", [(40, 30, 3), (30, 30, 3), (1, 7, 3), (9, 4, 4), (6, 6)])
def test_an_array_in_another_order_is_copied(shape: tuple[int, ...]) -> None:
    plain = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    axes = (1, 0, 2)[: len(shape)]
    for value in (plain, np.transpose(plain, axes), plain[::-1], plain[:, ::-1]):
        made = contiguous(value)
        assert made.flags.c_contiguous
        assert made.dtype == np.uint8
        assert np.array_equal(made, value)
    turned = np.ascontiguousarray(np.transpose(plain, axes)).transpose(axes)
    assert np.array_equal(contiguous(turned), plain)


@pytest.mark.parametrize("size", [(40, 64), (17, 41), (9, 1), (1, 9)])
def test_the_order_in_memory_changes_no_pixel(size: tuple[int, int]) -> None:
    plain = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    columns = np.ascontiguousarray(plain.transpose(1, 0, 2)).transpose(1, 0, 2)
    assert np.array_equal(resized(columns, 9, 7), resized(plain, 9, 7))


def test_a_smaller_frame_repeats_its_pixels() -> None:
    frame = np.random.default_rng(1).integers(0, 256, (6, 5, 3), dtype=np.uint8)
    resized, _ = AreaResize(Still(frame), 12, 15).reset()
    assert np.array_equal(resized, frame.repeat(2, axis=0).repeat(3, axis=1))


@pytest.mark.parametrize("shape", [(0, 5, 3), (5, 5, 4), (5, 5)])
def test_what_is_no_frame_stays_as_it_is(shape: tuple[int, ...]) -> None:
    value = np.zeros(shape, np.uint8)
    resized, _ = AreaResize(Still(value), 9, 9).reset()
    assert resized.shape == shape


def test_a_resized_frame_can_be_written_to() -> None:
    env = AreaResize(Still(np.zeros((20, 20, 3), np.uint8)), 9, 9)
    env.reset()[0][0, 0] = 7
    assert env.step(0)[0].max() == 0


def test_the_limit_truncates() -> None:
    env = StepLimit(Still(np.zeros((4, 4, 3), np.uint8)), 3)
    env.reset()
    assert [env.step(0)[3] for _ in range(3)] == [False, False, True]
    env.reset()
    assert env.step(0)[3] is False
