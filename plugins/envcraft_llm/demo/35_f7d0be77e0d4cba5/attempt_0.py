"""Hilltop Observatory: an instrument of four strings, on which falling stars ring bells when a gate lets them through.

Up and down choose a string, left and right slide its gate, the first button opens the gate for a while. The six dots
above tell in which order the bells are to ring. Moths hop between the strings and swallow stars. From time to time two
neighbouring strips of the picture trade places, as if the lens had cracked; the game itself goes on as before.
"""

import cv2
import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
MAX_STEPS = 850

SONG_LENGTH = 6
STRINGS = 4
STRING_Y = (26, 40, 54, 68)
STRING_LEFT, STRING_RIGHT = 4, 75
BELL_X = 78

GATE_STEP = 3
GATE_RANGE = (54, 69)
GATE_OPEN = 14
CHOOSE_REST = 4

STAR_GAP = 18
STAR_SPEED = 2
STAR_DISTANCE = 30
WAITING_MOST = 2

MOTHS = 2
MOTH_HOP = 20
MOTH_RANGE = (12, 24)
MOTH_PERCHES = 3  # places on the lower edge where a moth rests, beside the strings
PERCH_Y = 80
LOST_STARS = 8

STRIPS = 6
CRACK_PERIOD = 80
CRACK_SPAN = 20

MIDNIGHT = (14, 16, 44)
MILKY_WAY = (46, 46, 92)
BRASS = (176, 136, 64)
BRASS_DARK = (110, 84, 44)
CREAM = (244, 232, 196)
STAR = (255, 240, 120)
STAR_GLOW = (200, 170, 70)
MOTH = (170, 150, 160)
MOTH_WING = (120, 100, 124)
ROBE = (120, 80, 200)
BELLS = ((230, 80, 80), (90, 200, 110), (80, 150, 250), (240, 160, 60))


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.song = [int(n) for n in self.np_random.integers(STRINGS, size=SONG_LENGTH)]
        self.lit = 0
        self.most_lit = 0
        self.lost_stars = 0
        self.won = self.lost = False
        self.string = int(self.np_random.integers(STRINGS))
        self.rest = 0
        self.pressed = False
        self.gates = [60] * STRINGS
        self.open_for = [0] * STRINGS
        self.stars = [[] for _ in range(STRINGS)]  # x of each star, the foremost first
        self.rung = [0] * STRINGS  # steps for which a bell still swings
        self.moths = []
        for _ in range(MOTHS):
            self.moths.append(self._hop())
        self.crack = None  # the left one of two strips that have traded places
        self.sky = self._paint_sky()
        return self.render(), self._info()

    # ------------------------------------------------------------------ rules

    def step(self, action):
        move, press = int(action[0]), bool(action[1])
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        self._handle(move, press)
        self._send_star()
        reward = self._roll()
        reward += self._flutter()
        self._crack_lens()
        if self.lit == SONG_LENGTH:
            self.won = True
            reward += 5.0
        elif self.lost_stars >= LOST_STARS:
            self.lost = True
            reward -= 1.0
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _info(self):
        return {"is_success": self.won, "lit": self.lit, "lost_stars": self.lost_stars, "steps": self.steps}

    def _handle(self, move, press):
        self.rest = max(0, self.rest - 1)
        if move in (1, 2) and not self.rest:
            self.string = min(max(self.string + (1 if move == 2 else -1), 0), STRINGS - 1)
            self.rest = CHOOSE_REST
        elif move in (3, 4):
            slid = self.gates[self.string] + (GATE_STEP if move == 4 else -GATE_STEP)
            # A star that waits at the gate is not pushed back by it.
            if GATE_RANGE[0] <= slid <= GATE_RANGE[1] and not any(
                slid - 3 < x <= self.gates[self.string] for x in self.stars[self.string]
            ):
                self.gates[self.string] = slid
        self.open_for = [max(0, left - 1) for left in self.open_for]
        if press and not self.pressed and not self.open_for[self.string]:
            self.open_for[self.string] = GATE_OPEN
        self.pressed = press

    def _send_star(self):
        if self.steps % STAR_GAP:
            return
        room = [n for n in range(STRINGS) if len(self.stars[n]) < WAITING_MOST]
        if room:
            string = room[int(self.np_random.integers(len(room)))]
            if not self.stars[string] or self.stars[string][-1] >= STRING_LEFT + STAR_DISTANCE:
                self.stars[string].append(STRING_LEFT)

    def _roll(self):
        reward = 0.0
        for number in range(STRINGS):
            gate = self.gates[number]
            ahead = None
            for k, x in enumerate(self.stars[number]):
                then = x + STAR_SPEED
                held = not self.open_for[number] and x <= gate - 3 < then
                crowded = ahead is not None and ahead - then < STAR_DISTANCE
                if not held and not crowded:
                    self.stars[number][k] = then
                ahead = self.stars[number][k]
            if self.stars[number] and self.stars[number][0] >= BELL_X - 3:
                self.stars[number].pop(0)
                reward += self._ring(number)
        self.rung = [max(0, left - 1) for left in self.rung]
        return reward

    def _ring(self, number):
        self.rung[number] = 8
        if number != self.song[self.lit]:
            self.lit = max(0, self.lit - 1)
            self.lost_stars += 1
            return -0.5
        self.lit += 1
        if self.lit <= self.most_lit:
            return 0.0
        self.most_lit = self.lit
        return 1.0

    def _hop(self):
        """Where a moth goes next: a string (or a perch, numbered from STRINGS on) and an x."""
        return int(self.np_random.integers(STRINGS + MOTH_PERCHES)), int(self.np_random.integers(*MOTH_RANGE))

    def _flutter(self):
        if self.steps % MOTH_HOP == 0:
            self.moths = [self._hop() for _ in self.moths]
        reward = 0.0
        for string, x in self.moths:
            if string >= STRINGS:
                continue
            eaten = [star for star in self.stars[string] if abs(star - x) <= 3]
            for star in eaten:
                self.stars[string].remove(star)
                self.lost_stars += 1
                reward -= 0.2
        return reward

    def _crack_lens(self):
        phase = self.steps % CRACK_PERIOD
        if phase == 0:
            self.crack = int(self.np_random.integers(STRIPS - 1))
        elif phase == CRACK_SPAN:
            self.crack = None

    # ------------------------------------------------------------------ picture

    def _paint_sky(self):
        sky = np.empty((SIZE, SIZE, 3), np.uint8)
        sky[:] = MIDNIGHT
        # The Milky Way through the slit of the dome.
        for x in range(SIZE):
            y = int(44 + 20 * np.sin(x / 17.0))
            sky[y - 5 : y + 5 : 2, x] = MILKY_WAY
        for _ in range(40):
            x, y = self.np_random.integers(SIZE, size=2)
            sky[y, x] = (110, 110, 150)
        sky[:14] = (24, 22, 34)
        sky[14] = BRASS_DARK
        for number, y in enumerate(STRING_Y):
            sky[y, STRING_LEFT:STRING_RIGHT] = BRASS
            sky[y - 4 : y + 5, BELL_X - 1 : BELL_X + 5] = BELLS[number]
            sky[y + 4, BELL_X - 2 : BELL_X + 6] = BELLS[number]
        return sky

    def render(self):
        frame = self.sky.copy()
        for k, string in enumerate(self.song):
            if k < self.lit:
                frame[3:11, 4 + 10 * k : 12 + 10 * k] = BELLS[string]
            else:
                frame[5:9, 6 + 10 * k : 10 + 10 * k] = BELLS[string]
        for k in range(self.lost_stars):
            frame[3 + 4 * (k // 4) : 6 + 4 * (k // 4), 67 + 4 * (k % 4) : 70 + 4 * (k % 4)] = MOTH
        for number, y in enumerate(STRING_Y):
            x = self.gates[number]
            if self.open_for[number]:
                frame[y - 6 : y - 3, x - 1 : x + 2] = CREAM
                frame[y + 4 : y + 7, x - 1 : x + 2] = CREAM
            else:
                frame[y - 5 : y + 6, x - 1 : x + 2] = CREAM
            if self.rung[number] % 2:
                frame[y - 4 : y + 5, BELL_X] = CREAM
        for number, stars in enumerate(self.stars):
            for x in stars:
                cv2.circle(frame, (x, STRING_Y[number]), 3, STAR_GLOW, -1)
                cv2.drawMarker(frame, (x, STRING_Y[number]), STAR, cv2.MARKER_STAR, 5)
        for string, x in self.moths:
            y = (STRING_Y[string] if string < STRINGS else PERCH_Y) - 1 + self.steps // 4 % 2
            cv2.ellipse(frame, (x - 2, y), (2, 3), -30, 0, 360, MOTH_WING, -1)
            cv2.ellipse(frame, (x + 2, y), (2, 3), 30, 0, 360, MOTH_WING, -1)
            cv2.line(frame, (x, y - 1), (x, y + 2), MOTH, 1)
        x, y = self.gates[self.string], STRING_Y[self.string]
        frame[y + 5 : y + 10, x - 3 : x + 4] = ROBE
        frame[y + 3 : y + 6, x - 1 : x + 2] = CREAM
        if self.crack is not None:
            width = SIZE // STRIPS
            left = self.crack * width
            pair = frame[:, left : left + 2 * width]
            frame[:, left : left + 2 * width] = np.roll(pair, width, axis=1)
        return frame
