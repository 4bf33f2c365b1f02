"""Rooftops: an alley cat drifts over the roofs at sunset and gathers chains of fish.

The cat has no brakes: each push adds 0.2 pixels a step to its velocity, and it keeps sixty percent of its speed when
it bounces off an edge. Button one shoots a line that reels in what it meets, button two slows everything but the cat
for as long as the sand lasts. Fish come in four colours; several of one colour in a row make a chain. Crows carry
fish off the line, and volleys of shots cross the screen. The clock starts with the cat's first movement, so there is
time to look round before anything happens.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
FRAME = 3
STEP_LIMIT = 1000
LIVES = 3

THRUST = 0.2
TOP_SPEED = 3.0
BOUNCE = 0.60
MOST_BUMPS = 10

LINE_REACH = 30
LINE_SPEED = 6
REEL = 2.0
BITE_STEPS = 8

SAND = 80
SAND_REFILL = 25
SLOW = 0.25

VOLLEY_GAP = 25
VOLLEY_SHOTS = 3
SHOT_SPEED = 4.0

FISH_WANTED = 14
FISH_SHOWN = 7
CROWS = 2
CROW_SPEED = 0.5

SLATE = (70, 76, 92)
SLATE_EDGE = (54, 58, 74)
STREET = (38, 26, 44)
SUNSET = (232, 130, 140)
BRICK = (150, 76, 60)
CAT = (20, 18, 24)
CAT_EYE = (240, 230, 90)
CROW = (44, 40, 70)
CROW_BEAK = (230, 170, 60)
SHOT = (255, 240, 230)
LINE = (240, 210, 200)
SAND_GOLD = (230, 200, 120)
FISH_COLOURS = ((90, 190, 255), (255, 170, 60), (130, 230, 120), (250, 110, 200))

PUSH = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    """Drift, hook, slow down, keep the colour."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.clock = 0
        self.position = np.array([42.0, 42.0])
        self.velocity = np.array([0, 0])
        self.facing = 4
        self.started = False
        self.lives = LIVES
        self.bumps = 0
        self.safe = 0
        self.gathered = 0
        self.chain_colour = None
        self.chain = 0
        self.sand = SAND
        self.slowing = False
        self.line = None
        self.shots = []
        self.fish = [self._new_fish() for _ in range(FISH_SHOWN)]
        self.crows = [self.np_random.uniform(10, SIZE - 10, 2) for _ in range(CROWS)]
        self.roofs = self._paint_roofs()
        return self._paint(), self._info()

    def _new_fish(self):
        """A fish somewhere on the roofs, but never right beside the cat."""
        while True:
            spot = self.np_random.uniform(9, SIZE - 9, 2)
            if np.abs(spot - self.position).max() > 12:
                return {"at": spot, "colour": int(self.np_random.integers(len(FISH_COLOURS)))}

    # -- one step ----------------------------------------------------------------

    def step(self, action):
        move, hook, slow = int(action[0]), bool(action[1]), bool(action[2])
        reward = 0.0
        if not self._over():
            self.steps += 1
            self._push(move)
            if not self.started:
                self.started = bool(np.any(self.velocity))
            else:
                reward += self._play(hook, slow)
        terminated = self._over()
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._paint(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return self.gathered >= FISH_WANTED or self.lives <= 0 or self.bumps >= MOST_BUMPS

    def _push(self, move):
        """Each push changes the velocity a little; the cat looks where it pushes."""
        if move in PUSH:
            self.facing = move
            for axis, way in enumerate(PUSH[move]):
                self.velocity[axis] = min(max(self.velocity[axis] + THRUST * way, -TOP_SPEED), TOP_SPEED)

    def _play(self, hook, slow):
        self.clock += 1
        self.safe = max(0, self.safe - 1)
        self.slowing = slow and self.sand > 0
        self.sand -= self.slowing
        pace = SLOW if self.slowing else 1.0
        if self.line is None:
            self._drift()
        reward = self._work_line(hook)
        reward += self._gather()
        reward += self._fly_shots(pace)
        self._fly_crows(pace)
        if self.lives <= 0 or self.bumps >= MOST_BUMPS:
            reward -= 1.0
        return reward

    def _drift(self):
        self.position = self.position + self.velocity
        for axis in (0, 1):
            low, high = FRAME + 3.0, SIZE - FRAME - 4.0
            if not low <= self.position[axis] <= high:
                self.position[axis] = min(max(self.position[axis], low), high)
                self.velocity[axis] = -BOUNCE * self.velocity[axis]
                self.bumps += 1

    def _work_line(self, hook):
        """Shoot, catch, reel in; a crow on the way bites a line that is out for too long."""
        if self.line is None:
            if hook:
                self.line = {"way": PUSH[self.facing], "length": 0.0, "caught": None, "reeled": 0}
            return 0.0
        if self.line["caught"] is None:
            self.line["length"] += LINE_SPEED
            tip = self._tip()
            hit = next((fish for fish in self.fish if np.abs(fish["at"] - tip).max() < 4), None)
            if hit is not None:
                self.line["caught"] = hit
            elif self.line["length"] >= LINE_REACH or not np.all((tip > FRAME) & (tip < SIZE - FRAME)):
                self.line = None
            return 0.0
        self.line["length"] -= REEL
        self.line["reeled"] += 1
        self.line["caught"]["at"] = self._tip()
        near_crow = any(np.abs(crow - self.line["caught"]["at"]).max() < 10 for crow in self.crows)
        if near_crow and self.line["reeled"] > BITE_STEPS:
            self.line = None
            return -0.2
        if self.line["length"] <= 4:
            self.line = None
        return 0.0

    def _tip(self):
        return self.position + np.array(self.line["way"]) * self.line["length"]

    def _gather(self):
        reward = 0.0
        for number, fish in enumerate(self.fish):
            if np.abs(fish["at"] - self.position).max() < 5:
                self.chain = self.chain + 1 if fish["colour"] == self.chain_colour else 1
                self.chain_colour = fish["colour"]
                self.gathered += 1
                self.sand = min(SAND, self.sand + SAND_REFILL)
                self.fish[number] = self._new_fish()
                reward += 1.0 + 0.2 * min(self.chain - 1, 5)
                if self.gathered >= FISH_WANTED:
                    reward += 5.0
        return reward

    def _fly_shots(self, pace):
        if self.clock % VOLLEY_GAP == 0:
            from_left = bool(self.np_random.integers(2))
            for row in self.np_random.uniform(8, SIZE - 8, VOLLEY_SHOTS):
                start = 0.0 if from_left else SIZE - 1.0
                self.shots.append([start, float(row), SHOT_SPEED if from_left else -SHOT_SPEED])
        reward = 0.0
        for shot in self.shots:
            shot[0] += shot[2] * pace
            close = abs(shot[0] - self.position[0]) < 4 and abs(shot[1] - self.position[1]) < 3
            if close and not self.safe:
                self.lives -= 1
                self.safe = 25
                reward -= 1.0
        self.shots = [shot for shot in self.shots if 0 <= shot[0] < SIZE]
        return reward

    def _fly_crows(self, pace):
        for number, crow in enumerate(self.crows):
            goal = self.fish[number]["at"]
            way = goal - crow
            gap = float(np.abs(way).max())
            if gap > 6:
                self.crows[number] = crow + way / gap * CROW_SPEED * pace

    def _info(self):
        won = self.gathered >= FISH_WANTED
        return {"is_success": won, "fish": self.gathered, "chain": self.chain, "lives": self.lives}

    # -- picture -----------------------------------------------------------------

    def render(self):
        return self._paint()

    def _paint_roofs(self):
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[:] = STREET
        for left, top, width, height in ((4, 4, 34, 36), (43, 4, 37, 22), (4, 45, 24, 35), (33, 31, 47, 49)):
            image[top : top + height, left : left + width] = SLATE
            image[top : top + height : 5, left : left + width] = SLATE_EDGE
            image[top + height - 2 : top + height, left : left + width] = BRICK
        for column, row in self.np_random.integers(8, SIZE - 14, size=(3, 2)).tolist():
            image[row : row + 6, column : column + 6] = BRICK
            image[row + 1 : row + 3, column + 1 : column + 5] = SUNSET
        image[20, 8:78:2] = LINE
        return image

    @staticmethod
    def _block(image, at, half_wide, half_high, colour):
        column, row = int(at[0]), int(at[1])
        image[max(0, row - half_high) : row + half_high + 1, max(0, column - half_wide) : column + half_wide + 1] = (
            colour
        )

    def _paint(self):
        image = self.roofs.copy()
        self._paint_frame(image)
        for fish in self.fish:
            colour = FISH_COLOURS[fish["colour"]]
            self._block(image, fish["at"], 2, 1, colour)
            self._block(image, fish["at"] + (3, 0), 0, 2, colour)
        for crow in self.crows:
            self._block(image, crow, 3, 0, CROW)
            self._block(image, crow, 1, 1, CROW)
            self._block(image, crow + (2, 0), 0, 0, CROW_BEAK)
        for x, y, _ in self.shots:
            self._block(image, (x, y), 2, 0, SHOT)
        if self.line is not None:
            for reach in np.arange(0, self.line["length"], 1.0):
                self._block(image, self.position + np.array(self.line["way"]) * reach, 0, 0, LINE)
        if self.safe % 4 < 2:
            self._block(image, self.position, 2, 2, CAT)
            dx, dy = PUSH[self.facing]
            self._block(image, self.position + (3 * dx, 3 * dy), 1 - abs(dx), 1 - abs(dy), CAT)
            self._block(image, self.position + (2 * dx, 2 * dy), 0, 0, CAT_EYE)
        return image

    def _paint_frame(self, image):
        """The frame fills with the chain in the chain's colour; lives, bumps and sand stand in its edges."""
        image[:2] = image[-2:] = SUNSET
        image[:, :2] = image[:, -2:] = SUNSET
        if self.chain_colour is not None:
            image[:2, : 12 * min(self.chain, 7)] = FISH_COLOURS[self.chain_colour]
        image[-2:, : self.sand] = SAND_GOLD
        for life in range(self.lives):
            image[4 + 5 * life : 8 + 5 * life, :2] = CAT
        for bump in range(self.bumps):
            image[4 + 4 * bump : 6 + 4 * bump, -2:] = BRICK
        for fish in range(self.gathered):
            image[24 + 4 * fish : 26 + 4 * fish, :2] = SHOT
