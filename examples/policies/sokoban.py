"""Follow the shortest solution, which a search through all positions finds anew in each state."""

from collections import deque

import numpy as np

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


def policy(env):
    return np.array([first_move(env.keeper, frozenset(env.crates), env.floor, frozenset(env.marks)), 0, 0])


def first_move(keeper, crates, floor, marks):
    """The first move of a shortest solution; 0 without one."""
    known = {(keeper, crates)}
    waiting = deque([(keeper, crates, 0)])
    while waiting:
        (x, y), crates, first = waiting.popleft()
        if crates == marks:
            return first
        for direction, (dx, dy) in MOVES.items():
            target, beyond = (x + dx, y + dy), (x + 2 * dx, y + 2 * dy)
            pushes = target in crates
            if target not in floor or (pushes and (beyond not in floor or beyond in crates)):
                continue
            moved = crates - {target} | {beyond} if pushes else crates
            if (target, moved) not in known:
                known.add((target, moved))
                waiting.append((target, moved, first or direction))
    return 0
