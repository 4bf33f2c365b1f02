"""Copies of an environment, as `copy.deepcopy` makes them and sooner.

Most of what it takes goes into things that hardly a game changes: a random generator, which is made anew from the
system's entropy before it gets its state, and the bounds of spaces. The former are copied by hand, and spaces that
nothing was drawn from are shared.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from gymnasium import spaces

_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete, spaces.Text)
_BITS = (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64)


class Copies:
    """Makes copies of `env`, of copies of it, and of what becomes of these."""

    def __init__(self, env: Any) -> None:
        held = vars(env.unwrapped).values()
        self._shared = [space for space in held if type(space) in _SPACES and space._np_random is None]
        self._before = [_told(space) for space in self._shared]

    def of(self, env: Any) -> Any:
        """A copy. Raises what the environment's own methods raise, and ``TypeError`` where it cannot be copied."""
        memo = {id(space): space for space in self._shared}
        for held in vars(env.unwrapped).values():
            if type(held) is np.random.Generator:
                memo |= _generator(held)
        return copy.deepcopy(env, memo)

    @property
    def apart(self) -> bool:
        """Whether no copy has changed what all of them share."""
        return [_told(space) for space in self._shared] == self._before


def _told(space: Any) -> dict[str, Any]:
    """All that a space consists of."""
    return {name: value.tobytes() if type(value) is np.ndarray else repr(value) for name, value in vars(space).items()}


def _generator(held: np.random.Generator) -> dict[int, Any]:
    """The copy of a generator and of what it consists of, by the ids of the originals; none of one of another kind."""
    bits: Any = held.bit_generator
    if type(bits) not in _BITS or type(bits.seed_seq) is not np.random.SeedSequence:
        return {}
    # It counts the generators that were spawned from it.
    seeds = copy.copy(bits.seed_seq)
    copied = type(bits)(seeds)
    copied.state = bits.state
    return {id(bits.seed_seq): seeds, id(bits): copied, id(held): np.random.Generator(copied)}
