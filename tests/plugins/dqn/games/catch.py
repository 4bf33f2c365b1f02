"""A ball falls, a paddle has to be under it: seven columns, six steps, +1 for a catch and -1 for a miss."""

import gymnasium
import numpy as np

CELL, SIDE = 12, 7


class Catch(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode=None):
        self.observation_space = gymnasium.spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.row, self.paddle = 0, SIDE // 2
        self.column = int(self.np_random.integers(SIDE))
        return self.render(), {}

    def step(self, action):
        self.paddle = min(max(self.paddle + (action[0] == 4) - (action[0] == 3), 0), SIDE - 1)
        self.row += 1
        over = self.row == SIDE - 1
        reward = 0.0 if not over else 1.0 if self.paddle == self.column else -1.0
        return self.render(), reward, over, False, {}

    def render(self):
        frame = np.full((84, 84, 3), (20, 24, 40), np.uint8)
        for row, column, colour in ((self.row, self.column, (250, 200, 60)), (SIDE - 1, self.paddle, (80, 160, 250))):
            frame[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL] = colour
        return frame
