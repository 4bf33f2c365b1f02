"""The adapter of ``arcade-native``: area resize against a plain reference."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from envcraft_protocol.adapters import AreaResize, StepLimit
from numpy.typing import NDArray


class Still(gymnasium.Env[Any, Any]):
    def __init__(self, frame: NDArray[np.uint8]) -> None:
        self.frame = frame

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return self.frame.copy(), {}

    def step(self, action: Any) -> Any:
        return self.frame.copy(), 0.0, False, False, {}


def area_mean(frame: NDArray[np.uint8], height: int, width: int) -> NDArray[np.float64]:
    """Each target pixel's mean over the source area that it covers, pixel by pixel."""
    rows, columns, _ = frame.shape
    result = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            top, bottom = y * rows / height, (y + 1) * rows / height
            left, right = x * columns / width, (x + 1) * columns / width
            weight = 0.0
            for row in range(int(top), int(np.ceil(bottom))):
                for column in range(int(left), int(np.ceil(right))):
                    area = (min(bottom, row + 1) - max(top, row)) * (min(right, column + 1) - max(left, column))
                    result[y, x] += area * frame[row, column]
                    weight += area
            result[y, x] /= weight
    return result


@pytest.mark.parametrize("size", [(30, 20), (17, 41), (9, 9), (6, 5)])
def test_resize_is_the_area_mean(size: tuple[int, int]) -> None:
    frame = np.random.default_rng(1).integers(0, 256, (*size, 3), dtype=np.uint8)
    resized, _ = AreaResize(Still(frame), 9, 9).reset()
    assert resized.dtype == np.uint8
    assert np.abs(resized - area_mean(frame, 9, 9)).max() <= 0.51


def test_the_limit_truncates() -> None:
    env = StepLimit(Still(np.zeros((4, 4, 3), np.uint8)), 3)
    env.reset()
    assert [env.step(0)[3] for _ in range(3)] == [False, False, True]
    env.reset()
    assert env.step(0)[3] is False
