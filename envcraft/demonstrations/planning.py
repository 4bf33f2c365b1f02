"""Planning for privileged players: searches on copies of a game's own state.

A :class:`Model` copies an environment and steps the copies, so the rules are those of the game itself. Copies draw no
pictures and have random generators of their own: a plan meets the same random events as the game, and the game does not
notice the search. :func:`best_first` finds a sequence of macro-actions to a goal (A* [1]_, weighted or greedy), and
:func:`beam` the best continuation within a horizon. :class:`Planner` is the base of policies that plan and follow their
plan.

This module needs the standard library and NumPy only. A policy runs in the sandbox, where EnvCraft is not installed, so
:func:`envcraft.demonstrations.player.policy_with_planning` puts this text in front of the policy's own.

.. [1] Hart, Nilsson and Raphael, A Formal Basis for the Heuristic Determination of Minimum Cost Paths, 1968.
"""

from __future__ import annotations

import copy
import heapq
import itertools
import types
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

Action = tuple[int, ...]
#: Actions that are played one after the other and count as one choice of a search.
Macro = tuple[Action, ...]

_CONSTANT = (int, float, bool, str, bytes, tuple, frozenset, type(None), types.FunctionType, types.MethodType, type)
_PLAIN = frozenset(_CONSTANT)
_CONTAINERS = frozenset({list, dict, set, deque, bytearray, np.ndarray})


class _LazyGenerator:
    """A copy of a random generator. It is made at the first use, since most steps draw no number."""

    def __init__(self, original: np.random.Generator, state: Any = None) -> None:
        self._original, self._state = original, state
        self._own: np.random.Generator | None = None

    def fork(self) -> _LazyGenerator:
        return _LazyGenerator(self._original, self._own.bit_generator.state if self._own is not None else self._state)

    def __getattr__(self, name: str) -> Any:
        if self._own is None:
            bits: Any = type(self._original.bit_generator)(0)
            bits.state = self._state if self._state is not None else self._original.bit_generator.state
            self._own = np.random.Generator(bits)
        return getattr(self._own, name)


def _copied(value: Any) -> Any:
    kind = type(value)
    if kind in _PLAIN:
        return value
    if kind is list:
        return [_copied(item) for item in value] if any(type(item) not in _PLAIN for item in value) else value.copy()
    if kind is dict:
        return {key: _copied(item) for key, item in value.items()}
    if kind is set or kind is np.ndarray:
        return value.copy()
    if kind is _LazyGenerator:
        return value.fork()
    if kind is np.random.Generator:
        return _LazyGenerator(value)
    return copy.deepcopy(value)


def _no_picture(*_: Any) -> None:
    pass


class Outcome(NamedTuple):
    """The result of playing actions: the sum of the rewards, whether the episode is over, and whether it is won."""

    reward: float
    over: bool
    won: bool


class Model:
    """Copies of an environment, and their steps.

    Attributes are copied by value. Tuples count as constants: what they hold must not change.

    Args:
        shared: Attributes that steps do not change, such as spaces; copies share them.
        silent: Methods that only draw; copies do without them, and their observations are None.
        success: The key of the info that is true after a win.

    Attributes:
        spent: The number of simulated steps so far.
    """

    def __init__(
        self,
        shared: Iterable[str] = ("observation_space", "action_space", "metadata", "spec"),
        silent: Iterable[str] = ("render",),
        success: str = "is_success",
    ) -> None:
        self.spent = 0
        self._shared, self._silent, self._success = frozenset(shared), tuple(silent), success

    def fork(self, env: Any) -> Any:
        """Copy an environment or one of its copies. A step of the copy leaves the original as it is."""
        ghost = object.__new__(type(env))
        state = ghost.__dict__
        for name, value in env.__dict__.items():
            state[name] = value if type(value) in _PLAIN or name in self._shared else _copied(value)
        for name in self._silent:
            state[name] = _no_picture
        return ghost

    def play(self, ghost: Any, macro: Macro) -> Outcome:
        """Step a copy until the macro-action or the episode ends."""
        total = 0.0
        over = won = False
        for action in macro:
            self.spent += 1
            _, reward, terminated, truncated, info = ghost.step(action)
            total += float(reward)
            over, won = bool(terminated or truncated), bool(info.get(self._success))
            if over:
                break
        return Outcome(total, over, won)


class Plan(NamedTuple):
    """The result of a search.

    Attributes:
        actions: What to play.
        reached: Whether the goal is reached.
        end: The copy in the last state; None for an empty plan.
    """

    actions: tuple[Action, ...]
    reached: bool
    end: Any = None


#: The macro-actions to try in a state.
Moves = Callable[[Any], Iterable[Macro]]


class _Node:
    """A state of a search, with the way to it."""

    __slots__ = ("cost", "ghost", "macro", "parent")

    def __init__(self, ghost: Any, macro: Macro, parent: _Node | None, cost: float) -> None:
        self.ghost, self.macro, self.parent, self.cost = ghost, macro, parent, cost

    def actions(self) -> tuple[Action, ...]:
        return tuple(itertools.chain.from_iterable(reversed([node.macro for node in self._back()])))

    def _back(self) -> Iterator[_Node]:
        node: _Node | None = self
        while node is not None:
            yield node
            node = node.parent


def best_first(
    model: Model,
    start: Any,
    moves: Moves,
    estimate: Callable[[Any], float],
    key: Callable[[Any], Hashable],
    budget: int,
    weight: float = 1.0,
    goal: Callable[[Any, Outcome], bool] | None = None,
) -> Plan:
    """Search for the goal in the order of steps so far plus the estimate.

    Args:
        model: The model.
        start: The environment, or a copy; it is not stepped.
        moves: The macro-actions to try in a state.
        estimate: The steps from a state to the goal. The plan is the shortest if this never exceeds them and `weight`
            is at most 1.
        key: Identifies a state; of two states with the same key, the one with the longer way is dropped.
        budget: The most simulated steps.
        weight: The factor of the estimate; a larger one searches fewer states and finds longer plans.
        goal: Whether a state, with the outcome of the last macro-action, is the goal; by default a win. A state in
            which the episode is over and not won is never a goal.

    Returns:
        The plan to the goal. Without one, the plan to the state with the lowest estimate, which `reached` tells.
    """
    limit = model.spent + budget
    root = _Node(start, (), None, 0.0)
    ties = itertools.count()
    nearest, least = root, float("inf")
    reached: _Node | None = None
    waiting = [(weight * estimate(start), next(ties), root)]
    known: dict[Hashable, float] = {key(start): 0.0}
    while waiting:
        _, _, node = heapq.heappop(waiting)
        if node is reached:
            break
        if node.cost > known.get(key(node.ghost), node.cost):
            continue
        for macro in moves(node.ghost):
            if model.spent >= limit:
                waiting.clear()
                break
            ghost = model.fork(node.ghost)
            before = model.spent
            outcome = model.play(ghost, macro)
            cost = node.cost + model.spent - before
            child = _Node(ghost, macro, node, cost)
            if outcome.won or (not outcome.over and goal is not None and goal(ghost, outcome)):
                # A shorter way may still be among the states that wait.
                if reached is None or cost < reached.cost:
                    reached = child
                    heapq.heappush(waiting, (cost, next(ties), child))
                continue
            if outcome.over:
                continue
            mark = key(ghost)
            if cost >= known.get(mark, float("inf")):
                continue
            known[mark] = cost
            rest = estimate(ghost)
            if rest < least:
                nearest, least = child, rest
            heapq.heappush(waiting, (cost + weight * rest, next(ties), child))
    if reached is not None:
        return Plan(reached.actions(), True, reached.ghost)
    return Plan(nearest.actions(), False, nearest.ghost if nearest is not root else None)


def beam(
    model: Model,
    start: Any,
    moves: Moves,
    value: Callable[[Any, float], float],
    depth: int,
    width: int,
    budget: int,
    key: Callable[[Any], Hashable] | None = None,
) -> Plan:
    """Search a number of macro-actions ahead, keeping the best states of each depth.

    Args:
        model: The model.
        start: The environment, or a copy; it is not stepped.
        moves: The macro-actions to try in a state.
        value: Rates a state, given the rewards on the way to it; higher is better.
        depth: The number of macro-actions ahead.
        width: The number of states that are kept at each depth.
        budget: The most simulated steps.
        key: Identifies a state; of states with the same key, the best is kept.

    Returns:
        The plan to the first win, else to the best state at the greatest depth that any play survives. It is empty if
        every first macro-action loses.
    """
    limit = model.spent + budget
    # A node's cost is the sum of its rewards here.
    kept = [_Node(start, (), None, 0.0)]
    for _ in range(depth):
        found: list[tuple[float, int, _Node]] = []
        for node in kept:
            for macro in moves(node.ghost):
                if model.spent >= limit:
                    break
                ghost = model.fork(node.ghost)
                outcome = model.play(ghost, macro)
                child = _Node(ghost, macro, node, node.cost + outcome.reward)
                if outcome.won:
                    return Plan(child.actions(), True, ghost)
                if not outcome.over:
                    found.append((value(ghost, child.cost), -len(found), child))
        if not found or model.spent >= limit:
            break
        found.sort(key=lambda entry: entry[:2], reverse=True)
        kept, marks = [], set()
        for _, _, node in found:
            mark = key(node.ghost) if key is not None else id(node)
            if mark not in marks:
                marks.add(mark)
                kept.append(node)
            if len(kept) == width:
                break
    best = kept[0]
    return Plan(best.actions(), False, best.ghost if best.parent is not None else None)


class Planner:
    """The base of policies that plan: a subclass implements :meth:`plan`.

    Attributes:
        model: Copies and steps the environment.
        idle: The action to play when there is no plan.
        commit: The most actions of a plan that are played before the next plan.
    """

    idle: Action = (0, 0, 0)
    commit = 1000

    def __init__(self) -> None:
        self.model = Model()
        self._plan: list[Action] = []

    def plan(self, env: Any) -> Sequence[Action]:
        """The actions to play from this state on. `env` must not be changed: :attr:`model` copies it."""
        raise NotImplementedError

    def act(self, state: Any) -> Action:
        """The next action: the rest of the last plan, or the start of a new one."""
        if not self._plan:
            # The state gives access to attributes only; a bound method knows its object.
            self._plan = list(self.plan(state.step.__self__))[: self.commit][::-1]
        return self._plan.pop() if self._plan else self.idle
