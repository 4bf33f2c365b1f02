"""Searches that follow what looks promising and prove nothing: an archive of states, and plans of some steps."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from .state import State
from .tree import Node, Tree, frame_hash, global_generators

#: Pixels of the longer side of a frame that a coarse picture is made of.
_SIDE = 96
#: How often a loop must pay again, the share of the budget for such trials, and the longest loop.
_AGAIN, _TRIALS, _LONGEST = 8, 0.1, 16
#: States of an exploration whose random generators are compared with those of its start.
_DRAWN = 2
#: Steps of a walk without another picture that are worth a closer look, and the different actions in them.
_STILL, _DIFFERENT = 10, 4
#: The key of the state in which the longest walk without another picture ended.
_WAITING = "waiting"
#: Number of plans per round, their steps, and how many steps of the best plan are followed.
_PLANS, _AHEAD, _FOLLOW = 8, 24, 6


def explore(tree: Tree) -> None:
    """Return to a promising state and act from there, at random with held actions.

    After Go-Explore (Ecoffet et al., 2021, doi:10.1038/s41586-020-03157-9): an archive of states under the key of a
    coarse picture. It prefers states that were rarely left and that have earned much. Before it knows a second picture,
    it keeps the end of its longest walk: a game may show one picture until a timer ends. The search stops at the
    budget, or at half of it once it knows a win. `still` leads to where one picture was shown the longest while actions
    changed. It is `stochastic` if a random generator has another state at its end.
    """
    root = tree.root()
    generators, shared_generators = State(root.env).generators, global_generators()
    root.cell = cell_of(tree.frame)
    archive: dict[Any, Node] = {root.cell: root}
    node = root
    #: The step at which each picture was first seen.
    seen = {frame_hash(tree.frame): 0}
    loops = _Loops(tree)
    while not tree.spent() and not (tree.out.win is not None and 2 * tree.out.steps >= tree.budget):
        start = choose(tree.random, archive)
        start.visits += 1
        node = tree.branch(start)
        loops.start(start.cell, node)
        action, hold = None, 0
        still: set[int] = set()
        run = _Run()
        for _ in range(tree.random.randint(4, 24)):
            if hold == 0:
                action, hold = tree.random.choice(tree.actions), tree.random.choice((1, 1, 2, 3, 5, 8, 13))
            hold -= 1
            before = node.total
            alive = tree.step(node, action)
            digest = frame_hash(tree.frame)
            still.add(digest)
            seen.setdefault(digest, tree.out.steps)
            if not alive or tree.spent():
                break
            run.add(tree, node, action, digest)
            cell = cell_of(tree.frame)
            remember(tree, archive, cell, node)
            loops.visit(cell, node)
            if node.total > before:
                loops.paid(cell, node, action)
        else:
            waited = archive.get(_WAITING)
            if len(archive) <= 2 and still == {digest} and (waited is None or node.path.length > waited.path.length):
                archive[_WAITING] = _kept(tree, node, start.cell)
    tree.out.states = len(seen)
    # A slow game ends the search before its budget; a win does, too, but then the other half is not missed.
    planned = tree.out.steps if tree.out.win is None else tree.budget
    tree.out.late_states = sum(2 * at > planned for at in seen.values())
    known = [node, *list(archive.values())[-_DRAWN:]]
    drawn = any(State(each.env).generators != generators for each in known if each.env is not None)
    tree.out.stochastic = drawn or global_generators() != shared_generators


class _Run:
    """The steps of a walk that show one picture under many actions; the tree keeps where the longest such run began."""

    def __init__(self) -> None:
        self._picture: int | None = None
        self._actions: list[str] = []

    def add(self, tree: Tree, node: Node, action: Any, picture: int) -> None:
        if picture != self._picture:
            self._picture, self._actions = picture, []
        self._actions.append(str(action))
        length = len(self._actions)
        longer = (length, -node.path.length) > (tree.out.still_length, -len(tree.out.still or ()))
        if length >= _STILL and longer and len(set(self._actions)) >= min(_DIFFERENT, len(tree.actions)):
            tree.out.still, tree.out.still_length = node.path.actions(), length


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
        if self._tree.reports and self._tree.out.copies and _AGAIN * steps <= self._left:
            actions = node.path.actions()
            tried = cell, str(actions[-steps:])
            if tried not in self._tried:
                self._tried.add(tried)
                self._try(cell, node, actions, actions[-steps:])

    def paid(self, cell: Any, node: Node, action: Any) -> None:
        """Try whether an action that was paid is paid again after each single other one. The picture may count what is
        paid, so it need not be the same again.
        """
        tree = self._tree
        if not (tree.reports and tree.out.copies) or (cell, str(action)) in self._tried:
            return
        self._tried.add((cell, str(action)))
        for other in simple(tree.actions):
            if self._left < 2 * _AGAIN:
                return
            self._try(None, node, node.path.actions(), [other, action])

    def _try(self, cell: Any, node: Node, path: list[Any], loop: list[Any]) -> None:
        """Repeat some actions. What they switch on, they may switch off the next time, so a loop may also be the same
        actions twice.

        Args:
            cell: the coarse picture to which the actions lead back each time; None if any will do.
            node: the state from which they are repeated.
            path: the actions to that state.
            loop: the actions.
        """
        tree = self._tree
        probe, gains = tree.branch(node), []
        for _ in range(_AGAIN):
            before = probe.total
            self._left -= len(loop)
            if not all(tree.step(probe, action) for action in loop) or cell not in (None, cell_of(tree.frame)):
                return
            gains.append(probe.total - before)
            if len(gains) % 2 == 0 and gains[-2] + gains[-1] <= 2 * self._rate * len(loop):
                return
        if min(gains) > 0:
            self._keep(path, loop, min(gains))
        elif 2 * len(loop) <= _LONGEST:
            pairs = (one + other for one, other in zip(gains[::2], gains[1::2], strict=True))
            self._keep(path, loop * 2, min(pairs))

    def _keep(self, path: list[Any], loop: list[Any], least: float) -> None:
        if least > self._rate * len(loop):
            self._rate = least / len(loop)
            self._tree.out.loop, self._tree.out.loop_length = path + loop, len(loop)


def simple(actions: list[Any]) -> list[Any]:
    """The first joint action, and those that differ from it in one component."""
    return [action for action in actions if not isinstance(action, list) or places(action, actions[0]) <= 1]


def places(one: list[Any], other: list[Any]) -> int:
    """The number of components in which two joint actions differ."""
    return sum(bool(mine != its) for mine, its in zip(one, other, strict=True))


def remember(tree: Tree, archive: dict[Any, Node], cell: Any, node: Node) -> None:
    """Keep a state in the archive, unless one with this coarse picture has earned as much."""
    known = archive.get(cell)
    if known is not None and node.total <= known.total:
        return
    if known is None and len(archive) >= 4096:
        return
    archive[cell] = _kept(tree, node, cell)
    archive[cell].visits = known.visits // 2 if known else 0


def _kept(tree: Tree, node: Node, cell: Any) -> Node:
    return Node(tree.copies.of(node.env) if tree.out.copies else None, node.path, node.total, cell=cell)


def choose(rng: random.Random, archive: dict[Any, Node]) -> Node:
    """A state of the archive that was rarely left and has earned much."""
    nodes = list(archive.values())
    sample = [nodes[rng.randrange(len(nodes))] for _ in range(min(8, len(nodes)))]
    low = min(node.total for node in sample)
    span = max(node.total for node in sample) - low
    return max(sample, key=lambda node: (1 + (node.total - low) / span if span else 1) / (1 + node.visits) ** 0.5)


def cell_of(frame: Any) -> Any:
    """The coarse picture of a frame: the brightness of 14 by 14 blocks in eight levels. Other observations are kept."""
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
    return frame_hash(frame)


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
        plans = [kept + held(tree, _AHEAD - len(kept)), *(held(tree, _AHEAD) for _ in range(_PLANS - 1))]
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


def held(tree: Tree, length: int) -> list[Any]:
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
