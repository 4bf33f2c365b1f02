"""Searches that need the environment's state: for crashes, for wins, and for the end of the reachable states.

Their results are only hints: the host repeats every list of actions in an ordinary rollout and trusts only that trace.
Each search has a budget in environment steps, so its result does not depend on the machine.
"""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import xxhash
from envcraft_protocol.jobs import Job
from envcraft_protocol.wire import Kind

from .channel import encode_value, jsonable
from .copies import Copies
from .state import State
from .subject import Fault, Subject, attributes

_Random = random.Random
_monotonic = time.monotonic
_hash: Any = xxhash.xxh3_64_intdigest

#: Number of readings that show whether a number counts steps.
_READINGS = 6
#: Number of whole episodes that check the states of an exhausted search.
_EPISODES = 3
#: Steps for which :func:`react` holds a move, and those after it.
_HELD, _RESTED = 6, 14
#: Pixels of the longer side of a frame that a coarse picture is made of.
_SIDE = 96
#: How often a loop must pay again, the share of the budget for such trials, and the longest loop.
_AGAIN, _TRIALS, _LONGEST = 3, 0.1, 16
#: States of an exploration whose random generators are compared with those of its start.
_DRAWN = 2
#: The key of the state in which the longest walk without another picture ended.
_WAITING = "waiting"
#: Number of plans per round, their steps, and how many steps of the best plan are followed.
_PLANS, _AHEAD, _FOLLOW = 8, 24, 6


@dataclass(slots=True)
class Path:
    """Actions as a linked list: branches share what led to them."""

    parent: Path | None
    action: Any
    length: int

    def then(self, action: Any) -> Path:
        return Path(self, action, self.length + 1)

    def actions(self) -> list[Any]:
        found, node = [], self
        while node.parent is not None:
            found.append(node.action)
            node = node.parent
        return found[::-1]


@dataclass(slots=True)
class Node:
    """A state: a copy of the environment, or the path to replay if the environment cannot be copied."""

    env: Any
    path: Path
    total: float
    visits: int = 0
    ended: bool = False
    cell: Any = None


@dataclass(slots=True)
class Outcome:
    """The results of a search so far."""

    steps: int = 0
    copies: bool = True
    crash: list[Any] | None = None
    win: list[Any] | None = None
    win_return: float = 0.0
    best: list[Any] = field(default_factory=list)
    best_return: float = float("-inf")
    loop: list[Any] | None = None
    loop_length: int = 0
    paid: int = 0
    states: int = 0
    late_states: int = 0
    exhausted: bool = False
    stochastic: bool = False

    def json(self) -> dict[str, Any]:
        lists = ("crash", "win", "best", "loop")
        values = {name: getattr(self, name) for name in self.__slots__}
        return {name: value if name in lists else jsonable(value) for name, value in values.items()}


class Tree:
    """Branches of one seeded episode."""

    def __init__(self, subject: Subject, job: Job) -> None:
        self.subject = subject
        self.seed: int = job["seed"]
        self.actions: list[Any] = job["actions"]
        self.path: list[Any] = job.get("path", [])
        self.budget: int = job["max_steps"]
        self.out = Outcome()
        self.random = _Random(job["seed"])
        self.limit: int = job["limit"]
        self.until = _monotonic() + job.get("seconds", float("inf"))
        #: Whether info reports success, or the lack of it.
        self.reports = False
        #: A search that proves something relies on no habits of games.
        self.exact: bool = job["search"] == "exhaust"
        self.copies: Copies
        #: If the environment cannot be copied, the instance of the last branch.
        self._replayed: Any = None

    def root(self) -> Node:
        env = self.subject.construct(announce=False)
        observation, _ = self.subject.call("reset", env.reset, seed=self.seed)
        self.frame = observation
        node = Node(env, Path(None, None, 0), 0.0)
        try:
            self.copies = Copies(env, exact=self.exact)
            self.copies.of(env)
        except BaseException:
            self.out.copies = False
        return node

    def branch(self, node: Node) -> Node:
        """A copy of `node` that can be stepped without changing `node`."""
        if self.out.copies:
            return Node(self.copies.of(node.env), node.path, node.total)
        env = self._reset_instance()
        for action in node.path.actions():
            self.subject.step("step", env, action)
            self.out.steps += 1
        self._replayed = env
        return Node(env, node.path, node.total)

    def _reset_instance(self) -> Any:
        """The instance of the last branch, which no search steps any more, after a reset; a new one if it cannot be
        used again.
        """
        env, self._replayed = self._replayed, None
        if env is not None:
            try:
                self.subject.call("reset", env.reset, seed=self.seed)
                return env
            except Fault:
                pass
        env = self.subject.construct(announce=False)
        self.subject.call("reset", env.reset, seed=self.seed)
        return env

    def step(self, node: Node, action: Any) -> bool:
        """Step `node` in place; False once its episode is over or fails."""
        self.out.steps += 1
        path = node.path.then(action)
        try:
            result = self.subject.step("step", node.env, action)
            observation, reward, terminated, truncated, info = result
            reward = float(reward)
        except (Fault, TypeError, ValueError):
            self._replayed = None
            if self.out.crash is None or path.length < len(self.out.crash):
                self.out.crash = path.actions()
            return False
        self.subject.channel.tick()
        self.frame = observation
        node.path = path
        node.total += reward
        self.out.paid += reward != 0
        node.ended = bool(terminated) or bool(truncated) or path.length >= self.limit
        self._judge(node, info)
        return not node.ended

    def spent(self) -> bool:
        return self.out.steps >= self.budget or _monotonic() > self.until

    def _judge(self, node: Node, info: Any) -> None:
        contract = self.subject.contract
        success = info.get(contract.get("success", "is_success")) if isinstance(info, dict) else None
        self.reports |= success is not None
        won = bool(success) if success is not None else contract.get("sign", True) and node.ended and node.total > 0
        if won and (self.out.win is None or node.path.length < len(self.out.win)):
            self.out.win, self.out.win_return = node.path.actions(), node.total
        if node.total > self.out.best_return:
            self.out.best, self.out.best_return = node.path.actions(), node.total


def run(subject: Subject, job: Job) -> None:
    """Run the search named by ``job["search"]`` and send its outcome."""
    subject.load()
    subject.channel.phase("search")
    tree = Tree(subject, job)
    _SEARCHES[job["search"]](tree)
    subject.channel.send_json(Kind.RESULT, tree.out.json(), flush=True)


def explore(tree: Tree) -> None:
    """Return to a promising state and act from there, at random with held actions.

    After Go-Explore (Ecoffet et al., 2021, doi:10.1038/s41586-020-03157-9): an archive of states under the key of a
    coarse picture. It prefers states that were rarely left and that have earned much. Before it knows a second picture,
    it keeps the end of its longest walk: a game may show one picture until a timer ends. The search stops at the
    budget, or at half of it once it knows a win. It is `stochastic` if a random generator has another state at its end.
    """
    root = tree.root()
    generators, shared_generators = State(root.env).generators, _global_generators()
    root.cell = _cell(tree.frame)
    archive: dict[Any, Node] = {root.cell: root}
    node = root
    seen = {_digest(tree.frame)}
    loops = _Loops(tree)
    while not tree.spent() and not (tree.out.win is not None and 2 * tree.out.steps >= tree.budget):
        start = _choose(tree.random, archive)
        start.visits += 1
        node = tree.branch(start)
        loops.start(start.cell, node)
        action, hold = None, 0
        still: set[int] = set()
        for _ in range(tree.random.randint(4, 24)):
            if hold == 0:
                action, hold = tree.random.choice(tree.actions), tree.random.choice((1, 1, 2, 3, 5, 8, 13))
            hold -= 1
            alive = tree.step(node, action)
            digest = _digest(tree.frame)
            still.add(digest)
            if digest not in seen:
                seen.add(digest)
                tree.out.late_states += 2 * tree.out.steps > tree.budget
            if not alive or tree.spent():
                break
            cell = _cell(tree.frame)
            _remember(tree, archive, cell, node)
            loops.visit(cell, node)
        else:
            waited = archive.get(_WAITING)
            if len(archive) <= 2 and still == {digest} and (waited is None or node.path.length > waited.path.length):
                archive[_WAITING] = _kept(tree, node, start.cell)
    tree.out.states = len(seen)
    known = [node, *list(archive.values())[-_DRAWN:]]
    drawn = any(State(each.env).generators != generators for each in known if each.env is not None)
    tree.out.stochastic = drawn or _global_generators() != shared_generators


class _Loops:
    """Finds actions that lead back to the same coarse picture and pay each time: the one that pays most per step.

    Loops matter only beside success, so an environment that does not report success has none.
    """

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._rate = 0.0
        self._left = int(_TRIALS * tree.budget)
        self._tried: set[Any] = set()
        self._passed: dict[Any, tuple[int, float]] = {}

    def start(self, cell: Any, node: Node) -> None:
        """Begin a branch."""
        self._passed = {cell: (node.path.length, node.total)}

    def visit(self, cell: Any, node: Node) -> None:
        """Note a state of the branch, and try the loop that it closes."""
        length, total = self._passed.get(cell, (node.path.length, node.total))
        self._passed[cell] = node.path.length, node.total
        steps = node.path.length - length
        if not (0 < steps <= _LONGEST and node.total - total > self._rate * steps):
            return
        cost = _AGAIN * steps
        if not (self._tree.reports and self._tree.out.copies and cost <= self._left) or (cell, steps) in self._tried:
            return
        self._tried.add((cell, steps))
        self._left -= cost
        self._try(cell, node, steps)

    def _try(self, cell: Any, node: Node, steps: int) -> None:
        tree, actions = self._tree, node.path.actions()
        probe, least = tree.branch(node), float("inf")
        for _ in range(_AGAIN):
            before = probe.total
            if not all(tree.step(probe, action) for action in actions[-steps:]) or _cell(tree.frame) != cell:
                return
            least = min(least, probe.total - before)
        if least > self._rate * steps:
            self._rate = least / steps
            tree.out.loop, tree.out.loop_length = actions, steps


def _remember(tree: Tree, archive: dict[Any, Node], cell: Any, node: Node) -> None:
    known = archive.get(cell)
    if known is not None and node.total <= known.total:
        return
    if known is None and len(archive) >= 4096:
        return
    archive[cell] = _kept(tree, node, cell)
    archive[cell].visits = known.visits // 2 if known else 0


def _kept(tree: Tree, node: Node, cell: Any) -> Node:
    return Node(tree.copies.of(node.env) if tree.out.copies else None, node.path, node.total, cell=cell)


def _choose(rng: random.Random, archive: dict[Any, Node]) -> Node:
    nodes = list(archive.values())
    sample = [nodes[rng.randrange(len(nodes))] for _ in range(min(8, len(nodes)))]
    low = min(node.total for node in sample)
    span = max(node.total for node in sample) - low
    return max(sample, key=lambda node: (1 + (node.total - low) / span if span else 1) / (1 + node.visits) ** 0.5)


def horizon(tree: Tree) -> None:
    """Play an episode by rolling horizon: try several plans of held actions from the current state, follow the best for
    a few steps, and repeat with the rest of that plan among the next ones.

    After Perez et al., "Rolling horizon evolution versus tree search" (GECCO 2013, doi:10.1145/2463372.2463413), with
    chance in place of evolution. A plan that wins ranks first, and one that ends the episode otherwise ranks last; the
    return decides among the rest. The search ends with a win or with the episode. When the budget is spent, it plays
    the rest at random.
    """
    node = tree.root()
    kept: list[Any] = []
    while not node.ended and tree.out.win is None and not tree.spent():
        plans = [kept + _held(tree, _AHEAD - len(kept)), *(_held(tree, _AHEAD) for _ in range(_PLANS - 1))]
        kept = max(plans, key=lambda plan: _worth(tree, node, plan))
        for action in kept[:_FOLLOW]:
            if not tree.step(node, action):
                break
        kept = kept[_FOLLOW:]
    if tree.out.win is not None:
        tree.out.best, tree.out.best_return = tree.out.win, tree.out.win_return
        return
    while not node.ended and tree.step(node, tree.random.choice(tree.actions)):
        pass
    tree.out.best, tree.out.best_return = node.path.actions(), node.total


def _held(tree: Tree, length: int) -> list[Any]:
    """A plan of `length` actions, each held for a while."""
    plan: list[Any] = []
    while len(plan) < length:
        plan += [tree.random.choice(tree.actions)] * tree.random.choice((1, 1, 2, 3, 5, 8))
    return plan[:length]


def _worth(tree: Tree, node: Node, plan: list[Any]) -> tuple[bool, bool, float, int]:
    """The rank of a plan from a state."""
    known = tree.out.win
    child = tree.branch(node)
    for action in plan:
        if not tree.step(child, action):
            break
    lasts = not child.ended or child.path.length >= tree.limit
    return tree.out.win is not known, lasts, child.total - node.total, child.path.length


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
    generators, shared_generators = State(root.env).generators, _global_generators()
    opaque = False
    counters = _counters(tree, root)

    def key(node: Node) -> int:
        nonlocal opaque
        state = State(node.env)
        opaque |= state.opaque
        tree.out.stochastic |= state.generators != generators
        values = {name: value for name, value in state.values.items() if name not in counters}
        return hash((_digest(tree.frame), json.dumps(values)))

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
    tree.out.exhausted = closed and not opaque and _global_generators() == shared_generators


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


def _global_generators() -> str:
    """The state of the generators that all code shares."""
    state: Any = np.random.get_state()
    _, key, *rest = state
    return repr((random.getstate(), key.tobytes(), rest))


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


def react(tree: Tree) -> None:
    """Follow a path, hold each move there for some steps and then do nothing: `states` counts the different states that
    look like doing nothing throughout.

    A state that only keeps the last action is not different. The moves differ from doing nothing in one component, the
    one with the most values.
    """
    node = tree.root()
    if not all(tree.step(node, action) for action in tree.path):
        return
    idle, *moves = _moves(tree.actions)
    seen: list[str] = []
    pictures: list[int] = []
    for action in [idle, idle, *moves]:
        branch, shown = tree.branch(node), []
        for held in [action] * _HELD + [idle] * _RESTED:
            if tree.spent() or not tree.step(branch, held):
                break
            shown.append(_digest(tree.frame))
        pictures = pictures or shown
        if len(shown) == _HELD + _RESTED and shown == pictures:
            seen.append(json.dumps(State(branch.env).values))
    # Where two branches that did the same differ, a difference says nothing.
    tree.out.states = len(set(seen)) if seen[:1] == seen[1:2] else 0


def _moves(actions: list[Any]) -> list[Any]:
    """The first action, and those that differ from it in one component, the one with the most values."""
    if not isinstance(actions[0], list):
        return actions
    by_place: dict[int, list[Any]] = {}
    for action in actions[1:]:
        places = [at for at, (one, other) in enumerate(zip(action, actions[0], strict=True)) if one != other]
        if len(places) == 1:
            by_place.setdefault(places[0], []).append(action)
    return [actions[0], *max(by_place.values(), key=len, default=[])]


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


def _cell(frame: Any) -> Any:
    """A coarse picture: the brightness of 14 by 14 blocks in eight levels; other observations as they are."""
    if isinstance(frame, np.ndarray) and frame.ndim == 3 and frame.dtype == np.uint8 and frame.size:
        # Larger frames are thinned: their blocks have pixels enough.
        thin = -(-max(frame.shape[:2]) // _SIDE)
        frame = frame[::thin, ::thin]
        rows, columns = max(frame.shape[0] // 14, 1), max(frame.shape[1] // 14, 1)
        height, width = frame.shape[0] // rows * rows, frame.shape[1] // columns * columns
        bands = frame[:height, :width].reshape(height // rows, rows, -1).sum(axis=1, dtype=np.uint32)
        blocks = bands.reshape(height // rows, width // columns, -1)
        means = blocks.sum(axis=2) // (rows * blocks.shape[2])
        return (means >> 5).astype(np.uint8).tobytes()
    return _digest(frame)


def _digest(frame: Any) -> int:
    """Tells observations apart within a search; 64 bits, of some ten thousand."""
    if not isinstance(frame, np.ndarray):
        return hash(encode_value(frame)[1])
    if frame.dtype.kind not in "biuf":
        return hash(np.ndarray.tobytes(frame))
    frame = np.asarray(frame)
    # Rows or columns of pixels, as they lie in memory.
    if not frame.flags.c_contiguous and frame.ndim == 3 and frame.transpose(1, 0, 2).flags.c_contiguous:
        number: int = _hash(frame.transpose(1, 0, 2), 1)
    else:
        number = _hash(np.ascontiguousarray(frame))
    return number


def _counts(values: list[Any]) -> bool:
    if any(isinstance(value, bool) or not isinstance(value, int) for value in values):
        return False
    changes = {later - earlier for earlier, later in pairwise(values)}
    return changes in ({1}, {-1})


_SEARCHES: dict[str, Callable[[Tree], None]] = {
    "explore": explore,
    "exhaust": exhaust,
    "greedy": greedy,
    "sweep": sweep,
    "sweep_last": sweep_last,
    "react": react,
    "horizon": horizon,
}
