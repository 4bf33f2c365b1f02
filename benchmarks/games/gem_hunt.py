"""Gem hunt: a pygame game of 640x400 in the style in which language models write them.

The fox walks with the arrows and runs with the first button. Each of ten gems pays a point, and all of them win. A bat
that touches the fox takes one of five hearts and a point; without hearts the game is lost.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces
from numpy.typing import NDArray

WIDTH, HEIGHT = 640, 400
GEMS, BATS, HEARTS = 10, 4, 5
WALK, RUN = 4, 7
GRACE = 30
NIGHT, GRASS, FOX, GEM, BAT, INK = (16, 18, 40), (24, 60, 44), (236, 136, 56), (96, 220, 232), (92, 60, 116), (236,) * 3


class GemHunt(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = "rgb_array") -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        pygame.init()
        pygame.font.init()
        self.screen = pygame.Surface((WIDTH, HEIGHT))
        self.glow, self.fog, self.dusk = (pygame.Surface((WIDTH, HEIGHT), pygame.SRCALPHA) for _ in range(3))
        self.font = pygame.font.Font(None, 28)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps, self.hearts, self.hurt = 0, HEARTS, 0
        self.fox = np.array([WIDTH / 2, HEIGHT - 40.0])
        self.gems = [self._place(120) for _ in range(GEMS)]
        self.bats = [self._place(160) for _ in range(BATS)]
        self.ways = [self.np_random.uniform(-3, 3, size=2) for _ in range(BATS)]
        self.meadow = self._paint_meadow()
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        move, run, _ = (int(part) for part in action)
        self.steps += 1
        self._walk(move, RUN if run else WALK)
        reward = self._collect() - self._fly()
        terminated = not self.gems or self.hearts == 0
        return self._draw(), reward, terminated, False, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def close(self) -> None:
        pygame.quit()

    def _info(self) -> dict[str, Any]:
        return {"is_success": not self.gems, "gems": GEMS - len(self.gems), "hearts": self.hearts, "steps": self.steps}

    def _place(self, away: float) -> NDArray[np.float64]:
        """A place at some distance from the fox."""
        while True:
            place = self.np_random.uniform((30, 30), (WIDTH - 30, HEIGHT - 30))
            if math.dist(place, self.fox) > away:
                return place

    def _paint_meadow(self) -> pygame.Surface:
        meadow = pygame.Surface((WIDTH, HEIGHT))
        for row in range(HEIGHT):
            mixed = [int(a + (b - a) * row / HEIGHT) for a, b in zip(NIGHT, GRASS, strict=True)]
            pygame.draw.line(meadow, mixed, (0, row), (WIDTH, row))
        for x, y in self.np_random.integers((0, 0), (WIDTH, HEIGHT), size=(80, 2)).tolist():
            pygame.draw.circle(meadow, (40, 84, 60), (x, y), 2)
        return meadow

    def _walk(self, move: int, speed: int) -> None:
        way = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}.get(move, (0, 0))
        self.fox = np.clip(self.fox + np.multiply(way, speed), (16, 16), (WIDTH - 16, HEIGHT - 16))

    def _collect(self) -> float:
        left = [gem for gem in self.gems if math.dist(gem, self.fox) > 26]
        found = len(self.gems) - len(left)
        self.gems = left
        return float(found)

    def _fly(self) -> float:
        self.hurt = max(self.hurt - 1, 0)
        for number, bat in enumerate(self.bats):
            moved = bat + self.ways[number]
            for axis, size in enumerate((WIDTH, HEIGHT)):
                if not 12 <= moved[axis] <= size - 12:
                    self.ways[number][axis] *= -1
            self.bats[number] = np.clip(moved, (12, 12), (WIDTH - 12, HEIGHT - 12))
        if self.hurt or all(math.dist(bat, self.fox) > 26 for bat in self.bats):
            return 0.0
        self.hearts, self.hurt = self.hearts - 1, GRACE
        return 1.0

    def _draw(self) -> NDArray[np.uint8]:
        self.screen.blit(self.meadow, (0, 0))
        self.glow.fill((0, 0, 0, 0))
        for gem in self.gems:
            beat = 3 * math.sin(self.steps / 5 + gem[0])
            for size, strength in ((26, 24), (18, 48), (12, 96)):
                pygame.draw.circle(self.glow, (*GEM, strength), gem.tolist(), size + beat)
        for bat in self.bats:
            pygame.draw.circle(self.glow, (*BAT, 90), bat.tolist(), 22)
        pygame.draw.circle(self.glow, (255, 232, 160, 40), self.fox.tolist(), 70)
        self.screen.blit(self.glow, (0, 0))
        for x, y in (gem.tolist() for gem in self.gems):
            pygame.draw.polygon(self.screen, GEM, [(x, y - 12), (x + 9, y), (x, y + 12), (x - 9, y)])
        for x, y in (bat.tolist() for bat in self.bats):
            wing = 10 * math.sin(self.steps / 3 + x / 50)
            pygame.draw.polygon(self.screen, BAT, [(x - 22, y - wing), (x, y - 5), (x + 22, y - wing), (x, y + 9)])
            pygame.draw.circle(self.screen, INK, (x, y), 4)
        self.fog.fill((12, 14, 32, 120))
        self.dusk.fill((30, 20, 60, 40 + int(20 * math.sin(self.steps / 40))))
        for size, strength in ((150, 90), (110, 60), (80, 24)):
            pygame.draw.circle(self.fog, (12, 14, 32, strength), self.fox.tolist(), size)
        self.screen.blit(self.fog, (0, 0))
        self.screen.blit(self.dusk, (0, 0))
        bloom = pygame.transform.smoothscale(self.screen, (WIDTH // 4, HEIGHT // 4))
        bloom = pygame.transform.smoothscale(bloom, (WIDTH, HEIGHT))
        bloom.set_alpha(40)
        self.screen.blit(bloom, (0, 0))
        x, y = self.fox.tolist()
        pygame.draw.circle(self.screen, INK if self.hurt % 6 > 2 else FOX, (x, y), 16)
        pygame.draw.polygon(self.screen, FOX, [(x - 14, y - 8), (x - 10, y - 24), (x - 2, y - 14)])
        pygame.draw.polygon(self.screen, FOX, [(x + 14, y - 8), (x + 10, y - 24), (x + 2, y - 14)])
        words = f"gems {GEMS - len(self.gems)}/{GEMS}   hearts {self.hearts}"
        self.screen.blit(self.font.render(words, True, INK), (12, 10))
        return np.transpose(pygame.surfarray.array3d(self.screen), (1, 0, 2))
