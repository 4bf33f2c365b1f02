"""Copies of an environment, as `copy.deepcopy` makes them and sooner.

Most of what that takes goes into a random generator, which is made anew from the system's entropy before it gets its
state, and into the bounds of spaces, which hardly a game changes. Generators are copied by hand, and spaces that
nothing was drawn from are shared, but for copies that a proof rests on.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from gymnasium import spaces

_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete, spaces.Text)
_BITS = (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64)


class Copies:
    """Makes copies of `env`, of copies of it, and of what becomes of these; with `exact`, nothing is shared."""

    def __init__(self, env: Any, exact: bool = False) -> None:
        held = () if exact else vars(env.unwrapped).values()
        self._shared = [space for space in held if type(space) in _SPACES and space._np_random is None]

    def of(self, env: Any) -> Any:
        """A copy. Raises what the environment's own methods raise, and ``TypeError`` where it cannot be copied."""
        memo = {id(space): space for space in self._shared}
        for held in vars(env.unwrapped).values():
            if type(held) is np.random.Generator:
                memo |= _generator(held)
        return copy.deepcopy(env, memo)


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
