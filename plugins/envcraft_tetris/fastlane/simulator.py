"""The simulator: any number of games of any variants, as the environments of an ``envcraft.using.vector.VectorEnv``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from envcraft_runtime.spaces import describe
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from envcraft.using.group import Arrays, Layout
from envcraft_tetris.variant import Variant

from . import kernel
from .chance import state_of
from .drawing import UNDRAWN
from .tables import GAME, RULES, SIZE, fill

_SPACES: dict[str, Any] = {
    "observation": describe(gymnasium.spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)),
    "action": describe(gymnasium.spaces.MultiDiscrete([5, 2, 2])),
}


class Simulator:
    """Games of `variants`, one each. They behave as the files of these variants do, bit for bit.

    Attributes:
        spaces: as those of other members of a vector are told.
        groups: of processes there is one, this one.
    """

    groups = 1

    def __init__(self, variants: Sequence[Variant]) -> None:
        places: dict[Variant, int] = {}
        self._which = np.array([places.setdefault(variant, len(places)) for variant in variants])
        self._rules = np.zeros(len(places), RULES)
        for variant, place in places.items():
            fill(self._rules[place], variant)
        self._games = np.zeros(len(variants), GAME)
        self._games["shown_time"] = UNDRAWN
        self._seeded = np.zeros(len(variants), np.bool_)
        self.spaces = [_SPACES] * len(variants)
        colour = np.array([variant.clearing.rule == "colour" for variant in variants])
        wins = np.array([variant.ending.wins for variant in variants])
        # Which environments have a key in their infos, and the field of a game that is its value.
        columns = (("is_success", wins, "won"), ("groups", colour, "cleared"), ("lines", ~colour, "cleared"))
        everywhere = ("steps", np.ones(len(variants), np.bool_), "steps")
        self._columns = [column for column in (*columns, everywhere) if column[1].any()]

    def attach(self, layout: Layout, same_step: bool) -> Arrays:
        """Make the arrays. The observations cannot be written to from outside: only what changes is drawn."""
        self._arrays, self._same_step = Arrays(layout), same_step
        self._frames = self._arrays.observations
        self._arrays.observations = self._frames.view()
        self._arrays.observations.flags.writeable = False
        return self._arrays

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None) -> dict[str, Any]:
        """Reset the games whose bit is set; the environments take no options."""
        chosen = self._arrays.resets
        for number in np.flatnonzero(chosen).tolist():
            seed = seeds[number]
            if seed is not None or not self._seeded[number]:
                self._games["random"][number] = state_of(np_random(seed)[0])
                self._seeded[number] = True
        self._play(np.where(chosen, kernel.BEGIN, kernel.NOTHING))
        return self._infos(chosen)

    def step(self) -> dict[str, Any]:
        """Step all games, and begin those anew that are to be."""
        arrays = self._arrays
        self._play(np.where(arrays.resets, kernel.BEGIN, kernel.STEP))
        if self._same_step:
            ended = arrays.terminated | arrays.truncated
            if ended.any():
                return self._begun_anew(ended)
        return self._infos(None)

    def _play(self, doing: NDArray[np.int64]) -> None:
        arrays = self._arrays
        results = arrays.rewards, arrays.terminated, arrays.truncated
        kernel.play(self._rules, self._which, self._games, doing, arrays.actions, *results, self._frames)

    def _begun_anew(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        arrays = self._arrays
        finals = np.full(len(ended), None, object)
        for number in np.flatnonzero(ended):
            finals[number] = self._frames[number].copy()
        final_info = self._infos(ended)
        # The step's own reward and flags stay.
        kept = arrays.rewards.copy(), arrays.terminated.copy(), arrays.truncated.copy()
        self._play(np.where(ended, kernel.BEGIN, kernel.NOTHING))
        arrays.rewards[:], arrays.terminated[:], arrays.truncated[:] = kept
        told = {"final_obs": finals, "final_info": final_info}
        return {**told, **{f"_{key}": ended.copy() for key in told}, **self._infos(None)}

    def _infos(self, about: NDArray[np.bool_] | None) -> dict[str, Any]:
        """What the games tell, as Gymnasium batches infos, of all or of those where `about` is True."""
        infos: dict[str, Any] = {}
        for key, mask, name in self._columns:
            known = mask.copy() if about is None else mask & about
            if about is None or known.any():
                dtype = np.bool_ if key == "is_success" else np.int64
                infos[key] = np.where(known, self._games[name], 0).astype(dtype)
                infos[f"_{key}"] = known
        return infos

    def render(self) -> list[Any]:
        return [frame.copy() for frame in self._frames]

    def close(self) -> None:
        """There is nothing to end."""
