"""The simulator of any number of variants, as a Gymnasium ``VectorEnv``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from envcraft.environments.vector import seed_list
from envcraft_tetris.variant import Variant
from envcraft_tetris.vectorized import kernel
from envcraft_tetris.vectorized.pcg64 import state_of
from envcraft_tetris.vectorized.records import GAME, RULES, SIZE, fill
from envcraft_tetris.vectorized.rendering import UNDRAWN


class Simulator(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """One game per variant. Games match the generated files of their variants bit for bit."""

    def __init__(
        self,
        variants: Sequence[Variant],
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
    ) -> None:
        """Make the games. Without `copy`, observations are a read-only view of frames that the next call changes."""
        places: dict[Variant, int] = {}
        self._which = np.array([places.setdefault(variant, len(places)) for variant in variants])
        self._rules = np.zeros(len(places), RULES)
        for variant, place in places.items():
            fill(self._rules[place], variant)
        count = self.num_envs = len(variants)
        self._mode, self._copy = autoreset_mode, copy
        self.single_observation_space = gymnasium.spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.single_action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_modes": ["rgb_array"]}
        self.render_mode = "rgb_array"
        self._games = np.zeros(count, GAME)
        self._games["shown_time"] = UNDRAWN
        self._seeded, self._ended = np.zeros((2, count), np.bool_)
        self._actions = np.zeros((count, 3), np.int64)
        self._rewards = np.zeros(count)
        self._terminated, self._truncated = np.zeros((2, count), np.bool_)
        self._frames = np.zeros((count, SIZE, SIZE, 3), np.uint8)
        # Rendering is incremental, so that callers get a read-only view.
        self._shown = self._frames.view()
        self._shown.flags.writeable = False
        colour = np.array([variant.clearing.rule == "colour" for variant in variants])
        wins = np.array([variant.ending.wins for variant in variants])
        # Keys of the infos, the environments that have them, and the fields with their values.
        columns = (("is_success", wins, "won"), ("groups", colour, "cleared"), ("lines", ~colour, "cleared"))
        everywhere = ("steps", np.ones(count, np.bool_), "steps")
        self._columns = [column for column in (*columns, everywhere) if column[1].any()]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the games, or with ``options["reset_mask"]`` those where it is True; there are no other options."""
        seeds = seed_list(seed, self.num_envs)
        chosen = np.ones(self.num_envs, np.bool_)
        if options and "reset_mask" in options:
            chosen = options["reset_mask"]
        for number in np.flatnonzero(chosen).tolist():
            seed = seeds[number]
            if seed is not None or not self._seeded[number]:
                self._games["random"][number] = state_of(np_random(seed)[0])
                self._seeded[number] = True
        self._play(np.where(chosen, kernel.RESET, kernel.NOTHING))
        self._ended[chosen] = False
        return self._observations(), self._infos(chosen)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step all games. Ended games reset in the same or the next step, depending on the autoreset mode."""
        np.copyto(self._actions, actions, casting="same_kind")
        due = self._ended & (self._mode is AutoresetMode.NEXT_STEP)
        self._play(np.where(due, kernel.RESET, kernel.STEP))
        rewards, terminated, truncated = self._rewards.copy(), self._terminated.copy(), self._truncated.copy()
        self._ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            infos = self._restart(self._ended)
        else:
            infos = self._infos(None)
        return self._observations(), rewards, terminated, truncated, infos

    def _observations(self) -> NDArray[np.uint8]:
        return self._frames.copy() if self._copy else self._shown

    def _play(self, doing: NDArray[np.int64]) -> None:
        results = self._rewards, self._terminated, self._truncated
        kernel.play(self._rules, self._which, self._games, doing, self._actions, *results, self._frames)

    def _restart(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Reset the ended games, and return the infos with the final observations and infos."""
        finals = np.full(len(ended), None, object)
        for number in np.flatnonzero(ended):
            finals[number] = self._frames[number].copy()
        ends = {"final_obs": finals, "final_info": self._infos(ended)}
        self._play(np.where(ended, kernel.RESET, kernel.NOTHING))
        return {**ends, **{f"_{key}": ended.copy() for key in ends}, **self._infos(None)}

    def _infos(self, selected: NDArray[np.bool_] | None) -> dict[str, Any]:
        """The batched infos of all games, or of those where `selected` is True."""
        infos: dict[str, Any] = {}
        for key, mask, name in self._columns:
            known = mask.copy() if selected is None else mask & selected
            if selected is None or known.any():
                dtype = np.bool_ if key == "is_success" else np.int64
                infos[key] = np.where(known, self._games[name], 0).astype(dtype)
                infos[f"_{key}"] = known
        return infos

    def advise(self, wanted: NDArray[np.bool_]) -> NDArray[np.float32]:
        """What a player who sees the states would do in the `wanted` games [num_envs]: the probabilities of the joint
        actions, [num_envs, actions]. The rows of other games have no meaning.
        """
        from envcraft_tetris.vectorized import advice

        return advice.probabilities(advice.rate(self._rules, self._which, self._games, wanted))

    def render(self) -> tuple[Any, ...]:
        """Copies of the current frames."""
        return tuple(frame.copy() for frame in self._frames)
