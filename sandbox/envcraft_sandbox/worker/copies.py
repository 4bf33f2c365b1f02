"""Copy environments as `copy.deepcopy` does, but faster.

Most of the time of a deep copy goes into random generators, which draw from the system's entropy before they get their
state, and into the bounds of spaces, which games rarely change. Generators are copied directly. Copies share the spaces
that nothing was sampled from, except copies that a proof relies on.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from gymnasium import spaces

_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete, spaces.Text)
_BITS = (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937, np.random.Philox, np.random.SFC64)


class Copies:
    """Makes copies of `env`, of its copies, and of their later states; with `exact` they share nothing."""

    def __init__(self, env: Any, exact: bool = False) -> None:
        held = () if exact else vars(env.unwrapped).values()
        self._shared = [space for space in held if type(space) in _SPACES and space._np_random is None]

    def of(self, env: Any) -> Any:
        """A copy. Raises what the environment's methods raise, and ``TypeError`` if it cannot be copied."""
        memo = {id(space): space for space in self._shared}
        for held in vars(env.unwrapped).values():
            if type(held) is np.random.Generator:
                memo |= _generator(held)
        return copy.deepcopy(env, memo)


def _generator(held: np.random.Generator) -> dict[int, Any]:
    """Copies of a generator and its parts by the ids of the originals; empty for an unknown kind of generator."""
    bits: Any = held.bit_generator
    if type(bits) not in _BITS or type(bits.seed_seq) is not np.random.SeedSequence:
        return {}
    # A seed sequence counts the generators that were spawned from it.
    seeds = copy.copy(bits.seed_seq)
    copied = type(bits)(seeds)
    copied.state = bits.state
    return {id(bits.seed_seq): seeds, id(bits): copied, id(held): np.random.Generator(copied)}
