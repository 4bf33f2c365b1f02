"""Wrappers that make an environment of one contract fit another one, selected by name in the contract's data."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


def apply(env: Any, adapter: dict[str, Any]) -> Any:
    """Wrap `env` by ``{"resize": [height, width], "limit": steps}``, either or both."""
    if "resize" in adapter:
        env = AreaResize(env, *adapter["resize"])
    if "limit" in adapter:
        env = StepLimit(env, adapter["limit"])
    return env


class AreaResize(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Resize frames from `(H, W, 3)` uint8 to `(height, width, 3)` uint8.

    Each pixel is the mean of the pixels whose centres it covers, or the nearest pixel if it covers none.
    """

    def __init__(self, env: Any, height: int, width: int) -> None:
        super().__init__(env)
        self._size = (height, width)
        own: tuple[int, ...] = getattr(getattr(env, "observation_space", None), "shape", None) or ()
        if len(own) == 3 and own[2] == 3:
            # Other observations are not resized, and their space stays what it is.
            self.observation_space = spaces.Box(0, 255, (height, width, 3), np.uint8)

    def reset(self, **kwargs: Any) -> Any:
        result = self.env.reset(**kwargs)
        if isinstance(result, tuple) and len(result) == 2:
            return resized(result[0], *self._size), result[1]
        return result

    def step(self, action: Any) -> Any:
        result: Any = self.env.step(action)
        if isinstance(result, tuple) and len(result) == 5:
            return resized(result[0], *self._size), *result[1:]
        return result

    def render(self) -> Any:
        return resized(self.env.render(), *self._size)


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


def resized(frame: Any, height: int, width: int) -> Any:
    """Resize a frame `(H, W, 3)` uint8 to `(height, width, 3)` uint8; return any other value unchanged."""
    if not (isinstance(frame, np.ndarray) and frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3):
        return frame
    if not frame.size:
        return frame
    # Imported here, because only frames of another size than the contract's need it.
    from PIL import Image

    if _has_columns(frame):
        # Pillow turns a picture in a quarter of the time that NumPy takes to copy it in the other order.
        picture = Image.fromarray(frame.transpose(1, 0, 2)).transpose(Image.Transpose.TRANSPOSE)
    else:
        picture = Image.fromarray(np.ascontiguousarray(frame))
    return np.array(picture.resize((width, height), Image.Resampling.BOX))


def contiguous(frame: Any) -> Any:
    """An array whose items lie in memory in its own order: the array itself, or a copy."""
    if frame.ndim == 3 and frame.shape[2] == 3 and _has_columns(frame):
        # NumPy copies items of three bytes faster than rows of three items.
        return frame.transpose(1, 0, 2).view("V3")[..., 0].T.copy().view(frame.dtype).reshape(frame.shape)
    return np.ascontiguousarray(frame)


def _has_columns(frame: Any) -> bool:
    """Whether the pixels of a frame lie in memory column by column, as pygame has them."""
    return bool(frame.transpose(1, 0, 2).flags.c_contiguous)
