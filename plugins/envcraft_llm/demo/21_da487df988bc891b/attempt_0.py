"""Circuit Board: an electron glides over a board without friction until something stops it.

It has to come to rest exactly on the output pin, which lies on the far island of the board. A channel two cells wide
separates the islands and is crossed on planks; cracked capacitors are blown away with timed charges; and every 100
steps an echo sets out from the output pin, repeats what the electron did 80 steps ago and kills at a touch. Echoes and
electron light switches, and while one is lit the gate beside the pin is open.
"""

from collections import deque

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
COLS, ROWS = 14, 12
TOP = 12
CHANNEL = (7, 8)  # the columns of the channel
MAX_STEPS = 850
LIVES = 2
HOLES = 4
CAPACITORS = 10
CRACKED = 8
SWITCHES = 3
SWITCH_GLOW = 120

PLANKS = 5
PLANK_CROSSINGS = 4
FUSE = 21
BLAST = 2  # cells along the two axes
MAX_CHARGES = 3
ECHO_EVERY = 100
ECHO_DELAY = 80
MAX_ECHOES = 4
NEAREST_SOLUTION, FARTHEST_SOLUTION = 2, 3  # slides and planks from the start to the pin

DIRS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

(BOARD, TRACE, CHIP, CHIP_EDGE, CRACK, HOLE, CHANNEL_INK, PLANK, PIN, PIN_CORE, ELECTRON, HALO, GHOST, CHARGE, SPARK,
 SWITCH_OFF, SWITCH_ON, GATE, HUD, LIFE) = range(20)
COLORS = np.array(
    [
        (18, 92, 58), (32, 122, 76), (40, 44, 52), (92, 98, 110), (196, 120, 60), (6, 20, 14), (10, 46, 34),
        (206, 132, 70), (210, 214, 222), (255, 255, 255), (255, 240, 90), (255, 190, 40), (150, 190, 160),
        (230, 60, 50), (255, 250, 200), (120, 60, 30), (120, 255, 160), (178, 184, 196), (12, 40, 30), (255, 214, 60),
    ],
    dtype=np.uint8,
)  # fmt: skip


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, shape=(84, 84, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # -- level ------------------------------------------------------------------------------------------------------

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        while not self._lay_out():
            pass
        self.steps = 0
        self.lives = LIVES
        self.position = self.start
        self.heading = 0
        self.facing = 4
        self.carried = PLANKS
        self.planks = {}  # row: crossings left
        self.charges = []  # [cell, steps left]
        self.blast = []
        self.echoes = []  # [cell, index in the log]
        self.log = []
        self.glow = [0] * SWITCHES
        self.won = self.lost = False
        self.base = self._draw_base()
        return self.render(), self._info()

    def _lay_out(self):
        """Draw a board at random; say whether the pin can be reached, neither too soon nor too late."""
        free = [(c, r) for c in range(COLS) for r in range(ROWS) if c not in CHANNEL]
        order = [free[i] for i in self.np_random.permutation(len(free)).tolist()]
        self.start = next(cell for cell in order if cell[0] == CHANNEL[0] - 1)
        order.remove(self.start)
        self.capacitors = set(order[:CAPACITORS])
        self.cracked = set(order[CAPACITORS : CAPACITORS + CRACKED])
        rest = order[CAPACITORS + CRACKED :]
        self.holes = set(rest[:HOLES])
        self.switches = rest[HOLES : HOLES + SWITCHES]
        self.gate = None
        self.glow = [0] * SWITCHES
        distances = self._slide_distances()
        goals = [
            cell
            for cell in rest[HOLES + SWITCHES :]
            if cell[0] > CHANNEL[1] and NEAREST_SOLUTION <= distances.get(cell, 99) <= FARTHEST_SOLUTION
        ]
        if not goals:
            return False
        self.pin = goals[0]
        beside = [(self.pin[0] + dc, self.pin[1] + dr) for dc, dr in DIRS.values()]
        spots = [cell for cell in rest[HOLES + SWITCHES :] if cell in beside and cell[0] > CHANNEL[1]]
        if not spots:
            return False
        self.gate = spots[0]
        distances = self._slide_distances()
        return NEAREST_SOLUTION <= distances.get(self.pin, 99) <= FARTHEST_SOLUTION

    def _slide_distances(self):
        """How many slides each resting place is away, planks laid wherever the channel is met from the bank."""
        distance = {self.start: 0}
        queue = deque([self.start])
        while queue:
            cell = queue.popleft()
            for way in DIRS.values():
                end = self._slide_end(cell, way)
                if end is not None and end not in distance:
                    distance[end] = distance[cell] + 1
                    queue.append(end)
        return distance

    def _slide_end(self, cell, way):
        """Where a slide ends; None in a hole, or in the channel where no plank can be laid from a resting place."""
        on_bank = cell[0] + way[0] in CHANNEL
        while True:
            ahead = (cell[0] + way[0], cell[1] + way[1])
            if self.is_solid(ahead):
                return cell
            if ahead in self.holes or (ahead[0] in CHANNEL and not on_bank):
                return None
            cell = ahead

    def is_solid(self, cell):
        column, row = cell
        if not (0 <= column < COLS and 0 <= row < ROWS):
            return True
        gate_shut = cell == self.gate and not any(self.glow)
        return cell in self.capacitors or cell in self.cracked or gate_shut

    # -- rules ------------------------------------------------------------------------------------------------------

    def step(self, action):
        move, plank, charge = (int(a) for a in action)
        self.steps += 1
        reward = 0.0
        if not (self.won or self.lost):
            if not self.heading:
                self._act_at_rest(move, plank, charge)
            before = self.position
            if self.heading:
                reward += self._glide()
            self.log.append((self.position[0] - before[0], self.position[1] - before[1]))
            reward += self._burn_fuses() + self._walk_echoes()
            self._hold_switches()
            if not self.heading and self.position == self.pin and self.lives > 0:
                self.won = True
                reward += 5.0
            elif self.lives <= 0 or (self.carried == 0 and not self.planks):
                self.lost = True
                reward -= 1.0
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), float(reward), terminated, truncated, self._info()

    def _act_at_rest(self, move, plank, charge):
        if move:
            self.facing = move
        if plank:
            self._use_plank()
        elif charge and not move and len(self.charges) < MAX_CHARGES:
            if all(self.position != cell for cell, _ in self.charges):
                self.charges.append([self.position, FUSE])
        elif move:
            self.heading = move

    def _use_plank(self):
        """Lay a plank across the channel ahead, or take up the one that lies there."""
        way = DIRS[self.facing]
        if self.position[0] + way[0] not in CHANNEL:
            return
        row = self.position[1]
        if row in self.planks:
            del self.planks[row]
            self.carried += 1
        elif self.carried:
            self.planks[row] = PLANK_CROSSINGS
            self.carried -= 1

    def _glide(self):
        way = DIRS[self.heading]
        ahead = (self.position[0] + way[0], self.position[1] + way[1])
        if self.is_solid(ahead):
            self.heading = 0
            return 0.0
        was_inside = self.position[0] in CHANNEL
        self.position = ahead
        if ahead in self.holes:
            return self._hurt()
        if ahead[0] in CHANNEL:
            if ahead[1] not in self.planks or way[0] == 0:
                return self._hurt()
        elif was_inside:
            self.planks[ahead[1]] -= 1
            if self.planks[ahead[1]] == 0:
                del self.planks[ahead[1]]
        following = (ahead[0] + way[0], ahead[1] + way[1])
        if self.is_solid(following):
            self.heading = 0
        return 0.0

    def _hurt(self):
        self.lives -= 1
        self.position = self.start
        self.heading = 0
        return -1.0

    def _burn_fuses(self):
        reward = 0.0
        self.blast = []
        for charge in list(self.charges):
            charge[1] -= 1
            if charge[1]:
                continue
            self.charges.remove(charge)
            column, row = charge[0]
            for dc, dr in DIRS.values():
                for reach in range(BLAST + 1):
                    cell = (column + dc * reach, row + dr * reach)
                    if cell in self.capacitors:
                        break
                    self.blast.append(cell)
            reward += 0.1 * len(self.cracked.intersection(self.blast))
            self.cracked.difference_update(self.blast)
            if self.position in self.blast:
                reward += self._hurt()
        return reward

    def _walk_echoes(self):
        if self.steps % ECHO_EVERY == 0 and len(self.echoes) < MAX_ECHOES:
            self.echoes.append([self.pin, max(0, self.steps - ECHO_DELAY)])
        reward = 0.0
        for echo in self.echoes:
            dc, dr = self.log[echo[1]]
            target = (echo[0][0] + dc, echo[0][1] + dr)
            if abs(dc) + abs(dr) == 1 and not self.is_solid(target):
                echo[0] = target
            echo[1] += 1
            if echo[0] == self.position and self.position not in (self.start, self.pin):
                reward += self._hurt()
        return reward

    def _hold_switches(self):
        held = {self.position, *(echo[0] for echo in self.echoes)}
        for number, cell in enumerate(self.switches):
            self.glow[number] = SWITCH_GLOW if cell in held else max(0, self.glow[number] - 1)

    def _info(self):
        return {"is_success": self.won, "lives": self.lives, "carried": self.carried, "echoes": len(self.echoes)}

    # -- picture ----------------------------------------------------------------------------------------------------

    def _block(self, canvas, cell, ink, margin=0):
        x, y = cell[0] * CELL, TOP + cell[1] * CELL
        canvas[y + margin : y + CELL - margin, x + margin : x + CELL - margin] = ink

    def _draw_base(self):
        canvas = np.full((84, 84), BOARD, dtype=np.uint8)
        for line in self.np_random.integers(0, ROWS, size=5).tolist():  # copper traces
            canvas[TOP + line * CELL + 2, :] = TRACE
            canvas[TOP:, (line * 5 + 3) % 84] = TRACE
        canvas[:TOP] = HUD
        canvas[TOP:, CHANNEL[0] * CELL : (CHANNEL[1] + 1) * CELL] = CHANNEL_INK
        for cell in self.capacitors:
            self._block(canvas, cell, CHIP_EDGE)
            self._block(canvas, cell, CHIP, 1)
        for cell in self.holes:
            self._block(canvas, cell, HOLE)
        self._block(canvas, self.pin, PIN)
        self._block(canvas, self.pin, PIN_CORE, 2)
        return canvas

    def render(self):
        canvas = self.base.copy()
        for number, cell in enumerate(self.switches):
            self._block(canvas, cell, SWITCH_ON if self.glow[number] else SWITCH_OFF, 1)
        if not any(self.glow):
            self._block(canvas, self.gate, GATE)
            self._block(canvas, self.gate, HUD, 2)
        for cell in self.cracked:
            self._block(canvas, cell, CHIP)
            x, y = cell[0] * CELL, TOP + cell[1] * CELL
            canvas[[y + 1, y + 2, y + 3, y + 4], [x + 1, x + 3, x + 2, x + 4]] = CRACK
        for row, left in self.planks.items():
            y = TOP + row * CELL
            canvas[y + 1 : y + 5, CHANNEL[0] * CELL : (CHANNEL[1] + 1) * CELL] = PLANK
            canvas[y + 2, CHANNEL[0] * CELL : CHANNEL[0] * CELL + 3 * left] = CHIP
        for cell, left in self.charges:
            self._block(canvas, cell, SPARK if left % 4 == 0 else CHARGE, 1)
        for cell in self.blast:
            if 0 <= cell[0] < COLS and 0 <= cell[1] < ROWS:
                self._block(canvas, cell, SPARK)
        for cell, _ in self.echoes:
            self._block(canvas, cell, GHOST, 1)
        self._block(canvas, self.position, HALO)
        self._block(canvas, self.position, ELECTRON, 1)
        for life in range(self.lives):
            canvas[3:9, 3 + 8 * life : 9 + 8 * life] = LIFE
        for plank in range(self.carried):
            canvas[4:8, 28 + 7 * plank : 33 + 7 * plank] = PLANK
        for number in range(MAX_CHARGES - len(self.charges)):
            canvas[4:8, 68 + 5 * number : 71 + 5 * number] = CHARGE
        return COLORS[canvas]
