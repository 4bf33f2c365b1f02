"""The observation and action spaces that the environments of one agent share."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
from gymnasium.spaces import Box, MultiDiscrete, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from envcraft.errors import UsageError

#: Makes a vector of the environments with these names, in this order, with autoreset mode NEXT_STEP.
OpenVector = Callable[[Sequence[str]], VectorEnv[Any, Any, Any]]


class EnvSpec(msgspec.Struct, frozen=True):
    """Spaces of the environments of one agent.

    Attributes:
        shape: The shape of a frame, [height, width, channels].
        choices: The number of values of each component of an action.
    """

    shape: tuple[int, ...]
    choices: tuple[int, ...]

    @classmethod
    def of(cls, open_vector: OpenVector, name: str) -> EnvSpec:
        """The spec of one environment. Raises UsageError if an agent cannot learn from its frames."""
        vector = open_vector([name])
        try:
            return spec_of(vector, name)
        finally:
            vector.close()

    def split(self, joint: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert joint actions [n] to their components [n, parts]."""
        return np.stack(np.unravel_index(joint, self.choices), axis=-1)

    def join(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert action components [n, parts] to joint actions [n]."""
        return np.asarray(np.ravel_multi_index(tuple(np.asarray(actions).T), self.choices), np.int64)

    @property
    def num_actions(self) -> int:
        """The number of joint actions."""
        return math.prod(self.choices)


def advises(open_vector: OpenVector, name: str) -> bool:
    """Whether the vector of an environment advises learners."""
    with contextlib.closing(open_vector([name])) as vector:
        return hasattr(vector.unwrapped, "advise")


def spec_of(vector: VectorEnv[Any, Any, Any], name: str) -> EnvSpec:
    """The spec of the environments of a vector.

    Args:
        vector: The vector.
        name: The name of an environment, for messages.

    Raises:
        UsageError: The spaces or the autoreset mode are not supported.
    """
    spec = spec_of_spaces(vector.single_observation_space, vector.single_action_space, name)
    if vector.metadata.get("autoreset_mode") is not AutoresetMode.NEXT_STEP:
        raise UsageError("a vector must reset in the step after the end of an episode: autoreset_mode='NextStep'")
    return spec


def spec_of_spaces(frame: Space[Any], action: Space[Any], name: str) -> EnvSpec:
    """The spec of an environment with these spaces of observations and actions.

    Args:
        frame: The observation space.
        action: The action space.
        name: The name of the environment, for messages.

    Raises:
        UsageError: An agent cannot use the spaces.
    """
    if not isinstance(frame, Box) or frame.dtype != np.uint8 or len(frame.shape) != 3:
        raise UsageError(
            f"{name} has observations {frame}; an agent learns from frames, such as those of the contract arcade"
        )
    if not isinstance(action, MultiDiscrete) or action.nvec.ndim != 1 or action.start.any():
        raise UsageError(
            f"{name} has actions {action}; an agent needs a MultiDiscrete space, such as that of the contract arcade"
        )
    return EnvSpec(frame.shape, tuple(map(int, action.nvec)))
