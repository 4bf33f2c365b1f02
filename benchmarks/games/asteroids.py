"""Asteroids: the pygame game, a ship among drifting rocks, drawn at 1280x960 and scaled down to the frame.

Left and right turn, up thrusts, the first button fires. A rock that is hit breaks up, for one point; all of them gone
wins, and a collision costs one of ten shields and two points.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces
from numpy.typing import NDArray

WIDTH, HEIGHT = 1280, 960
SIZE = 84
ROCKS = 20
SHIELDS = 10
GRACE = 60
MAX_STEPS = 1000
INK, GLOW, EMBER = (214, 214, 232), (92, 176, 232), (255, 148, 56)


class Asteroids(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.canvas = pygame.Surface((WIDTH, HEIGHT))
        self.light = pygame.Surface((WIDTH, HEIGHT), pygame.SRCALPHA)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps, self.shields, self.hurt, self.angle = 0, SHIELDS, 0, 0.0
        self.place, self.speed = np.array([WIDTH / 2, HEIGHT / 2]), np.zeros(2)
        self.shots: list[tuple[NDArray[np.float64], NDArray[np.float64], int]] = []
        self.sparks: list[tuple[NDArray[np.float64], NDArray[np.float64], int]] = []
        self.sky = self._paint_sky()
        self.rocks = [self._rock(76) for _ in range(ROCKS)]
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        move, fire, _ = (int(part) for part in action)
        self.steps += 1
        self._steer(move, fire)
        reward = self._drift()
        terminated = not self.rocks or not self.shields
        return self.render(), reward, terminated, self.steps >= MAX_STEPS and not terminated, self._info()

    def render(self) -> NDArray[np.uint8]:
        self.canvas.blit(self.sky, (0, 0))
        self.light.fill((0, 0, 0, 0))
        for rock in self.rocks:
            turned = pygame.transform.rotozoom(rock["picture"], rock["angle"], rock["radius"] / 76)
            self.canvas.blit(turned, turned.get_rect(center=rock["place"].tolist()))
        for place, _, age in self.sparks:
            pygame.draw.circle(self.light, (*EMBER, max(255 - 12 * age, 0)), place.tolist(), 6)
        for place, _, _ in self.shots:
            pygame.draw.circle(self.light, (*GLOW, 90), place.tolist(), 18)
            pygame.draw.circle(self.light, (*INK, 255), place.tolist(), 6)
        pygame.draw.circle(self.light, (*GLOW, 25 * self.shields), self.place.tolist(), 52, 8)
        self.canvas.blit(self.light, (0, 0))
        corners = [self.place + 36 * _heading(self.angle + turn) for turn in (0.0, 2.5, 3.8)]
        pygame.draw.polygon(self.canvas, INK, [corner.tolist() for corner in corners])
        small = pygame.transform.smoothscale(self.canvas, (SIZE, SIZE))
        return np.ascontiguousarray(pygame.surfarray.array3d(small).swapaxes(0, 1))

    def _info(self) -> dict[str, Any]:
        return {"is_success": not self.rocks, "rocks": len(self.rocks), "shields": self.shields}

    def _paint_sky(self) -> pygame.Surface:
        sky = pygame.Surface((WIDTH, HEIGHT))
        for row in range(HEIGHT):
            pygame.draw.line(sky, (10, 10, 24 + row // 32), (0, row), (WIDTH, row))
        for x, y in self.np_random.integers((0, 0), (WIDTH, HEIGHT), size=(120, 2)).tolist():
            sky.set_at((x, y), INK)
        return sky

    def _rock(self, radius: float, place: NDArray[np.float64] | None = None) -> dict[str, Any]:
        picture = pygame.Surface((192, 192), pygame.SRCALPHA)
        reach = self.np_random.uniform(56, 92, size=11)
        edge = [
            (96 + r * math.cos(i * math.tau / 11), 96 + r * math.sin(i * math.tau / 11)) for i, r in enumerate(reach)
        ]
        pygame.draw.polygon(picture, (92, 78, 104), edge)
        pygame.draw.lines(picture, (150, 132, 150), True, edge, 8)
        if place is None:
            # On the rim, where the ship is not.
            side = self.np_random.random(2) * (WIDTH, 120)
            place = side if self.np_random.random() < 0.5 else side[::-1] * (0.1, 0.75)
        return {
            "place": place.copy(),
            "speed": self.np_random.uniform(-3.2, 3.2, size=2),
            "angle": 0.0,
            "spin": float(self.np_random.uniform(-3, 3)),
            "radius": radius,
            "picture": picture,
        }

    def _steer(self, move: int, fire: int) -> None:
        self.angle += 0.12 * ((move == 4) - (move == 3))
        ahead = _heading(self.angle)
        if move == 1:
            self.speed = self.speed * 0.98 + 0.4 * ahead
            self.sparks.append((self.place - 32 * ahead, -4 * ahead, 0))
        if fire and self.steps % 8 == 0:
            self.shots.append((self.place + 40 * ahead, self.speed + 14 * ahead, 0))

    def _drift(self) -> float:
        self.place = (self.place + self.speed) % (WIDTH, HEIGHT)
        self.shots = [((p + v) % (WIDTH, HEIGHT), v, age + 1) for p, v, age in self.shots if age < 60]
        self.sparks = [(p + v, v, age + 1) for p, v, age in self.sparks if age < 20]
        self.hurt = max(self.hurt - 1, 0)
        reward, kept = 0.0, []
        for rock in self.rocks:
            rock["place"] = (rock["place"] + rock["speed"]) % (WIDTH, HEIGHT)
            rock["angle"] += rock["spin"]
            hit = [shot for shot in self.shots if math.dist(shot[0], rock["place"]) < rock["radius"]]
            if hit or (not self.hurt and math.dist(self.place, rock["place"]) < rock["radius"] + 24):
                self.shots = [shot for shot in self.shots if not any(shot is other for other in hit)]
                reward += 1.0 if hit else -2.0
                if not hit:
                    self.shields, self.hurt = self.shields - 1, GRACE
                kept += self._break(rock)
            else:
                kept.append(rock)
        self.rocks = kept
        return reward

    def _break(self, rock: dict[str, Any]) -> list[dict[str, Any]]:
        for turn in range(12):
            self.sparks.append((rock["place"].copy(), 6 * _heading(turn * math.tau / 12), 0))
        return [self._rock(rock["radius"] * 0.6, rock["place"]) for _ in range(2)] if rock["radius"] > 40 else []


def _heading(angle: float) -> NDArray[np.float64]:
    return np.array([math.cos(angle), math.sin(angle)])
