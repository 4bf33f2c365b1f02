"""Searches that need the environment's state: for crashes, for wins, and for the end of the reachable states.

Their results are only hints: the host repeats every list of actions in an ordinary rollout and trusts only that trace.
Each search has a budget in environment steps, so its result does not depend on the machine. The searches that follow
what looks promising are in :mod:`envcraft_sandbox.worker.exploration`, the one for restarts of the step counter in
:mod:`envcraft_sandbox.worker.outlasting`, and the look at cells in :mod:`envcraft_sandbox.worker.enclosed`; those that
try everything they can are here.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from itertools import compress, pairwise
from typing import Any

from envcraft_protocol.jobs import Job
from envcraft_protocol.wire import Kind

from .enclosed import enclosed
from .exploration import explore, horizon, places, simple
from .outlasting import outlast
from .state import State
from .subject import Subject, attributes
from .tree import Node, Tree, frame_hash, global_generators

_monotonic = time.monotonic

#: Number of readings that show whether a number counts steps.
_READINGS = 6
#: Number of whole episodes that check the states of an exhausted search.
_EPISODES = 3
#: States after which :func:`reach` leaves out actions without an effect of their own.
_ALIKE = 12
#: Steps for which :func:`react` holds a move, and those after it, in long branches and in short ones.
_BRANCHES = ((6, 14), (3, 3))
#: The most moves that are held before another one, to see whether only the last one matters.
_OTHERS = 2
#: Steps for which :func:`rock` holds each of two moves, and how often both must pay again.
_ROCKED, _TURNS = 6, 6


def run(subject: Subject, job: Job) -> None:
    """Run the search named by ``job["search"]`` and send its outcome."""
    subject.load()
    subject.channel.phase("search")
    tree = Tree(subject, job)
    _SEARCHES[job["search"]](tree)
    subject.channel.send_json(Kind.RESULT, tree.out.json(), flush=True)


def exhaust(tree: Tree) -> None:
    """Search breadth first through all reachable states; `exhausted` if none is left within the budget.

    Two states are equal if their frames and attributes are, with everything these refer to, except random generators
    and counters of steps. Such a counter may be a timer that triggers something later, so the states are not exhausted
    while whole episodes reach other states. An environment that draws random numbers while it steps is `stochastic` and
    never exhausted, nor is one with a value that cannot be examined.
    """
    root = tree.root()
    if not tree.out.copies:
        return
    generators, shared_generators = State(root.env).generators, global_generators()
    opaque = False
    counters = _counters(tree, root)

    def key(node: Node) -> int:
        nonlocal opaque
        state = State(node.env)
        opaque |= state.opaque
        tree.out.stochastic |= state.generators != generators
        values = {name: value for name, value in state.values.items() if name not in counters}
        return hash((frame_hash(tree.frame), json.dumps(values)))

    root = tree.root()
    seen = {key(root)}
    frontier = [root]
    while frontier:
        grown: list[Node] = []
        for node in frontier:
            for action in tree.actions:
                if tree.spent() or tree.out.win is not None or tree.out.stochastic:
                    tree.out.states = len(seen)
                    return
                child = tree.branch(node)
                alive = tree.step(child, action)
                state = key(child)
                if alive and state not in seen:
                    seen.add(state)
                    grown.append(child)
        frontier = grown
    tree.out.states = len(seen)
    closed = tree.out.crash is None and not tree.out.stochastic and _closed(tree, seen, key)
    tree.out.exhausted = closed and not opaque and global_generators() == shared_generators


def _closed(tree: Tree, seen: set[int], key: Callable[[Node], int]) -> bool:
    """Whether whole episodes, one of the first action and some at random, meet no other state and no win."""
    for play in range(_EPISODES):
        node = tree.root()
        while tree.step(node, tree.random.choice(tree.actions) if play else tree.actions[0]):
            if _monotonic() > tree.until or key(node) not in seen:
                return False
        if tree.out.crash is not None or tree.out.win is not None:
            return False
    return True


def _counters(tree: Tree, root: Node) -> set[str]:
    """Attributes that change by one at every step under every action: time, which does not distinguish states."""
    found: set[str] | None = None
    for action in tree.actions:
        probe = tree.branch(root)
        readings = [attributes(probe.env)]
        while len(readings) < _READINGS and not probe.ended:
            tree.step(probe, action)
            readings.append(attributes(probe.env))
        counts = {name for name in readings[0] if _counts([reading.get(name) for reading in readings])}
        found = counts if found is None else found & counts
    return found or set()


def _counts(values: list[Any]) -> bool:
    if any(isinstance(value, bool) or not isinstance(value, int) for value in values):
        return False
    changes = {later - earlier for earlier, later in pairwise(values)}
    return changes in ({1}, {-1})


def greedy(tree: Tree) -> None:
    """Five moves, each with the highest immediate reward (the first such move in the list)."""
    node = tree.root()
    for _ in range(5):
        best: tuple[float, Node] | None = None
        for action in tree.actions:
            child = tree.branch(node)
            tree.step(child, action)
            if child.path.length > node.path.length and (best is None or child.total > best[0]):
                best = (child.total, child)
        if best is None:
            return
        node = best[1]
        if node.ended:
            break
    tree.out.best, tree.out.best_return = node.path.actions(), node.total


def reach(tree: Tree) -> None:
    """Search breadth first for a win, by the actions that differ from the first in one component at most. States that
    look alike count as one, so it finds most wins soon and proves nothing; `exhausted` if none is left.

    Actions that never showed a picture of their own in the first states, such as a button without effect, are left out.
    If that search ends without a win, they are tried as well.
    """
    chosen = simple(tree.actions)
    _reach(tree, chosen, _ALIKE)
    if tree.out.exhausted and tree.out.win is None:
        _reach(tree, chosen, 0)


def _reach(tree: Tree, chosen: list[Any], alike: int) -> None:
    """Search with these actions; after `alike` states only with those that had an effect of their own."""
    root = tree.root()
    start = frame_hash(tree.frame)
    seen, frontier = {start}, [(root, start)]
    tree.out.exhausted, expanded, own = False, 0, [False] * len(chosen)
    while frontier and tree.out.copies:
        grown: list[tuple[Node, int]] = []
        for node, picture in frontier:
            pictures = {picture}
            for number, action in enumerate(chosen):
                if tree.spent() or tree.out.win is not None:
                    return
                child = tree.branch(node)
                alive = tree.step(child, action)
                digest = frame_hash(tree.frame) if alive else 0
                own[number] |= digest not in pictures
                pictures.add(digest)
                if alive and digest not in seen:
                    seen.add(digest)
                    grown.append((child, digest))
            expanded += 1
            if expanded == alike:
                chosen, own = list(compress(chosen, own)), [True] * sum(own)
        frontier = grown
    tree.out.states = len(seen)
    tree.out.exhausted = tree.out.copies and tree.out.crash is None


def sweep(tree: Tree) -> None:
    """Follow a path and try the actions in turn on copies of its states: finds crashes after one rare action.

    The budget is spread over the path, so every step of the path is tried with some action.
    """
    _try_along(tree, max(tree.budget // max(len(tree.path), 1) - 1, 1))


def sweep_last(tree: Tree) -> None:
    """Follow a path and try every action on copies of its last states, as many as the budget allows: finds crashes in
    states that few episodes reach.
    """
    states = max(tree.budget - len(tree.path), 0) // len(tree.actions)
    _try_along(tree, len(tree.actions), first=max(len(tree.path) - states, 0))


def _try_along(tree: Tree, share: int, first: int = 0) -> None:
    """Follow the path and try so many actions, one after another, in each state from the `first` on."""
    node = tree.root()
    position = 0
    for number, action in enumerate(tree.path):
        for _ in range(min(share, len(tree.actions)) if number >= first else 0):
            tree.step(tree.branch(node), tree.actions[position % len(tree.actions)])
            position += 1
            if tree.out.crash is not None or tree.spent():
                return
        if not tree.step(node, action):
            return


def react(tree: Tree) -> None:
    """Follow a path, hold each move there for some steps and then do nothing: `states` counts the different states that
    look like doing nothing throughout.

    A state that only keeps the last action, or the last move such as the way that a figure faces, is not different. The
    moves differ from doing nothing in one component, the
    one with the most values. If most of these branches end early, shorter ones are tried.
    """
    tree.out.states, _ = _hidden(tree)


def vanish(tree: Tree) -> None:
    """The same as :func:`react`, but `states` is 0 if some move does not look like doing nothing."""
    states, seen = _hidden(tree)
    tree.out.states = 0 if seen else states


def _hidden(tree: Tree) -> tuple[int, bool]:
    """The number of states that look like doing nothing, 0 if unknown, and whether some move looks different."""
    node = tree.root()
    if not all(tree.step(node, action) for action in tree.path):
        return 0, False
    moves = _moves(tree.actions)
    for held, rested in _BRANCHES:
        rest = [moves[0]] * rested
        whole = [(move, branch) for move in moves if (branch := _branch(tree, node, [move] * held + rest))]
        if 2 * len(whole) > len(moves):
            break
    if not whole:
        return 0, False
    still, (pictures, unmoved) = whole[0]
    # Where two branches that did the same differ, a difference says nothing.
    if _branch(tree, node, [still] * held + rest) != (pictures, unmoved):
        return 0, False
    moved = [(move, state) for move, (seen, state) in whole if seen == pictures and state != unmoved]

    def kept(move: Any, state: str) -> bool:
        """Whether the state is the same after another move, held before this one."""
        others = [other for other, reached in moved if reached != state][:_OTHERS]
        mixed = ([other] * (held - 1) + [move] + rest for other in others)
        return bool(others) and all((found := _branch(tree, node, one)) and found[1] == state for one in mixed)

    states = 1 + len({state for move, state in moved if not kept(move, state)})
    # A branch that the budget cut short says nothing.
    return 0 if tree.spent() else states, any(seen != pictures for _, (seen, _) in whole)


def rock(tree: Tree) -> None:
    """Follow a path, and go back and forth there: up and down, or left and right, for some steps each. `loop` leads to
    the first such turn that pays each time, but for the first time: a thing with momentum comes to its rhythm then.
    """
    node = tree.root()
    if not all(tree.step(node, action) for action in tree.path):
        return
    moves = _moves(tree.actions)
    for one, other in zip(moves[1::2], moves[2::2], strict=False):
        for turn in ([one] * _ROCKED + [other] * _ROCKED, [other] * _ROCKED + [one] * _ROCKED):
            if _pays_again(tree, tree.branch(node), turn):
                tree.out.loop, tree.out.loop_length = tree.path + turn * 2, len(turn)
                return


def _pays_again(tree: Tree, node: Node, turn: list[Any]) -> bool:
    """Whether some actions pay each time that they are repeated, but for the first time."""
    for number in range(_TURNS + 1):
        before = node.total
        alive = not tree.spent() and all(tree.step(node, action) for action in turn)
        if not alive or (number and node.total <= before):
            return False
    return True


def _branch(tree: Tree, node: Node, actions: list[Any]) -> tuple[list[int], str] | None:
    """The pictures and the last state of a branch that takes these actions; None if it ends before."""
    branch, pictures = tree.branch(node), []
    for action in actions:
        if tree.spent() or not tree.step(branch, action):
            return None
        pictures.append(frame_hash(tree.frame))
    return pictures, json.dumps(State(branch.env).values)


def _moves(actions: list[Any]) -> list[Any]:
    """The first action, and those that differ from it in one component, the one with the most values."""
    if not isinstance(actions[0], list):
        return actions
    by_place: dict[int, list[Any]] = {}
    for action in actions[1:]:
        if places(action, actions[0]) == 1:
            place = next(at for at, (one, other) in enumerate(zip(action, actions[0], strict=True)) if one != other)
            by_place.setdefault(place, []).append(action)
    return [actions[0], *max(by_place.values(), key=len, default=[])]


_SEARCHES: dict[str, Callable[[Tree], None]] = {
    "explore": explore,
    "exhaust": exhaust,
    "greedy": greedy,
    "reach": reach,
    "sweep": sweep,
    "sweep_last": sweep_last,
    "react": react,
    "vanish": vanish,
    "rock": rock,
    "horizon": horizon,
    "enclosed": enclosed,
    "outlast": outlast,
}
