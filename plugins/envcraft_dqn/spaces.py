"""What the environments of one agent have in common: frames of one shape, and actions with as many parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
from gymnasium.spaces import Box, MultiDiscrete
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from envcraft.errors import UsageError

#: Makes a vector of the environments with these names, in this order, that resets in the step after an end.
OpenVector = Callable[[Sequence[str]], VectorEnv[Any, Any, Any]]


class Surface(msgspec.Struct, frozen=True):
    """The `shape` of a frame, and how many `choices` each part of an action has."""

    shape: tuple[int, ...]
    choices: tuple[int, ...]

    @classmethod
    def of(cls, open_vector: OpenVector, name: str) -> Surface:
        """That of one environment. Raises UsageError where it is none that an agent can learn from frames."""
        vector = open_vector([name])
        try:
            return surface_of(vector, name)
        finally:
            vector.close()

    def split(self, joint: NDArray[np.int64]) -> NDArray[np.int64]:
        """The parts of joint actions: [n] to [n, parts]."""
        return np.stack(np.unravel_index(joint, self.choices), axis=-1)

    def join(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """Joint actions from their parts: [n, parts] to [n]."""
        return np.asarray(np.ravel_multi_index(tuple(np.asarray(actions).T), self.choices), np.int64)

    @property
    def joint(self) -> int:
        """How many joint actions there are."""
        return math.prod(self.choices)


def surface_of(vector: VectorEnv[Any, Any, Any], name: str) -> Surface:
    """What a vector's environments have. Raises UsageError."""
    frame, action = vector.single_observation_space, vector.single_action_space
    if not isinstance(frame, Box) or frame.dtype != np.uint8 or len(frame.shape) != 3:
        raise UsageError(f"{name} gives {frame}; an agent learns from frames, such as the contract arcade promises")
    if not isinstance(action, MultiDiscrete) or action.nvec.ndim != 1 or action.start.any():
        raise UsageError(f"{name} takes {action}; an agent acts by a pad, such as the contract arcade promises")
    if vector.metadata.get("autoreset_mode") is not AutoresetMode.NEXT_STEP:
        raise UsageError("a vector must reset in the step after an episode's end: autoreset_mode='NextStep'")
    return Surface(frame.shape, tuple(map(int, action.nvec)))
