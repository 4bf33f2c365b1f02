"""Plays the family `shooter`: goes where a bullet will meet an enemy, shoots only what hits, and avoids shots.

What will come is played on copies of the game, so the policy keeps to its rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from envcraft.demonstrations.planning import Action, Planner

#: The steps that are foreseen: the flight of a bullet, and the danger to the ship.
_FLIGHT, _DANGER = 20, 9


class ShooterPolicy(Planner):
    """Plays one episode."""

    def plan(self, env: Any) -> Sequence[Action]:
        """The next action."""
        rules = type(env).step.__globals__
        self._less, self._more = int(rules["LESS"]), int(rules["MORE"])
        future = self._future(env, (0, 0, 0), _FLIGHT)
        wanted = self._towards(env, rules, future)
        moves = [wanted, *(move for move in (0, self._less, self._more) if move != wanted)]
        lives = {move: self._lives(env, move) for move in moves}
        safest = [move for move in moves if lives[move] == max(lives.values())]
        loaded = env.rest <= 1 and env.ammunition > 0
        # The ship moves before it shoots.
        hits = (move for move in safest if loaded and self._would_hit(env, move, future[-1]))
        move = next(hits, None)
        return [(safest[0], 0, 0) if move is None else (move, 1, 0)]

    def _future(self, env: Any, first: Action, steps: int) -> list[Any]:
        """Copies of the game after an action, and after each step of rest that follows."""
        ghost = self.model.fork(env)
        found = []
        for number in range(steps):
            ghost.step(first if number == 0 else (0, 0, 0))
            found.append(self.model.fork(ghost))
        return found

    def _would_hit(self, env: Any, move: int, without: Any) -> bool:
        """Whether a shot with this move hits what no bullet in flight hits."""
        ghost = self.model.fork(env)
        for number in range(_FLIGHT):
            ghost.step((move, 1, 0) if number == 0 else (0, 0, 0))
            if ghost.won:
                return True
        return _damage(ghost) > _damage(without)

    def _lives(self, env: Any, move: int) -> int:
        """The lives that are left after a move and some rest."""
        ghost = self.model.fork(env)
        for number in range(_DANGER):
            ghost.step((move if number < 3 else 0, 0, 0))
        return int(ghost.lives)

    def _towards(self, env: Any, rules: dict[str, Any], future: list[Any]) -> int:
        """The direction to where a bullet meets the enemy that is most urgent and near."""
        ship, size = int(rules["SHIP"]), int(rules["ENEMY"])
        best, aim = float("inf"), None
        for number, enemy in enumerate(env.enemies):
            flight = min(_FLIGHT - 1, max(0, (rules["FLOOR"] - 3 - enemy[1]) // int(rules["BULLET_SPEED"])))
            ahead = future[flight].enemies
            then = ahead[number] if len(ahead) == len(env.enemies) else enemy
            away = then[0] + size // 2 - (env.ship + ship // 2)
            cost = abs(away) - 0.8 * enemy[1]
            if cost < best:
                best, aim = cost, away
        if aim is None or abs(aim) <= 2:
            return 0
        # A gliding ship goes on for some steps.
        rest = aim - env.drift * abs(env.drift) // 2
        if abs(rest) <= 1:
            return 0
        return self._more if rest > 0 else self._less


def _damage(env: Any) -> int:
    """The hits that have struck: kills count more than any hits that are left."""
    return int(1000 * env.kills - sum(enemy[2] for enemy in env.enemies))
