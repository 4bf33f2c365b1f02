"""Wrappers that make an environment of one contract fit another one, selected by name in the contract's data."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


def apply(env: Any, adapter: dict[str, Any]) -> Any:
    """Wrap `env` by ``{"resize": [height, width], "limit": steps}``, either or both."""
    if "resize" in adapter:
        env = AreaResize(env, *adapter["resize"])
    if "limit" in adapter:
        env = StepLimit(env, adapter["limit"])
    return env


class AreaResize(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Resize frames from `(H, W, 3)` uint8 to `(height, width, 3)` uint8; each pixel is the mean of the area it
    covers.
    """

    def __init__(self, env: Any, height: int, width: int) -> None:
        super().__init__(env)
        self._size = (height, width)
        self._weights: dict[tuple[int, int], NDArray[np.float32]] = {}
        self.observation_space = spaces.Box(0, 255, (height, width, 3), np.uint8)

    def reset(self, **kwargs: Any) -> Any:
        result = self.env.reset(**kwargs)
        if isinstance(result, tuple) and len(result) == 2:
            return self._resized(result[0]), result[1]
        return result

    def step(self, action: Any) -> Any:
        result: Any = self.env.step(action)
        if isinstance(result, tuple) and len(result) == 5:
            return self._resized(result[0]), *result[1:]
        return result

    def render(self) -> Any:
        return self._resized(self.env.render())

    def _resized(self, frame: Any) -> Any:
        if not (isinstance(frame, np.ndarray) and frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3):
            return frame
        height, width, _ = frame.shape
        rows, columns = self._weigh(height, self._size[0]), self._weigh(width, self._size[1])
        tall = rows @ frame.reshape(height, width * 3).astype(np.float32)
        wide = np.einsum("hwc,vw->hvc", tall.reshape(-1, width, 3), columns, optimize=True)
        return np.clip(np.rint(wide), 0, 255).astype(np.uint8)

    def _weigh(self, source: int, target: int) -> NDArray[np.float32]:
        """A `(target, source)` matrix of overlaps, each row with sum 1."""
        if (source, target) not in self._weights:
            edges = np.arange(target + 1) * source / target
            pixels = np.arange(source)
            overlap = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
            self._weights[source, target] = (np.clip(overlap, 0, 1) * target / source).astype(np.float32)
        return self._weights[source, target]


class StepLimit(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Truncate an episode that has not ended after `limit` steps."""

    def __init__(self, env: Any, limit: int) -> None:
        super().__init__(env)
        self._limit = limit
        self._steps = 0

    def reset(self, **kwargs: Any) -> Any:
        self._steps = 0
        return self.env.reset(**kwargs)

    def step(self, action: Any) -> Any:
        result: Any = self.env.step(action)
        self._steps += 1
        if self._steps >= self._limit and isinstance(result, tuple) and len(result) == 5:
            observation, reward, terminated, truncated, info = result
            return observation, reward, terminated, truncated or not terminated, info
        return result
