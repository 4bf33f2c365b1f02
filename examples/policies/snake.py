"""Creep along the shortest free way to the apple; without one, turn to where the most room is."""

from collections import deque

import numpy as np

COLUMNS, ROWS = 12, 11
MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


def policy(env):
    taken = {*env.body, *env.rocks}
    ways = {direction: reached(after(env.body[0], move), taken) for direction, move in MOVES.items()}
    to_apple = {direction: way[env.apple] for direction, way in ways.items() if env.apple in way}
    direction = min(to_apple, key=to_apple.get) if to_apple else max(ways, key=lambda each: len(ways[each]))
    return np.array([direction, 0, 0])


def after(cell, move):
    return cell[0] + move[0], cell[1] + move[1]


def reached(start, taken):
    """The free cells that can be reached, each with its distance."""
    found, waiting = {}, deque([(start, 0)])
    while waiting:
        cell, distance = waiting.popleft()
        inside = 0 <= cell[0] < COLUMNS and 0 <= cell[1] < ROWS
        if inside and cell not in taken and cell not in found:
            found[cell] = distance
            waiting.extend((after(cell, move), distance + 1) for move in MOVES.values())
    return found
