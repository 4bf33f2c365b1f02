"""Platformer: run and jump through a scrolling landscape to the flag.

Goal: reach the flag at the far right. Falling into a pit or touching spikes or the side of a beetle ends the game; a
beetle that is jumped on from above is squashed. Coins mark good lines through the air. The bar at the top shows how far
the flag is, and the coins found.

Controls: left and right run. The first button jumps, as high as it is held, and has to be let go before the next jump.
The second button sprints, which makes jumps longer. Up and down are unused.

Rewards: +0.1 for each tile farther than before, +0.2 for a coin, +0.3 for a beetle, +5 for the flag, -1 for a lost
game.

What there is to learn: how long to hold a button. A tap is a hop and a long press is a leap, so an agent must hold
one button over many steps, which random play never does. Every seed is another landscape.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE, HUD, TILE = 84, 7, 7
ROWS, COLUMNS = 11, 42
WIDTH, FLAG = COLUMNS * TILE, COLUMNS - 4
MAX_STEPS = 1000
WIDE, HIGH = 5, 7
WALK, SPRINT = 1.4, 2.0
GRAVITY, MAX_FALL = 0.2, 3.0
JUMP, CUT, BOUNCE = -2.6, -0.9, -2.0
BEETLE_SPEED = 0.4
EMPTY, SOLID, SPIKE, COIN = range(4)

SKY, HAZE, CLOUD, HILL, GRASS, SOIL, STONE, INK, CAP, SKIN, COAT, GOLD, SHINE, SHELL, METAL, CLOTH = range(16)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex(
        "92ccec b0def0 f0f8fc 78b2a6 60ac52 926648 76503c 242030 "
        "de4248 fad0aa 3854a8 fac438 fff0aa 763e80 868a9e f0623c"
    ),
    dtype=np.uint8,
).reshape(-1, 3)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


RUNNER_ART = (
    pixel_art(".888.", ".8888", ".997.", ".999.", "aaaaa", ".aaa.", ".7.7."),
    pixel_art(".888.", ".8888", ".997.", ".999.", "aaaaa", ".aaa.", "7...7"),
)
BEETLE_ART = pixel_art("..ddd..", ".dddddd", "dddddd7", "7.7.7..")
COIN_ART = pixel_art(".bb.", "bccb", "bccb", ".bb.")
SPIKE_ART = pixel_art(".......", ".2...2.", ".e...e.", ".e7..e7", "eee.eee", "eee7eee", "eeeeeee")
FLAG_ART = pixel_art("eff....", "effff..", "efffff.", "effff..", "eff....", *["e......"] * 9)


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its top left corner at (x, y); what falls outside the screen is clipped."""
    left, top = max(0, -x), max(0, -y)
    part = art[top : max(0, SIZE - y), left : max(0, SIZE - x)]
    area = canvas[y + top : y + top + part.shape[0], x + left : x + left + part.shape[1]]
    np.copyto(area, part, where=part > 0)


class Platformer(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """Run, jump, collect, reach the flag."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = self.coins = 0
        self.won = self.lost = False
        self._build_level()
        self._enter_runner()
        self.hills, self.scenery = self._draw_hills(), self._draw_scenery()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, jump, sprint = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, jump, sprint)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "score": self.coins, "x": float(self.x), "steps": self.steps}

    # -- the level -------------------------------------------------------------------------------------------------

    def _build_level(self) -> None:
        """Lay obstacles from left to right, each followed by a stretch of ground to land on."""
        self.tiles = np.zeros((ROWS, COLUMNS), dtype=np.int8)
        self.beetles: list[tuple[float, float, int, int]] = []
        ground = 8
        column = self._lay_ground(0, int(self.np_random.integers(6, 9)), ground)
        while column < FLAG - 8:
            obstacle = int(self.np_random.integers(5))
            if obstacle == 0:
                column = self._lay_pit(column, ground)
            elif obstacle == 1:
                column = self._lay_spikes(column, ground)
            elif obstacle == 2:
                ground += 1 if ground == 7 or (ground == 8 and self.np_random.random() < 0.5) else -1
            elif obstacle == 3:
                column = self._lay_beetle(column, ground)
            else:
                column = self._lay_bridge(column, ground)
            column = self._lay_ground(column, int(self.np_random.integers(3, 6)), ground)
        self._lay_ground(column, COLUMNS - column, ground)
        self.flag_y = ground * TILE

    def _lay_ground(self, column: int, length: int, ground: int) -> int:
        self.tiles[ground:, column : column + length] = SOLID
        return column + length

    def _lay_pit(self, column: int, ground: int) -> int:
        width = int(self.np_random.integers(2, 4))
        self.tiles[ground - 3, column : column + width] = COIN
        return column + width

    def _lay_spikes(self, column: int, ground: int) -> int:
        width = int(self.np_random.integers(1, 3))
        self.tiles[ground - 1, column : column + width] = SPIKE
        self.tiles[ground - 3, column] = COIN
        return self._lay_ground(column, width, ground)

    def _lay_beetle(self, column: int, ground: int) -> int:
        end = self._lay_ground(column, 5, ground)
        speed = BEETLE_SPEED * (1 if self.np_random.random() < 0.5 else -1)
        self.beetles.append(((column + 2.0) * TILE, speed, column * TILE, ground * TILE))
        return end

    def _lay_bridge(self, column: int, ground: int) -> int:
        self.tiles[ground - 1, column + 2 : column + 4] = SOLID
        self.tiles[ground - 2, column + 2 : column + 4] = COIN
        return column + 6

    # -- the rules -------------------------------------------------------------------------------------------------

    def _enter_runner(self) -> None:
        self.x = float(self.np_random.integers(4, 22))
        self.y = float(8 * TILE - HIGH)
        self.vy = 0.0
        self.grounded, self.jump_held = True, False
        self.facing = 1
        self.best_tile = int(self.x) // TILE

    def _advance(self, direction: int, jump: int, sprint: int) -> float:
        self._run(direction, sprint)
        self._leap(bool(jump))
        self._fall()
        reward = self._collect() + self._meet_beetles() + self._progress()
        if self.x >= FLAG * TILE:
            self.won = True
            return reward + 5.0
        if self.lost or self.y > ROWS * TILE:
            self.lost = True
            return reward - 1.0
        return reward

    def _solid(self, x: float, y: float) -> bool:
        """Whether a runner at (x, y) overlaps the ground or leaves the level sideways."""
        if x < 0 or x + WIDE > WIDTH:
            return True
        left, right = int(x) // TILE, int(x + WIDE - 0.01) // TILE
        top, bottom = max(0, int(y) // TILE), min(ROWS, int(y + HIGH - 0.01) // TILE + 1)
        return bool((self.tiles[top:bottom, left : right + 1] == SOLID).any())

    def _run(self, direction: int, sprint: int) -> None:
        way = (direction == 4) - (direction == 3)
        self.facing = way or self.facing
        target = self.x + way * (SPRINT if sprint else WALK)
        if not self._solid(target, self.y):
            self.x = target

    def _leap(self, jump: bool) -> None:
        if jump and not self.jump_held and self.grounded:
            self.vy = JUMP
        elif not jump and self.vy < CUT:
            self.vy = CUT
        self.jump_held = jump

    def _fall(self) -> None:
        self.vy = min(self.vy + GRAVITY, MAX_FALL)
        target = self.y + self.vy
        blocked = self._solid(self.x, target)
        self.grounded = blocked and self.vy > 0
        if self.grounded:
            self.y = float(int(target + HIGH) // TILE * TILE - HIGH)
        elif not blocked:
            self.y = target
        if blocked:
            self.vy = 0.0

    def _collect(self) -> float:
        column, row = int(self.x + WIDE / 2) // TILE, int(self.y + HIGH / 2) // TILE
        tile = self.tiles[row, column] if 0 <= row < ROWS else EMPTY
        if tile == SPIKE:
            self.lost = True
        if tile != COIN:
            return 0.0
        self.tiles[row, column] = EMPTY
        self.coins += 1
        return 0.2

    def _meet_beetles(self) -> float:
        reward = 0.0
        alive = []
        for x, speed, left, ground in self.beetles:
            if not left <= x + speed <= left + 4 * TILE:
                speed = -speed
            x += speed
            touched = abs(x + 3.5 - self.x - WIDE / 2) < 5 and ground - 4 < self.y + HIGH <= ground + 1
            if touched and self.vy > 0 and not self.grounded:
                self.vy = BOUNCE
                reward += 0.3
            else:
                alive.append((x, speed, left, ground))
                self.lost |= touched
        self.beetles = alive
        return reward

    def _progress(self) -> float:
        gained = max(0, int(self.x) // TILE - self.best_tile)
        self.best_tile += gained
        return 0.1 * gained

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_hills(self) -> NDArray[np.uint8]:
        """The layer behind, half as wide as the level because it scrolls at half the speed."""
        canvas = np.full((SIZE, WIDTH // 2 + SIZE), SKY, dtype=np.uint8)
        rows, columns = np.indices(canvas.shape)
        canvas[rows > 40 + (rows + columns) % 2 * 6] = HAZE
        for x in range(10, canvas.shape[1] - 16, 34):
            y, shift = (int(self.np_random.integers(n)) for n in (16, 20))
            canvas[14 + y : 18 + y, x + shift : x + shift + 14] = CLOUD
            canvas[12 + y : 14 + y, x + shift + 3 : x + shift + 10] = CLOUD
        ridge = 54 + 7 * np.sin(columns / 11 + self.np_random.uniform(0, 6)) + 3 * np.sin(columns / 4.3)
        canvas[rows > ridge] = HILL
        return canvas

    def _draw_scenery(self) -> NDArray[np.uint8]:
        """All that stands still, over the whole width of the level; index 0 lets the hills show through."""
        canvas = np.zeros((SIZE, WIDTH), dtype=np.uint8)
        for row, column in np.argwhere(self.tiles == SOLID).tolist():
            x, y = column * TILE, HUD + row * TILE
            canvas[y : y + TILE, x : x + TILE] = SOIL
            canvas[[y + 3, y + 5], [x + 1 + row % 3, x + 4]] = STONE
            if self.tiles[row - 1, column] != SOLID:
                canvas[y : y + 2, x : x + TILE] = canvas[y + 2, x + 1 : x + TILE : 3] = GRASS
        pits = np.repeat(self.tiles[-1] != SOLID, TILE)
        canvas[-6:, pits] = canvas[-10:-6:2, pits] = INK
        for row, column in np.argwhere(self.tiles == SPIKE).tolist():
            canvas[HUD + row * TILE : HUD + (row + 1) * TILE, column * TILE : (column + 1) * TILE] = SPIKE_ART
        bottom = HUD + self.flag_y
        canvas[bottom - len(FLAG_ART) : bottom, FLAG * TILE : (FLAG + 1) * TILE] = FLAG_ART
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        camera = min(max(int(self.x) - 30, 0), WIDTH - SIZE)
        canvas = self.hills[:, camera // 2 : camera // 2 + SIZE].copy()
        scenery = self.scenery[:, camera : camera + SIZE]
        np.copyto(canvas, scenery, where=scenery > 0)
        first = camera // TILE
        for row, column in np.argwhere(self.tiles[:, first : first + 13] == COIN).tolist():
            stamp(canvas, COIN_ART, (first + column) * TILE + 2 - camera, HUD + row * TILE + 1 + self.steps // 8 % 2)
        for x, speed, _, ground in self.beetles:
            art = BEETLE_ART if speed > 0 else BEETLE_ART[:, ::-1]
            stamp(canvas, art, round(x) - camera, HUD + ground - 4)
        stride = int(not self.grounded or int(self.x) // 3 % 2)
        stamp(canvas, RUNNER_ART[stride][:, :: self.facing], round(self.x) - camera, HUD + round(self.y))
        self._draw_hud(canvas)
        return canvas

    def _draw_hud(self, canvas: NDArray[np.uint8]) -> None:
        canvas[:HUD] = INK
        canvas[3, 3:43], canvas[1:6, 43] = METAL, CLOTH
        place = 3 + int(38 * self.x / (FLAG * TILE))
        canvas[2:5, place : place + 2] = CAP
        for i in range(min(self.coins, 12)):
            canvas[2:5, SIZE - 4 - 3 * i : SIZE - 2 - 3 * i] = GOLD
