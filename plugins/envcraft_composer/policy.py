"""The player of the family `composer`: plans from one step of progress to the next.

The text of this file, with that of :mod:`envcraft.demonstrations.planning` in front, is the policy that runs beside the
environment. It searches with the game's own rules for the nearest state with less left to do that the avatar survives.
The estimate of a state is the way to the nearest target: on cells by a flood over the game's own steps, on a plane by
the distance. Where nothing is found, it plays the beginning of the best plan and looks again.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterable, Sequence
from typing import Any

from envcraft.demonstrations.planning import Action, Macro, Model, Outcome, Plan, Planner, beam, best_first

#: Simulated steps for a plan; pushing crates needs a search to the end of the game.
_BUDGET, _CRATES = 3_000, 60_000
#: Simulated steps in an episode after which plans get the least budget, with crates and without.
_CRATES_ALLOWANCE, _ALLOWANCE, _LEAST = 150_000, 80_000, 300
#: Simulated steps of a second search where the first finds nothing.
_MORE = 8_000
#: Steps that are played of a plan that reaches nothing.
_GROPE = 8
#: Steps for which a state must be survived to count as reached, on cells and on a plane.
_SAFE, _SAFE_ON_PLANE = 7, 12
#: States that are kept while that is looked at.
_WIDTH = 3
#: Attributes of a game that can hurt soon.
_THREATS = ("foes", "cars", "fire", "spikes", "body")
#: Steps of a macro-action on a plane.
_STRIDE = 4
#: What the loss of a life counts as, in steps.
_ACCIDENT = 40.0
#: What each part of the goal counts as, in steps, that the search itself undoes.
_UNDONE = 5.0
#: The pushes that a crate in a dead end counts as.
_STUCK = 1000
#: Where on the paddle the ball is to bounce, in pixels from the middle.
_BOUNCES = (-10, -7, -4, -2, 0, 2, 4, 7, 10)
#: Attributes that tell states apart, besides the place and what is left.
_PARTS = (
    *("heading", "stride", "facing", "inside", "rise", "carries", "body", "paddle", "lit", "standing"),
    *("reload", "train", "lives", "sheep", "marks", "lifts", "pointer"),
)
#: Attributes that no step changes.
_SHARED = (
    *("walls", "picture", "observation_space", "action_space", "metadata"),
    *("taken", "spikes", "free", "switches", "friends"),
)


class Composed(Planner):
    """Plays one episode."""

    def __init__(self) -> None:
        super().__init__()
        self.model = Model(shared=_SHARED, silent=("render", "_stain"))
        self._floods: dict[Any, dict[Any, int]] = {}
        self._pushes: dict[Any, float] = {}

    def plan(self, env: Any) -> Sequence[Action]:
        game = self.model.fork(env)
        game.picture = None
        self._plane = isinstance(env.at[0], float)
        actions = env.get_state()["actions"]
        stride = _STRIDE if self._plane else 1
        self._moves: list[Macro] = [(tuple(action),) * stride for action in actions]
        self._moves += [((0, 0, 0),) * stride] if (0, 0, 0) not in actions else []
        self._constants = constants = env.step.__func__.__globals__
        self._cycle = constants.get("BEAT", constants.get("PERIOD", 1))
        self._whole_cycle = _cycle(constants)
        self._reach: float = constants.get("SPEED", 1.0)
        self._lives, self._fuel = getattr(env, "lives", 0), getattr(env, "energy", 0.0) + env.clock
        self._before = before = env._remaining()
        if hasattr(env, "crates"):
            budget = max(min(_CRATES, _CRATES_ALLOWANCE - self.model.spent), _LEAST)
            found = self._search(game, lambda ghost, _: False, self._to_marks, budget, 2.0)
            return found.actions if found.reached else found.actions[:_GROPE]

        estimate = self._to_merge if hasattr(env, "drops") else self._to_target
        budget = max(min(_BUDGET, _ALLOWANCE - self.model.spent), _LEAST)

        def progress(ghost: Any, _: Outcome) -> bool:
            return bool(ghost._remaining() < before) and self._roomy(ghost) and self._survives(ghost)

        def unharmed(ghost: Any, outcome: Outcome) -> bool:
            return self._lost(ghost) == 0 and progress(ghost, outcome)

        found = self._search(game, unharmed, estimate, budget, 1.5)
        if not found.reached and budget == _BUDGET:
            self._cycle = self._whole_cycle
            for goal in (unharmed, progress):
                found = found if found.reached else self._search(game, goal, estimate, _MORE, 1.5)
        if hasattr(env, "flight"):
            return found.actions
        return found.actions if found.reached else found.actions[:_GROPE]

    def _search(self, game: Any, goal: Any, estimate: Any, budget: int, weight: float) -> Plan:
        return best_first(self.model, game, self._choices, estimate, self._key, budget, weight, goal)

    def _choices(self, ghost: Any) -> Iterable[Macro]:
        return self._bounces(ghost) if hasattr(ghost, "flight") else self._moves

    def _bounces(self, ghost: Any) -> Iterable[Macro]:
        """The moves of the paddle to the ball's next landing, to meet it at each of some places."""
        paddle = self._constants
        width, cell = paddle["WIDTH"], paddle["CELL"]
        (y, x), (vy, vx) = ghost.at, ghost.flight
        steps = 1
        while not (vy > 0 and y + vy >= 73 - cell) and steps < 100:
            y, x = y + vy, x + vx
            if x < 1 or x > 83 - cell:
                vx, x = -vx, min(max(x, 1.0), 83.0 - cell)
            if y < 6:
                vy, y = -vy, 6.0
            steps += 1
        landing = min(max(x + vx, 1.0), 83.0 - cell) + cell / 2
        for place in _BOUNCES:
            way = landing - place - width / 2 - ghost.paddle
            move = 4 if way > 0 else 3
            fast, slow = divmod(round(abs(way) / 2), 2)
            yield (((move, 1, 0),) * fast + ((move, 0, 0),) * slow + ((0, 0, 0),) * steps)[:steps]

    def _roomy(self, ghost: Any) -> bool:
        """Whether a snake has a region around its head that holds its body."""
        body = getattr(ghost, "body", ())
        known, found = {ghost.at, *body[:-1]}, [ghost.at]
        for place in found:
            if len(found) > len(body):
                break
            fresh = {ghost._shift(place, move) for move in range(1, 5)} - known
            known |= fresh
            found += sorted(fresh)
        return len(found) > len(body)

    def _survives(self, ghost: Any) -> bool:
        """Whether some play goes on for a while."""
        if not any(hasattr(ghost, name) for name in _THREATS):
            return True
        safe = _SAFE_ON_PLANE if self._plane else _SAFE
        depth = -(-safe // len(self._moves[0]))
        found = beam(self.model, ghost, self._choices, lambda end, _: -self._lost(end), depth, _WIDTH, 1_000, self._key)
        return found.reached or (len(found.actions) >= safe and self._lost(found.end) <= self._lost(ghost))

    def _key(self, ghost: Any) -> Hashable:
        place = ghost.at if not self._plane else (round(ghost.at[0] / 2), round(ghost.at[1] / 2))
        parts = tuple(_frozen(getattr(ghost, name)) for name in _PARTS if hasattr(ghost, name))
        foes = tuple(_frozen(foe[0]) for name in ("foes", "cars") for foe in getattr(ghost, name, ())[:8])
        drift = tuple(round(2 * part) for part in (*getattr(ghost, "drift", ()), *getattr(ghost, "flight", ())))
        crates = tuple(sorted(getattr(ghost, "crates", getattr(ghost, "drops", ()))))
        return place, ghost._remaining(), parts, foes, drift, crates, ghost.clock % self._cycle

    def _lost(self, ghost: Any) -> float:
        """What accidents since the start of the search count."""
        if hasattr(ghost, "lives"):
            return float(_ACCIDENT * (self._lives - ghost.lives))
        if hasattr(ghost, "energy"):
            # Each step costs one, which is no loss.
            return float(max(self._fuel - ghost.energy - ghost.clock, 0.0))
        return 0.0

    def _to_target(self, ghost: Any) -> float:
        """The steps to the nearest target, and what accidents count."""
        targets = ghost._targets()
        lost: float = self._lost(ghost) + _UNDONE * max(ghost._remaining() - self._before, 0)
        if not targets:
            return lost
        if self._plane:
            y, x = ghost.at
            return lost + float(min(abs(y - v) + abs(x - u) for v, u in targets)) / self._reach
        if hasattr(ghost, "pointer"):
            y, x = ghost.pointer
            return lost + float(min(abs(y - v) + abs(x - u) for v, u in targets)) + 1.0
        flood = self._flood(ghost, tuple(targets))
        away = flood.get(ghost.at, 50)
        # A shot does not hit the cell that it leaves.
        return lost + float(away if away or not hasattr(ghost, "beam") else 2)

    def _to_marks(self, ghost: Any) -> float:
        """The pushes of each crate to a mark of its own, and the way to the nearest crate that is not on one."""
        crates = tuple(sorted(ghost.crates))
        if crates not in self._pushes:
            away = [self._pulls(ghost, mark) for mark in ghost.marks]
            orders = itertools.permutations(crates)
            self._pushes[crates] = min(
                sum(pulls.get(crate, _STUCK) for pulls, crate in zip(away, order, strict=True)) for order in orders
            )
        rest = [crate for crate in crates if crate not in ghost.marks]
        walk = min((abs(y - ghost.at[0]) + abs(x - ghost.at[1]) for y, x in rest), default=0)
        return 2.0 * self._pushes[crates] + walk

    def _pulls(self, ghost: Any, mark: Any) -> dict[Any, int]:
        """The pushes from each cell to a mark for a crate alone; a cell that is missing is a dead end."""
        if (mark,) not in self._floods:
            pulls = {mark: 0}
            cells = [mark]
            for cell in cells:
                for push, pull in ((1, 2), (2, 1), (3, 4), (4, 3)):
                    before = ghost._shift(cell, pull)
                    if before in pulls or ghost._shift(before, push) != cell or ghost._shift(before, pull) == before:
                        continue
                    pulls[before] = pulls[cell] + 1
                    cells.append(before)
            self._floods[mark,] = pulls
        return self._floods[mark,]

    def _to_merge(self, ghost: Any) -> float:
        """The pushes between the two nearest drops, the way to a drop, and what accidents count."""
        drops = sorted(ghost.drops)
        floods = [self._flood(ghost, (drop,)) for drop in drops]
        apart = [flood.get(other, 99) for number, flood in enumerate(floods) for other in drops[:number]]
        walk = min(flood.get(ghost.at, 99) for flood in floods)
        return 2.0 * min(apart) + walk + self._lost(ghost)

    def _flood(self, ghost: Any, targets: tuple[Any, ...]) -> dict[Any, int]:
        """The steps from each cell to the nearest target, by the steps of the game's world."""
        if targets not in self._floods:
            distance = dict.fromkeys(targets, 0)
            cells = list(targets)
            for cell in cells:
                for move in range(1, 5):
                    after = ghost._shift(cell, move)
                    if after not in distance:
                        distance[after] = distance[cell] + 1
                        cells.append(after)
            if len(self._floods) > 300:
                self._floods.clear()
            self._floods[targets] = distance
        return self._floods[targets]


def _cycle(constants: dict[str, Any]) -> int:
    """The number of steps after which the rules of a game with these constants repeat."""
    lengths = [constants.get(name, 1) for name in ("BEAT", "PERIOD", "FLEE")]
    lengths += [2 * constants.get("CYCLE", 1), 2 * constants.get("EBB", 1) * constants.get("HIGH", 1)]
    return math.lcm(*lengths, 3 if "MUD" in constants else 1, 2 if "BELTS" in constants else 1)


def _frozen(value: Any) -> Hashable:
    """A hashable image of a part of a state, points rounded to pixels."""
    if isinstance(value, list | tuple):
        return tuple(_frozen(item) for item in value)
    return round(value) if isinstance(value, float) else value
