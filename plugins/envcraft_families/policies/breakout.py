"""Plays the family `breakout`: goes where the ball will come down, to the side from which it then does most.

The flights of the ball are played on copies of the game, so they keep to its rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import Any

from envcraft.demonstrations.planning import Action, Planner

#: The most steps of a flight.
_FLIGHT = 160
#: Steps within which a ball that was not caught is lost, and what a catch that comes too late costs, in hits.
_MISSED, _LATE = 5, 10.0


class BreakoutPolicy(Planner):
    """Plays one episode."""

    commit = 400

    def plan(self, env: Any) -> Sequence[Action]:
        """The actions until the ball has left the paddle, from which its next flight is the best."""
        width = self._width(env)
        if env.held:
            rules = type(env).step.__globals__
            return [(rules["LESS"] if env.paddle > 0 else rules["MORE"], 0, 1)]
        down = self._flight(env)
        if down is None:
            return [(0, 0, 0)] * 4
        steps, place = down
        # Flights that hit nothing differ by chance, so that no course repeats for ever.
        chance = Random(env.steps)
        best = float("-inf")
        chosen: list[Action] = [(0, 0, 0)]
        for number in range(7):
            target = place + 1 - width * (2 * number + 1) // 14
            for last in (0, 1, -1):
                actions = self._approach(env, target, steps, last)
                worth = self._worth(env, actions) + 0.5 * chance.random()
                if worth > best:
                    best, chosen = worth, actions
        return chosen

    def _width(self, env: Any) -> int:
        return int(type(env).step.__globals__["PADDLE"])

    def _flight(self, env: Any) -> tuple[int, int] | None:
        """The steps until the ball is at the paddle's height on its way down, and where it is then."""
        ghost = self.model.fork(env)
        lives = ghost.lives
        floor = int(type(env).step.__globals__["FLOOR"]) - 3
        for step in range(1, _FLIGHT):
            before = ghost.ball[0]
            _let_fly(ghost)
            if ghost.lives < lives or ghost.won:
                return step, before
            if ghost.ball[1] >= floor and ghost.velocity[1] > 0:
                return step, ghost.ball[0]
        return None

    def _approach(self, env: Any, target: int, steps: int, last: int) -> list[Action]:
        """The actions that bring the paddle to a place in a number of steps, moving to a side at the end."""
        rules = type(env).step.__globals__
        speed, less, more = int(rules["SPEED"]), int(rules["LESS"]), int(rules["MORE"])
        place = env.paddle
        actions: list[Action] = []
        target -= last * speed
        for step in range(steps):
            if step == steps - 1 and last:
                actions.append((more if last > 0 else less, 0, 0))
                continue
            away = target - place
            if abs(away) <= speed // 2:
                actions.append((0, 0, 0))
            else:
                actions.append((more if away > 0 else less, 0, 0))
                place += speed if away > 0 else -speed
        return actions

    def _worth(self, env: Any, actions: Sequence[Action]) -> float:
        """What the flight after some actions does: hits, most of all on what the goal needs, and the next catch."""
        ghost = self.model.fork(env)
        for action in actions:
            ghost.step(action)
        if ghost.won:
            return 1e6
        if ghost.lives < env.lives:
            return -1e6
        hits = _hits(ghost)
        start, landing = ghost.paddle, ghost.ball[0]
        for step in range(_FLIGHT):
            _let_fly(ghost)
            if ghost.won:
                return 1e5 - step
            if ghost.lives < env.lives:
                # The paddle has missed the ball if it is lost so soon.
                late = step < _MISSED or abs(landing - start) > 4 * step
                break
            landing = ghost.ball[0]
        else:
            return -1e4
        return hits - _hits(ghost) - 0.01 * step - (_LATE if late else 0.0)


def _let_fly(ghost: Any) -> None:
    """Step a copy with the paddle out of the ball's way."""
    rules = type(ghost).step.__globals__
    ghost.paddle = 0 if ghost.ball[0] > rules["SIZE"] // 2 else rules["SIZE"] - rules["PADDLE"]
    ghost.step((0, 0, 0))


def _hits(env: Any) -> float:
    """The hits that bricks still take; those with a jewel count more."""
    hits = float(sum(map(sum, env.bricks)))
    for row, column in getattr(env, "jewels", ()):
        hits += 10.0 * env.bricks[row][column]
    return hits
