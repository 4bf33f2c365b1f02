"""Fly to the pad high above the hills, then come down over it, slower and slower."""

import numpy as np


def policy(env):
    across = env.pad + 6.5 - env.x
    height = env.ground[env.pad] - (env.y + 7)
    wanted = max(min(across * 0.04, 0.6), -0.6)
    direction = 4 if env.vx < wanted - 0.02 else 3 if env.vx > wanted + 0.02 else 0
    # Away from the pad the hills must stay below.
    low = env.ground.min() - 8 - (env.y + 7) if abs(across) > 5 else height
    sink = 0.15 + 0.03 * max(low, 0.0) if abs(across) <= 5 else 0.05 * low
    return np.array([direction, int(env.vy > min(sink, 0.7)), 0])
