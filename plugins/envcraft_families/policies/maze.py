"""Plays the family `maze`: the shortest way to the next key, door or gem, and at last to the goal.

The ways are searched on copies of the game, so they keep to its controls, spikes and pits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from envcraft.demonstrations.planning import Action, Model, Outcome, Planner, best_first

_BUDGET = 20_000


class MazePolicy(Planner):
    """Plays one episode."""

    def __init__(self) -> None:
        super().__init__()
        self.model = Model(
            shared=("observation_space", "action_space", "metadata", "spec", "walls", "picture", "spikes", "pits")
        )

    def plan(self, env: Any) -> Sequence[Action]:
        view, left = env.get_state(), _left(env)
        pace, turns, period = view["pace"], view["turns"], view["period"]
        waits = (0,) if period > 1 else ()
        moves = [((direction, 1, 1),) * pace for direction in (1, 2, 3, 4, *waits)]

        def place(ghost: Any) -> tuple[Any, ...]:
            return ghost.player, ghost.facing if turns else None, ghost.steps % period

        def progress(ghost: Any, _: Outcome) -> bool:
            return _left(ghost) < left

        return best_first(self.model, env, lambda _: moves, lambda _: 0.0, place, _BUDGET, goal=progress).actions


def _left(env: Any) -> int:
    """The number of things that the walker has still to reach."""
    return len(env.keys) + len(env.doors) + len(getattr(env, "gems", ())) - bool(getattr(env, "treasure", False))
