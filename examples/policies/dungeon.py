"""Take the shortest way to the key, to the door and to the treasure; strike the slimes that come in front."""

from collections import deque

import numpy as np

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


def policy(env):
    goal = env.key if not env.has_key else env.treasure if env.door_open else env.door
    direction = first_move(env, goal)
    dx, dy = MOVES[direction]
    target = env.hero[0] + dx, env.hero[1] + dy
    if target in env.slimes and env.facing == MOVES[direction]:
        return np.array([0, 1, 0])
    return np.array([direction, 0, int(target == env.door)])


def first_move(env, goal):
    """The first move of a shortest way to the goal."""
    known = {env.hero}
    waiting = deque([(env.hero, 0)])
    while waiting:
        cell, first = waiting.popleft()
        if cell == goal:
            break
        for direction, (dx, dy) in MOVES.items():
            x, y = after = cell[0] + dx, cell[1] + dy
            closed = after == env.door and after != goal and not env.door_open
            if not (env.walls[y, x] or closed or after in known):
                known.add(after)
                waiting.append((after, first or direction))
    return first
