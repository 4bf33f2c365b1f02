"""Serve at once, keep the paddle under the ball, and meet it off centre, so that it does not repeat its way."""

import numpy as np


def policy(env):
    centre = env.x + 2
    # The place at which the ball meets the paddle changes with the bricks that are left.
    aim = env.paddle + 7 + (env.broken % 5 - 2)
    direction = 4 if centre > aim + 1 else 3 if centre < aim - 1 else 0
    return np.array([direction, 1, 0])
