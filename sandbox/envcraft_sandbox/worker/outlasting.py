"""A search for an episode that outlasts its step limit, because play starts the counter of steps again and again."""

from __future__ import annotations

from typing import Any

import numpy as np

from .exploration import cell_of, choose, held, remember
from .tree import Node, Tree

#: Steps of one walk of an exploration, at least and at most.
_WALK = 4, 24
#: The share of the budget in which an exploration must come to the next restart.
_SHARE = 0.15
#: The part of its limit to which the counter is driven by doing nothing.
_PATIENCE = 0.9


def outlast(tree: Tree) -> None:
    """Search for play that starts a counter of steps again until the episode is longer than its limit.

    After each restart it repeats the actions that led there: first after doing nothing for a while, which gains many
    steps where that is safe, then at once. Where neither starts the counter again, it explores, and where that does not
    help either, it goes back by one restart. `best` is the longest episode, if it outlasts the limit.
    """
    hunt = _Hunt(tree)
    restarts = [(tree.root(), list[Any]())]
    # Without copies each branch would play all that came before.
    while tree.out.copies and not tree.spent() and not hunt.longest:
        node, segment = restarts[-1]
        found = hunt.follow(node, segment, wait=True) or hunt.follow(node, segment) or hunt.explore(node)
        if found is not None:
            restarts.append((found, found.path.actions()[node.path.length :]))
        elif len(restarts) > 1:
            restarts.pop()
    tree.out.best = hunt.longest


class _Hunt:
    """Plays on from states, and watches the counter.

    `longest` are the actions of an episode that outlasts its limit, none before.
    """

    def __init__(self, tree: Tree) -> None:
        self.longest: list[Any] = []
        self._tree = tree
        self._name, self._limit = tree.counter
        #: An episode outlasts what the step limit does not end.
        self._enough = tree.limit
        tree.limit += 1

    def follow(self, node: Node, actions: list[Any], wait: bool = False) -> Node | None:
        """The state in which the counter starts again after some actions, with `wait` after doing nothing before."""
        idle = max(int(_PATIENCE * self._limit) - len(actions), 0) if wait else 0
        if not actions or (wait and not idle):
            return None
        branch = self._tree.branch(node)
        for action in [self._tree.actions[0]] * idle + actions:
            count = self._count(branch)
            if not self._step(branch, action):
                return None
            if self._count(branch) < count:
                return branch
        return None

    def explore(self, node: Node) -> Node | None:
        """The next state in which the counter starts again, by an exploration like the worker's ``explore``."""
        tree = self._tree
        until = tree.out.steps + int(_SHARE * tree.budget) if node.path.length else tree.budget
        start = tree.branch(node)
        archive: dict[Any, Node] = {None: start}
        while tree.out.steps < until and not tree.spent() and not self.longest:
            start = choose(tree.random, archive)
            start.visits += 1
            branch = tree.branch(start)
            for action in held(tree, tree.random.randint(*_WALK)):
                count = self._count(branch)
                if not self._step(branch, action) or tree.spent():
                    break
                if self._count(branch) < count:
                    segment = branch.path.actions()[node.path.length :]
                    return self.follow(node, segment, wait=True) or branch
                remember(tree, archive, cell_of(tree.frame), branch)
        return None

    def _step(self, node: Node, action: Any) -> bool:
        alive = self._tree.step(node, action)
        if alive and node.path.length >= self._enough:
            self.longest = node.path.actions()
        return alive and not self.longest

    def _count(self, node: Node) -> float:
        value = vars(node.env.unwrapped).get(self._name)
        return float(value) if isinstance(value, int | float | np.number) else 0.0
