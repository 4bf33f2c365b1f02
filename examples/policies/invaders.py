"""Step out of the way of bombs, else aim at where an invader will be when the shot gets there."""

import numpy as np


def policy(env):
    falling = [(x, y) for x, y in env.bombs if 50 <= y < 79 and env.x - 3 <= x < env.x + 10]
    centre = env.x + 3
    if falling:
        x, _ = max(falling, key=lambda bomb: bomb[1])
        away = 4 if x <= centre else 3
        away = 7 - away if (away == 4 and env.x >= 76) or (away == 3 and env.x <= 1) else away
        return np.array([away, int(env.shot is None), int(not env.shielded)])
    pause = 1 + int(env.alive.sum()) // 5
    targets = []
    for row, column in np.argwhere(env.alive):
        y = env.swarm_y + 9 * int(row) + 3
        ahead = env.march * ((74 - y) // 3) // pause
        targets.append((-int(row), abs(env.swarm_x + 11 * int(column) + 3 + ahead - centre), ahead, int(column)))
    _, distance, ahead, column = min(targets, key=lambda target: target[1] + 3 * target[0])
    aim = env.swarm_x + 11 * column + 3 + ahead
    direction = 4 if aim > centre + 1 else 3 if aim < centre - 1 else 0
    return np.array([direction, int(distance <= 2), 0])
