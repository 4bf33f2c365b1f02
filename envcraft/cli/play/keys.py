"""Keys to actions. A key has a name: ``up``, ``down``, ``left``, ``right``, ``space``, ``enter``, ``escape`` or its
character.
"""

from __future__ import annotations

import math
import string
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import UsageError
from envcraft.model.contract import Contract
from envcraft.spaces.sampling import enumerate_actions
from envcraft.spaces.spec import Box, Discrete, MultiBinary, MultiDiscrete, SpaceSpec, read_space

#: Keys of the game loop; none of them is an action.
QUIT, AGAIN, ABOUT = ("q", "escape"), "r", "?"

_MOVES = {
    **dict.fromkeys(("up", "w", "k"), 1),
    **dict.fromkeys(("down", "s", "j"), 2),
    **dict.fromkeys(("left", "a", "h"), 3),
    **dict.fromkeys(("right", "d", "l"), 4),
}
_BUTTONS = {"space": 1, "x": 1, "z": 2, "c": 2}
_KEYS = [key for key in "1234567890" + string.ascii_lowercase if key not in (*QUIT, AGAIN)]
#: A Box with more numbers than this has too many actions for the keys.
_DIMENSIONS = 8


class Keys(ABC):
    """The keys of one action space.

    Attributes:
        help: lines that describe the keys.
        pad: keys with short labels, one for each action or part of one, for buttons on a screen.
        idle: whether an action does nothing, so that the game can continue without a key.
    """

    help: list[str]
    pad: list[tuple[str, str]]
    idle: bool

    @abstractmethod
    def held(self, keys: Sequence[str]) -> Any:
        """Return the action of the held keys, the last pressed at the end. Requires `idle`."""

    @abstractmethod
    def turn(self, key: str) -> Any:
        """Return the action of one key in turn-based play, or None if it needs another key."""


class Pad(Keys):
    """Five moves and two buttons. In turn-based play, a button combines with the next move."""

    help = ["arrows, wasd or hjkl move; space or x, z or c are the buttons"]
    pad = [("left", "\u2190"), ("up", "\u2191"), ("down", "\u2193"), ("right", "\u2192"), ("x", "1"), ("z", "2")]
    idle = True

    def __init__(self) -> None:
        self._buttons = [0, 0]

    def held(self, keys: Sequence[str]) -> Any:
        moves = [_MOVES[key] for key in keys if key in _MOVES]
        buttons = {_BUTTONS[key] for key in keys if key in _BUTTONS}
        return [moves[-1] if moves else 0, int(1 in buttons), int(2 in buttons)]

    def turn(self, key: str) -> Any:
        if key in _BUTTONS:
            self._buttons[_BUTTONS[key] - 1] = 1
        if key not in _MOVES and key != "enter":
            return None
        action = [_MOVES.get(key, 0), *self._buttons]
        self._buttons = [0, 0]
        return action


class Choices(Keys):
    """A small space, with one key for each action."""

    def __init__(self, actions: Sequence[tuple[str, Any]], noop: Any) -> None:
        """Take pairs of text and action, at most one for each key."""
        self._actions = {key: action for key, (_, action) in zip(_KEYS, actions, strict=False)}
        self._noop = noop
        self.pad = [(key, words) for key, (words, _) in zip(_KEYS, actions, strict=False)]
        self.idle = noop is not None
        listed = [f"{key}: {words}" for key, (words, _) in zip(_KEYS, actions, strict=False)]
        self.help = ["   ".join(listed[start : start + 6]) for start in range(0, len(listed), 6)]

    def held(self, keys: Sequence[str]) -> Any:
        chosen = [self._actions[key] for key in keys if key in self._actions]
        return chosen[-1] if chosen else self._noop

    def turn(self, key: str) -> Any:
        return self._noop if key == "enter" else self._actions.get(key)


def keys_for(contract: Contract, space: SpaceSpec) -> Keys:
    """Return the keys of an action space. Raises UsageError if the keyboard has too few."""
    if space == read_space(ARCADE.action) and contract.noop == ARCADE.noop:
        return Pad()
    words = f"the action space {space} cannot be played by keyboard"
    if isinstance(space, Box):
        return Choices(_corners(space, words), contract.noop)
    if isinstance(space, Discrete):
        count = space.n
    elif isinstance(space, MultiDiscrete):
        count = math.prod(space.limits[0].ravel().tolist())
    elif isinstance(space, MultiBinary):
        # Bounded, because the count may have thousands of digits.
        count = 2 ** min(math.prod(space.shape), 64)
    else:
        raise UsageError(f"{words}: only Discrete, MultiDiscrete, MultiBinary and small Box spaces can")
    if count > len(_KEYS):
        raise UsageError(f"{words}: it has more than {len(_KEYS)} actions, and there are no more keys")
    if isinstance(space, MultiBinary):
        bits = [[number >> bit & 1 for bit in range(math.prod(space.shape))] for number in range(count)]
        return Choices([(str(value), _shaped(value, space.shape)) for value in bits], contract.noop)
    return Choices([(str(action), action) for action in enumerate_actions(space, count)], contract.noop)


def _corners(space: Box, words: str) -> list[tuple[str, Any]]:
    """Return the middle of a Box, and each of its numbers at its lowest and highest."""
    size = math.prod(space.shape)
    if not 0 < size <= _DIMENSIONS:
        raise UsageError(f"{words}: it has {size:,} numbers, and up to {_DIMENSIONS} can be set to low and high")
    middle, _, _, *ends = enumerate_actions(space)
    named = [f"{at} {side}" for at in range(size) for side in ("low", "high")]
    return [("middle", middle), *zip(named, ends, strict=True)]


def _shaped(bits: list[int], shape: tuple[int, ...]) -> Any:
    import numpy as np

    return np.reshape(bits, shape).tolist()
