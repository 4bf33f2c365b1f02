"""Jungle Temple: five stone slabs have to be fused inside a room that breathes like a rubber bag.

The first button draws the walls in, the second pushes them back. Slabs that touch for 24 steps grow into one block.
Serpents crossing the floor bite, and burst where they get between two slabs. Up and down are reversed to the left of
a white line that wanders across the floor.
"""

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
CENTRE = 44.0
WIDEST, START_HALF, SMALLEST = 37, 31, 17  # half the width of the room
SPRING_BACK = 25
BREATH = 2
BREATH_PAUSE = 6
SAG_EVERY = 15
TEAR_STEPS = 40

SLABS = 5
SLAB = 8
EXPLORER = 4
SERPENT = 3
SERPENTS = 3
WALK = 1.5
SERPENT_SPEED = 0.6
PRESS_STEPS = 24
CONTACT = 1.01

LINE_EVERY = 6
LINE_NEAR, LINE_FAR = 24, 54
LIVES = 4
GRACE = 30
MAX_STEPS = 1000

JUNGLE = (22, 62, 34)
LEAF = (36, 96, 46)
MOSS = (58, 120, 60)
FLOOR = (92, 100, 84)
FLOOR_JOINT = (78, 86, 72)
WALL = (54, 82, 40)
WALL_TAUT = (190, 70, 50)
STONE = (160, 162, 158)
STONE_EDGE = (104, 106, 104)
STONE_GLYPH = (214, 176, 60)
GOLD = (240, 200, 70)
KHAKI = (222, 196, 140)
HAT = (120, 72, 36)
BLOOD = (196, 30, 40)
BLOOD_DARK = (120, 14, 30)
WHITE = (250, 250, 250)

DELTA = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(SIZE, SIZE, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.half = START_HALF
        self.breath_pause = 0
        self.taut = 0
        self.lives = LIVES
        self.grace = GRACE
        self.won = self.torn = False
        self.line = int(self.np_random.integers(LINE_NEAR, LINE_FAR + 1))
        self.line_step = 1 if self.np_random.integers(2) else -1
        self.explorer = [CENTRE, CENTRE]
        self._place_slabs()
        self.group = list(range(SLABS))  # slabs with the same number are one block
        self.pressed = {}  # pair of slabs: steps in touch
        self.serpents = []
        for _ in range(SERPENTS):
            angle = self.np_random.uniform(0, 2 * np.pi)
            x, y = self.np_random.uniform(18, 70, size=2).tolist()
            self.serpents.append([x, y, SERPENT_SPEED * float(np.cos(angle)), SERPENT_SPEED * float(np.sin(angle))])
        self.leaves = self.np_random.integers(0, SIZE, size=(40, 2)).tolist()
        return self._draw(), self._info()

    def _place_slabs(self):
        self.slabs = []
        while len(self.slabs) < SLABS:
            x, y = self.np_random.uniform(CENTRE - 22, CENTRE + 22, size=2).tolist()
            clear = all(max(abs(x - u), abs(y - v)) > SLAB + 3 for u, v in self.slabs)
            if clear and max(abs(x - CENTRE), abs(y - CENTRE)) > SLAB:
                self.slabs.append([x, y])

    # ----- one step

    def step(self, action):
        move, breathe_in, breathe_out = (int(v) for v in action)
        self.steps += 1
        reward = 0.0
        if not (self.won or self.torn or self.lives <= 0):
            reward += self._breathe(breathe_in, breathe_out)
            self._wander_line()
            self._walk(move)
            reward += self._press_slabs()
            reward += self._crawl()
            self.grace = max(0, self.grace - 1)
            if len(set(self.group)) == 1:
                self.won = True
                reward += 5.0
            elif self.taut >= TEAR_STEPS:
                self.torn = True
                reward -= 2.0
        terminated = self.won or self.torn or self.lives <= 0
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    def _breathe(self, breathe_in, breathe_out):
        """Move the walls; returns the price of being caught between them."""
        change = 0
        self.breath_pause = max(0, self.breath_pause - 1)
        if breathe_in != breathe_out and self.breath_pause == 0:
            change = -BREATH if breathe_in else BREATH
            self.breath_pause = BREATH_PAUSE
        if self.steps % SAG_EVERY == 0:
            change -= 1
        self.half = min(WIDEST, self.half + change)
        self.taut = self.taut + 1 if self.half == WIDEST else 0
        price = 0.0
        if self.half < SMALLEST:
            self.half = SPRING_BACK
            price = self._hurt()
        for number in set(self.group):
            if change > 0:  # the bag pulls apart what it holds
                x, y = self._centre_of(number)
                self._shift_group(number, 0.5 * np.sign(x - CENTRE), 0.5 * np.sign(y - CENTRE))
        self._hold_inside()
        return price

    def _hurt(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self.grace = GRACE
        return -1.0

    def _wander_line(self):
        if self.steps % LINE_EVERY == 0:
            self.line += self.line_step
            if not LINE_NEAR < self.line < LINE_FAR:
                self.line_step = -self.line_step

    def _members(self, number):
        return [i for i in range(SLABS) if self.group[i] == number]

    def _centre_of(self, number):
        members = self._members(number)
        return (sum(self.slabs[i][0] for i in members) / len(members), sum(self.slabs[i][1] for i in members) / len(members))

    def _shift_group(self, number, dx, dy):
        for i in self._members(number):
            self.slabs[i][0] += float(dx)
            self.slabs[i][1] += float(dy)

    def _group_blocked(self, number, dx, dy):
        """Whether a block that is shoved this way meets a wall or another block."""
        reach = self.half - SLAB / 2
        for i in self._members(number):
            x, y = self.slabs[i][0] + dx, self.slabs[i][1] + dy
            if max(abs(x - CENTRE), abs(y - CENTRE)) > reach + 1e-6:
                return True
            for j in range(SLABS):
                if self.group[j] != number and max(abs(x - self.slabs[j][0]), abs(y - self.slabs[j][1])) < SLAB:
                    return True
        return False

    def _hold_inside(self):
        """The walls shove every block inwards, and blocks shove each other."""
        reach = self.half - SLAB / 2
        for _ in range(3):
            for number in sorted(set(self.group)):
                members = self._members(number)
                for axis in (0, 1):
                    low = min(self.slabs[i][axis] for i in members)
                    high = max(self.slabs[i][axis] for i in members)
                    push = max(0.0, CENTRE - reach - low) - max(0.0, high - CENTRE - reach)
                    if push:
                        self._shift_group(number, push if axis == 0 else 0, push if axis == 1 else 0)
            for i in range(SLABS):
                for j in range(i):
                    self._part(i, j)
        inside = self.half - EXPLORER / 2
        self.explorer = [float(np.clip(v, CENTRE - inside, CENTRE + inside)) for v in self.explorer]

    def _part(self, i, j):
        if self.group[i] == self.group[j]:
            return
        gaps = [self.slabs[i][axis] - self.slabs[j][axis] for axis in (0, 1)]
        depth = [SLAB - abs(gap) for gap in gaps]
        if min(depth) <= 0:
            return
        axis = 0 if depth[0] < depth[1] else 1
        shift = (depth[axis] / 2) * (1 if gaps[axis] >= 0 else -1)
        self._shift_group(self.group[i], shift if axis == 0 else 0, shift if axis == 1 else 0)
        self._shift_group(self.group[j], -shift if axis == 0 else 0, -shift if axis == 1 else 0)

    def _walk(self, move):
        dx, dy = DELTA[move]
        if self.explorer[0] < self.line:
            dy = -dy
        if not (dx or dy):
            return
        inside = self.half - EXPLORER / 2
        x = float(np.clip(self.explorer[0] + WALK * dx, CENTRE - inside, CENTRE + inside))
        y = float(np.clip(self.explorer[1] + WALK * dy, CENTRE - inside, CENTRE + inside))
        reach = (SLAB + EXPLORER) / 2
        met = {self.group[i] for i in range(SLABS) if max(abs(self.slabs[i][0] - x), abs(self.slabs[i][1] - y)) < reach}
        for number in sorted(met):
            if self._group_blocked(number, WALK * dx, WALK * dy):
                return
        for number in sorted(met):
            self._shift_group(number, WALK * dx, WALK * dy)
        self.explorer = [x, y]

    def touching(self, i, j):
        dx, dy = abs(self.slabs[i][0] - self.slabs[j][0]), abs(self.slabs[i][1] - self.slabs[j][1])
        return max(dx, dy) <= SLAB + CONTACT and min(dx, dy) <= SLAB - 2

    def _press_slabs(self):
        reward = 0.0
        for i in range(SLABS):
            for j in range(i):
                if self.group[i] == self.group[j]:
                    continue
                if not self.touching(i, j):
                    self.pressed.pop((i, j), None)
                    continue
                self.pressed[i, j] = self.pressed.get((i, j), 0) + 1
                if self.pressed[i, j] >= PRESS_STEPS:
                    old, new = self.group[i], self.group[j]
                    self.group = [new if number == old else number for number in self.group]
                    reward += 1.0
        return reward

    def _crawl(self):
        """Serpents wander, bite, and burst between two slabs."""
        reward = 0.0
        inside = self.half - SERPENT
        alive = []
        for x, y, vx, vy in self.serpents:
            x, y = x + vx, y + vy
            if abs(x - CENTRE) > inside:
                x, vx = float(np.clip(x, CENTRE - inside, CENTRE + inside)), -vx
            if abs(y - CENTRE) > inside:
                y, vy = float(np.clip(y, CENTRE - inside, CENTRE + inside)), -vy
            sides = [(sx - x, sy - y) for sx, sy in self.slabs if max(abs(sx - x), abs(sy - y)) < SLAB / 2 + 2]
            if len(sides) >= 2:
                reward += 0.5
                continue
            if sides:  # turn away from a single slab
                dx, dy = sides[0]
                if abs(dx) > abs(dy):
                    vx = -abs(vx) if dx > 0 else abs(vx)
                else:
                    vy = -abs(vy) if dy > 0 else abs(vy)
            if max(abs(x - self.explorer[0]), abs(y - self.explorer[1])) < (SERPENT + EXPLORER) / 2 + 0.5:
                reward += self._hurt()
            alive.append([x, y, vx, vy])
        self.serpents = alive
        return reward

    def _info(self):
        blocks = len(set(self.group))
        return {"is_success": self.won, "blocks": blocks, "lives": self.lives, "half": self.half, "taut": self.taut}

    # ----- picture

    def _draw(self):
        canvas = pygame.Surface((SIZE, SIZE), 0, 32)
        canvas.fill(JUNGLE)
        for x, y in self.leaves:
            pygame.draw.line(canvas, LEAF if (x + y) % 2 else MOSS, (x, y), (x + 2, y + 1))
        left, width = int(CENTRE - self.half), 2 * self.half
        room = pygame.Rect(left, left, width, width)
        pygame.draw.rect(canvas, WALL_TAUT if self.half >= WIDEST - 2 else WALL, room.inflate(4, 4), border_radius=4)
        canvas.fill(FLOOR, room)
        for joint in range(left + 6, left + width, 10):
            pygame.draw.line(canvas, FLOOR_JOINT, (left, joint), (left + width - 1, joint))
        pygame.draw.line(canvas, WHITE, (self.line, left), (self.line, left + width - 1))
        for i, (x, y) in enumerate(self.slabs):
            box = pygame.Rect(round(x - SLAB / 2), round(y - SLAB / 2), SLAB, SLAB)
            canvas.fill(STONE_EDGE, box)
            canvas.fill(STONE, box.inflate(-2, -2))
            fused = sum(number == self.group[i] for number in self.group)
            canvas.fill(STONE_GLYPH if fused > 1 else STONE_EDGE, box.inflate(-6, -6))
        for x, y, vx, vy in self.serpents:
            pygame.draw.circle(canvas, BLOOD, (round(x), round(y)), 2)
            pygame.draw.line(canvas, BLOOD_DARK, (round(x), round(y)), (round(x - 8 * vx), round(y - 8 * vy)), 2)
        if not (self.grace and self.steps % 4 < 2):
            x, y = round(self.explorer[0]), round(self.explorer[1])
            canvas.fill(KHAKI, (x - 2, y - 2, 4, 4))
            canvas.fill(HAT, (x - 2, y - 3, 4, 2))
        for life in range(max(self.lives, 0)):
            canvas.fill(GOLD, (2 + 6 * life, 1, 4, 3))
        for block in range(SLABS - len(set(self.group))):
            canvas.fill(STONE_GLYPH, (78 - 6 * block, 1, 4, 3))
        canvas.fill(WALL_TAUT, (32, 1, self.taut // 2, 2))
        return np.ascontiguousarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))

    def render(self):
        return self._draw()
