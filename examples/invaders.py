"""Invaders: shoot down the swarm before it bombs your cannon or lands.

Goal: fifteen invaders march from side to side, one step lower at every turn, and faster the fewer they are. Clear
the sky to win. The cannon stands three hits; a swarm that reaches the ground has won at once. The bar at the top shows
invaders left, shield charges and the cannon's hull.

Controls: left and right drive the cannon. The first button fires; there is only one shot in the air at a time, so
a miss costs the time of its flight. The second button raises the shield for a moment, twice in a game. Up and down are
unused.

Rewards: +0.4 for an invader, +4 for the last one, -1 for a hit, -2 when the game is lost.

What there is to learn: to lead a moving target, to leave the column under the swarm before the bomb arrives (bombs are
aimed at where the cannon is), and to choose which side of the swarm to thin out so that its turns come later.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
HUD = 8
MAX_STEPS = 1000
ROWS, COLUMNS = 3, 5
PITCH_X, PITCH_Y = 11, 9
INVADER = 7
DROP = 4
CANNON, CANNON_Y, CANNON_SPEED = 7, 74, 2
GROUND = 79
LANDING = 70
SHOT_SPEED = 3
BOMB_SPEED = 1.25
BOMBS = 3
HULL = 3
SHIELDS, SHIELD_STEPS = 2, 25
FLASH_STEPS = 12

SPACE, STAR, DIM, HILL, SOIL, CRAB, SQUID, OCTOPUS, PUPIL, STEEL, BRIGHT, SHOT, BOMB, AURA, SLOT = range(15)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex(
        "100c22 ececfa 585482 2e2852 624874 78e096 fa86aa 7ab2ff 100c22 c4ccde fafaff fff082 ff6e46 6ee6f0 322e50"
    ),
    dtype=np.uint8,
).reshape(-1, 3)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


# Two frames each: the swarm wriggles as it marches.
SPECIES = (
    (
        pixel_art("5.....5", ".55555.", "5585855", "5555555", ".5.5.5.", "5.....5"),
        pixel_art(".5...5.", ".55555.", "5585855", "5555555", "5.5.5.5", ".5...5."),
    ),
    (
        pixel_art("...6...", "..666..", ".68686.", "6666666", "..6.6..", ".6...6."),
        pixel_art("...6...", "..666..", ".68686.", "6666666", ".6...6.", "..6.6.."),
    ),
    (
        pixel_art(".77777.", "7777777", "7887887", "7777777", ".77.77.", "77...77"),
        pixel_art(".77777.", "7777777", "7887887", "7777777", "..7.7..", ".77.77."),
    ),
)
CANNON_ART = pixel_art("...a...", "...a...", ".99999.", "9999999", "99aaa99")


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its top left corner at (x, y)."""
    height, width = art.shape
    np.copyto(canvas[y : y + height, x : x + width], art, where=art > 0)


class Invaders(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """One cannon against a swarm."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.won = self.lost = False
        self._muster_swarm()
        self._ready_cannon()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, fire, shield = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, fire, shield)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        shot_down = ROWS * COLUMNS - int(self.alive.sum())
        return {"is_success": self.won, "score": shot_down, "hull": self.hull, "steps": self.steps}

    # -- the start -------------------------------------------------------------------------------------------------

    def _muster_swarm(self) -> None:
        self.alive = np.ones((ROWS, COLUMNS), dtype=bool)
        self.species = self.np_random.permutation(len(SPECIES)).tolist()
        self.swarm_x = int(self.np_random.integers(2, SIZE - 2 - COLUMNS * PITCH_X))
        self.swarm_y = HUD + int(self.np_random.integers(2, 7))
        self.march = 1 if self.np_random.random() < 0.5 else -1
        self.bombs: list[tuple[int, float]] = []
        self.next_bomb = 20

    def _ready_cannon(self) -> None:
        self.x = int(self.np_random.integers(6, SIZE - 6 - CANNON))
        self.hull = HULL
        self.shot: tuple[int, int] | None = None
        self.shields = SHIELDS
        self.shielded = 0
        self.flash = 0

    # -- the rules -------------------------------------------------------------------------------------------------

    def _advance(self, direction: int, fire: int, shield: int) -> float:
        self._drive(direction, fire, shield)
        reward = self._fly_shot()
        if self.won:
            return reward
        self._march()
        self._drop_bombs()
        reward += self._fly_bombs()
        if self.hull == 0 or self._lowest() > LANDING:
            self.lost = True
            reward -= 2.0
        return reward

    def _drive(self, direction: int, fire: int, shield: int) -> None:
        target = self.x + CANNON_SPEED * ((direction == 4) - (direction == 3))
        self.x = min(max(target, 1), SIZE - 1 - CANNON)
        if fire and self.shot is None:
            self.shot = (self.x + CANNON // 2, CANNON_Y)
        self.shielded = max(0, self.shielded - 1)
        self.flash = max(0, self.flash - 1)
        if shield and self.shields and not self.shielded:
            self.shields -= 1
            self.shielded = SHIELD_STEPS

    def _fly_shot(self) -> float:
        if self.shot is None:
            return 0.0
        x, y = self.shot[0], self.shot[1] - SHOT_SPEED
        self.shot = (x, y) if y > HUD else None
        column, across = divmod(x - self.swarm_x, PITCH_X)
        row, down = divmod(y - self.swarm_y, PITCH_Y)
        inside = 0 <= column < COLUMNS and 0 <= row < ROWS and across < INVADER and down < INVADER
        if not (inside and self.alive[row, column]):
            return 0.0
        self.alive[row, column] = False
        self.shot = None
        self.won = not self.alive.any()
        return 4.4 if self.won else 0.4

    def _march(self) -> None:
        # The fewer invaders are left, the shorter the pause between two steps of the swarm.
        if self.steps % (1 + int(self.alive.sum()) // 5):
            return
        columns = np.flatnonzero(self.alive.any(axis=0))
        left = self.swarm_x + int(columns[0]) * PITCH_X + self.march
        right = self.swarm_x + int(columns[-1]) * PITCH_X + INVADER + self.march
        if left < 1 or right > SIZE - 1:
            self.march = -self.march
            self.swarm_y += DROP
        else:
            self.swarm_x += self.march

    def _lowest(self) -> int:
        """The pixel row below the lowest invader."""
        return self.swarm_y + int(np.flatnonzero(self.alive.any(axis=1))[-1]) * PITCH_Y + INVADER

    def _drop_bombs(self) -> None:
        self.next_bomb -= 1
        if self.next_bomb > 0 or len(self.bombs) >= BOMBS:
            return
        self.next_bomb = int(self.np_random.integers(10, 24))
        columns = np.flatnonzero(self.alive.any(axis=0)).tolist()
        centres = [self.swarm_x + column * PITCH_X + INVADER // 2 for column in columns]
        if self.np_random.random() < 0.7:
            pick = min(range(len(columns)), key=lambda i: abs(centres[i] - self.x - CANNON // 2))
        else:
            pick = int(self.np_random.integers(len(columns)))
        lowest = int(np.flatnonzero(self.alive[:, columns[pick]])[-1])
        self.bombs.append((centres[pick], float(self.swarm_y + lowest * PITCH_Y + INVADER)))

    def _fly_bombs(self) -> float:
        reward = 0.0
        flying = []
        for x, y in self.bombs:
            y += BOMB_SPEED
            if y + 2 >= CANNON_Y + 2 and self.x <= x < self.x + CANNON:
                reward += self._take_hit()
            elif y + 2 < GROUND:
                flying.append((x, y))
        self.bombs = flying
        return reward

    def _take_hit(self) -> float:
        if self.shielded or not self.hull:
            return 0.0
        self.hull -= 1
        self.flash = FLASH_STEPS
        return -1.0

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), SPACE, dtype=np.uint8)
        stars = self.np_random.integers((0, HUD), (SIZE, 66), size=(36, 2)).tolist()
        for i, (x, y) in enumerate(stars):
            canvas[y, x] = STAR if i < 8 else DIM
        xs = np.arange(SIZE)
        hills = 71 + 3 * np.sin(xs / 7 + self.np_random.uniform(0, 6)) + 2 * np.sin(xs / 3.1 + self.swarm_x)
        canvas[np.arange(SIZE)[:, None] >= hills] = HILL
        canvas[GROUND:] = SOIL
        canvas[GROUND + 2 :: 2, ::3] = HILL
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        wriggle = (self.swarm_x + self.swarm_y) // 2 % 2
        for row, column in np.argwhere(self.alive).tolist():
            art = SPECIES[self.species[row]][wriggle]
            stamp(canvas, art, self.swarm_x + column * PITCH_X, self.swarm_y + row * PITCH_Y)
        for x, y in self.bombs:
            canvas[int(y) : int(y) + 3, x] = BOMB
            canvas[int(y) + 1, x - 1 : x + 2] = BOMB
        if self.shot is not None:
            canvas[self.shot[1] : self.shot[1] + 3, self.shot[0]] = SHOT
        if self.flash % 4 < 2:
            stamp(canvas, CANNON_ART, self.x, CANNON_Y)
        if self.shielded:
            canvas[CANNON_Y - 3, self.x : self.x + CANNON] = AURA
            canvas[CANNON_Y - 2 : CANNON_Y + 5, [self.x - 1, self.x + CANNON]] = AURA
        self._draw_hud(canvas)
        return canvas

    def _draw_hud(self, canvas: NDArray[np.uint8]) -> None:
        left = int(self.alive.sum())
        for i in range(ROWS * COLUMNS):
            canvas[2:6, 3 + 3 * i : 5 + 3 * i] = CRAB if i < left else SLOT
        for i in range(SHIELDS):
            canvas[2:6, 53 + 4 * i : 56 + 4 * i] = AURA if i < self.shields else SLOT
        for i in range(HULL):
            canvas[2:6, 66 + 6 * i : 70 + 6 * i] = STEEL if i < self.hull else SLOT
