"""Carnival Pier: a juggler runs along a pier of three screens, gathers balloons and boards the big wheel.

Left and right walk, the first button jumps (longer when held), up climbs ladders and boards the wheel, down
ducks. Clowns patrol the boards, bubbles drift up from the water and stick together, and a paddle at the edge of the
screen plays ball with the juggler.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
MAX_STEPS = 950
LIVES = 4
BALLOONS_NEEDED = 5
PIT_FALLS = 4

WALK = 2
JUMP_SPEED = 3.1
GRAVITY = 0.34
HOLD_GRAVITY = 0.22
GRACE = 30
BOARDS = 70  # y of the pier's deck

BUBBLE_GAP = 40
BUBBLE_RISE = 0.4
BUBBLE_COLOURS = [(255, 110, 110), (110, 200, 255), (150, 240, 130), (240, 200, 90)]
CLUSTER = 3

PADDLE_SKILL = 0.75
BALL_SPEED = 1.2
BALL_FASTER = 1.03
BALL_REST = 160

SKY = (38, 30, 66)
SEA = (12, 20, 34)
SEA_CREST = (28, 48, 70)
CREAM = (250, 236, 200)
CANDY = (214, 52, 66)
BULB = (255, 226, 110)
WOOD = (140, 92, 56)
WOOD_DARK = (104, 66, 40)
LADDER = (190, 150, 90)
LIFT = (180, 180, 196)
CLOWN = (240, 240, 255)
CLOWN_NOSE = (255, 40, 40)
BALLOON = (255, 90, 170)
JUGGLER = (80, 200, 190)
JUGGLER_HEAD = (255, 214, 170)
WHEEL = (250, 200, 80)


class Screen:
    """One third of the pier: decks (left, right, y), ladders (x, top, bottom), a lift, clowns and balloons."""

    def __init__(self, decks, ladders, lift, clowns, balloons):
        self.decks = decks
        self.ladders = ladders
        self.lift = lift  # x, lowest y, highest y
        self.clowns = clowns  # x, y, left, right, direction
        self.balloons = balloons  # x, y, still there


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ setup

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.falls = 0
        self.balloons = 0
        self.won = self.lost = False
        self.screens = self._build_pier()
        self.place = 0
        self.entry = (5.0, float(BOARDS))
        self.bubbles = []  # [x, y, colour, stuck]
        self._respawn()
        self.ball = None
        self.ball_rest = BALL_REST
        self.paddle = 50.0
        return self.render(), self._info()

    def _build_pier(self):
        jitter = lambda spread: int(self.np_random.integers(-spread, spread + 1))
        first = Screen(
            decks=[(0, 40, BOARDS), (52, 84, BOARDS), (22 + jitter(3), 44, 52)],
            ladders=[(30, 52, BOARDS)],
            lift=(46, BOARDS - 4, 50),
            clowns=[[66 + jitter(4), BOARDS, 54, 80, 1]],
            balloons=[[9 + jitter(2), 56, True], [34 + jitter(3), 40, True], [70 + jitter(5), 54, True]],
        )
        second = Screen(
            decks=[(0, 26, BOARDS), (36, 58, BOARDS), (68, 84, BOARDS), (30, 56, 50)],
            ladders=[(40, 50, BOARDS)],
            lift=(62, BOARDS - 2, 46),
            clowns=[[44, BOARDS, 38, 56, 1], [40, 50, 32, 54, -1]],
            balloons=[[14 + jitter(4), 55, True], [46 + jitter(4), 36, True], [76 + jitter(3), 55, True]],
        )
        third = Screen(
            decks=[(0, 34, BOARDS), (44, 84, BOARDS), (8, 34, 52)],
            ladders=[(14, 52, BOARDS)],
            lift=(39, BOARDS - 2, 48),
            clowns=[[22, BOARDS, 6, 32, 1], [50 + jitter(3), BOARDS, 46, 60, 1]],
            balloons=[[24 + jitter(5), 38, True], [52 + jitter(4), 55, True], [77 + jitter(2), 57, True]],
        )
        return [first, second, third]

    def _respawn(self):
        self.x, self.y = self.entry
        self.vy = 0.0
        self.ground = True
        self.climbing = self.ducking = False
        self.grace = GRACE
        self.bubbles = [b for b in self.bubbles if abs(b[0] - self.x) > 12]

    # ------------------------------------------------------------------ one step

    def step(self, action):
        move, jump, _ = (int(a) for a in action)
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        self.grace = max(0, self.grace - 1)
        reward = self._move(move, jump)
        reward += self._gather()
        reward += self._meet_clowns()
        reward += self._bubbles()
        reward += self._play_ball()
        if self._at_wheel() and move == 1 and self.balloons >= BALLOONS_NEEDED:
            self.won = True
            reward += 5.0
        elif self.lives <= 0 or self.falls >= PIT_FALLS:
            self.lost = True
            reward -= 1.0
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _at_wheel(self):
        return self.place == len(self.screens) - 1 and self.x >= 66

    def _info(self):
        return {"is_success": self.won, "balloons": self.balloons, "lives": self.lives, "screen": self.place}

    def _lift_y(self):
        _, low, high = self.screens[self.place].lift
        return low + (high - low) * (0.5 - 0.5 * np.cos(self.steps * 0.05))

    def _support(self, x, y_from, y_to):
        """The y of the highest floor that a fall from y_from to y_to lands on, or None."""
        screen = self.screens[self.place]
        floors = [deck[2] for deck in screen.decks if deck[0] - 1 <= x <= deck[1] + 1]
        if abs(x - screen.lift[0]) <= 6:
            floors.append(self._lift_y())
        landed = [floor for floor in floors if y_from - 2 <= floor <= y_to + 0.01]
        return min(landed) if landed else None

    def _move(self, move, jump):
        reward = 0.0
        screen = self.screens[self.place]
        self.ducking = move == 2 and self.ground
        ladder = next((l for l in screen.ladders if abs(l[0] - self.x) <= 3 and l[1] - 1 <= self.y <= l[2]), None)
        self.climbing = ladder is not None and move == 1
        if self.climbing:
            self.y = max(float(ladder[1]), self.y - 1.5)
            self.vy, self.ground = 0.0, True
            return reward
        if move == 3:
            self.x -= WALK
        elif move == 4:
            self.x += WALK
        if self.x < 0:
            # Off the left edge: the screen before this one.
            self.place -= 1
            self._enter(SIZE - 3.0)
        elif self.x >= SIZE:
            if self.place < len(self.screens) - 1:
                self.place += 1
                reward += 0.5
                self._enter(2.0)
            else:
                self.x = SIZE - 1.0
        if jump and self.ground:
            self.vy, self.ground = -JUMP_SPEED, False
        self.vy += HOLD_GRAVITY if jump and self.vy < 0 else GRAVITY
        before = self.y
        self.y += self.vy
        floor = self._support(self.x, before, self.y) if self.vy >= 0 else None
        if floor is not None:
            self.y, self.vy, self.ground = float(floor), 0.0, True
        else:
            self.ground = False
        if self.y > SIZE + 2:
            self.falls += 1
            self._respawn()
            reward -= 0.5
        return reward

    def _enter(self, x):
        self.place %= len(self.screens)
        self.x = x
        self.entry = (x, float(BOARDS))
        self.bubbles = []
        self.ball = None
        self.ball_rest = BALL_REST
        self.grace = GRACE

    def _hurt(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self._respawn()
        return -1.0

    def _gather(self):
        """Balloons are gathered in passing."""
        reward = 0.0
        for x, y, there in self.screens[self.place].balloons:
            if there and abs(x - self.x) <= 4 and self.y - 12 <= y <= self.y + 1:
                there = False
                self.balloons += 1
                reward += 0.2
        return reward

    def _meet_clowns(self):
        reward = 0.0
        screen = self.screens[self.place]
        for clown in list(screen.clowns):
            clown[0] += 0.5 * clown[4]
            if not clown[2] < clown[0] < clown[3]:
                clown[4] = -clown[4]
            if abs(clown[0] - self.x) <= 5 and abs(clown[1] - self.y) <= 8:
                if self.vy > 0 and self.y < clown[1] - 3:
                    screen.clowns.remove(clown)
                    self.vy = -2.0
                    reward += 0.3
                else:
                    reward += self._hurt()
        return reward

    # ------------------------------------------------------------------ bubbles and ball

    def _bubbles(self):
        if self.steps % BUBBLE_GAP == 0 and len(self.bubbles) < 8:
            x = float(self.np_random.integers(30, 78))
            self.bubbles.append([x, float(SIZE), int(self.np_random.integers(len(BUBBLE_COLOURS))), False])
        for bubble in self.bubbles:
            bubble[1] -= BUBBLE_RISE
            for other in self.bubbles:
                close = other is not bubble and abs(other[0] - bubble[0]) < 7 and abs(other[1] - bubble[1]) < 7
                if close:
                    bubble[0] += 0.1 * np.sign(other[0] - bubble[0])
                    bubble[3] = other[3] = True
        reward = 0.0
        for colour in range(len(BUBBLE_COLOURS)):
            same = [b for b in self.bubbles if b[2] == colour and b[3]]
            if len(same) >= CLUSTER:
                self.bubbles = [b for b in self.bubbles if b not in same]
                reward += 0.3
        self.bubbles = [b for b in self.bubbles if b[1] > 8]
        if any(b[3] and abs(b[0] - self.x) < 5 and abs(b[1] - self.y + 4) < 6 for b in self.bubbles):
            reward += self._hurt()
        return reward

    def _play_ball(self):
        if self.ball is None:
            self.ball_rest -= 1
            if self.ball_rest <= 0:
                self.ball = [78.0, 30.0 + float(self.np_random.integers(20)), -BALL_SPEED, 0.35]
            return 0.0
        self.ball[0] += self.ball[2]
        self.ball[1] += self.ball[3]
        if self.ball[1] > BOARDS - 2 or self.ball[1] < 20:
            self.ball[3] = -self.ball[3]
        self.paddle += np.clip(self.ball[1] - self.paddle, -1, 1)
        if self.ball[2] < 0 and abs(self.ball[0] - self.x) <= 3 and abs(self.ball[1] - self.y + 5) <= 6:
            self.ball[2] *= -BALL_FASTER
            return 0.1
        if self.ball[0] >= 80:
            if self.np_random.random() < PADDLE_SKILL:
                self.ball[2] = -abs(self.ball[2])
                return 0.0
            self.ball, self.ball_rest = None, BALL_REST
            return 1.0
        if self.ball[0] < max(0.0, self.x - 12):
            self.ball, self.ball_rest = None, BALL_REST
            return self._hurt()
        return 0.0

    # ------------------------------------------------------------------ picture

    def render(self):
        frame = np.empty((SIZE, SIZE, 3), np.uint8)
        frame[:] = SKY
        frame[76:] = SEA
        frame[77::4, (self.steps // 4) % 6 :: 6] = SEA_CREST
        for x in range(2, SIZE, 8):
            frame[8 + (x // 8) % 2, x : x + 2] = BULB
        screen = self.screens[self.place]
        if self.place == len(self.screens) - 1:
            self._wheel(frame)
        for k in range(0, SIZE, 12):
            frame[58:BOARDS, k : k + 1] = WOOD_DARK
        for left, right, y in screen.decks:
            frame[y + 1 : y + 4, max(0, left) : right] = WOOD
            frame[y + 1, max(0, left) : right : 3] = WOOD_DARK
        for x, top, bottom in screen.ladders:
            frame[top:bottom, [x - 2, x + 2]] = LADDER
            frame[top:bottom:3, x - 2 : x + 3] = LADDER
        lift_y = int(self._lift_y())
        frame[lift_y + 1 : lift_y + 3, screen.lift[0] - 6 : screen.lift[0] + 7] = LIFT
        for x, y, there in screen.balloons:
            if there:
                self._box(frame, x, y, 2, 2, BALLOON)
                self._box(frame, x, y + 4, 0, 1, CREAM)
        for x, y, *_ in screen.clowns:
            self._box(frame, x, y - 3, 2, 3, CLOWN)
            self._box(frame, x, y - 5, 0, 0, CLOWN_NOSE)
        for x, y, colour, _ in self.bubbles:
            self._box(frame, x, y, 3, 3, BUBBLE_COLOURS[colour])
            self._box(frame, x, y, 1, 1, SKY)
        if self.ball is not None:
            self._box(frame, self.ball[0], self.ball[1], 1, 1, CREAM)
        self._box(frame, 82, self.paddle, 1, 5, CANDY)
        if self.grace % 4 < 2:
            tall = 2 if self.ducking else 4
            self._box(frame, self.x, self.y - tall, 2, tall, JUGGLER)
            self._box(frame, self.x, self.y - 2 * tall - 1, 1, 1, JUGGLER_HEAD)
        for k in range(self.lives):
            frame[1:5, 2 + 5 * k : 6 + 5 * k] = CANDY
        for k in range(min(self.balloons, BALLOONS_NEEDED)):
            frame[1:5, 30 + 5 * k : 34 + 5 * k] = BALLOON
        frame[1:5, 62 + 6 * self.place : 67 + 6 * self.place] = BULB
        return frame

    def _wheel(self, frame):
        for k in range(24):
            angle = k * np.pi / 12 + self.steps * 0.01
            x, y = int(70 + 14 * np.cos(angle)), int(48 + 14 * np.sin(angle))
            frame[y, min(x, SIZE - 1)] = WHEEL
            if k % 4 == 0:
                self._box(frame, x, y, 1, 1, CANDY)
        frame[48:BOARDS, 70] = WHEEL

    @staticmethod
    def _box(frame, x, y, half_w, half_h, colour):
        x, y = round(float(x)), round(float(y))
        frame[max(0, y - half_h) : max(0, y + half_h + 1), max(0, x - half_w) : max(0, x + half_w + 1)] = colour
