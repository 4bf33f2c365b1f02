"""Moon base: drive the rover to three beacons in the order of their colours, over a field of craters.

The rover is slow in craters, and meteorites strike where their shadow grows; two hits end the drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import gymnasium
import numpy as np
import numpy.typing as npt
import pygame

Frame = npt.NDArray[np.uint8]
SIDE: Final = 84
SCALE: Final = 3
LIMIT: Final = 500
COLOURS: Final = ((226, 74, 74), (240, 200, 70), (84, 200, 120))


@dataclass
class Meteorite:
    x: float
    y: float
    fuse: int = 25


@dataclass
class World:
    rover: pygame.Vector2
    beacons: list[pygame.Vector2]
    craters: list[pygame.Vector2]
    meteorites: list[Meteorite] = field(default_factory=list)
    visited: int = 0
    hits: int = 0
    clock: int = 0


class MoonBase(gymnasium.Env[Frame, npt.NDArray[np.int64]]):
    """State is a dataclass that each reset makes anew."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = gymnasium.spaces.Box(0, 255, (SIDE, SIDE, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])
        self._board = pygame.Surface((SIDE * SCALE, SIDE * SCALE))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Frame, dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        points = self._apart(3 + 4 + 1)
        self.world = World(rover=points[0], beacons=points[1:4], craters=points[4:])
        return self._picture(), self._facts(False)

    def _apart(self, number: int) -> list[pygame.Vector2]:
        points: list[pygame.Vector2] = []
        while len(points) < number:
            x, y = self.np_random.uniform(9, SIDE - 9, size=2)
            if all(other.distance_to((x, y)) > 17 for other in points):
                points.append(pygame.Vector2(float(x), float(y)))
        return points

    def step(self, action: npt.NDArray[np.int64]) -> tuple[Frame, float, bool, bool, dict[str, Any]]:
        world = self.world
        self.steps += 1
        way = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))[int(action[0])]
        slow = any(crater.distance_to(world.rover) < 8 for crater in world.craters)
        world.rover += pygame.Vector2(way) * (0.7 if slow else 2.0)
        world.rover.update(min(max(world.rover.x, 3), SIDE - 3), min(max(world.rover.y, 3), SIDE - 3))
        reward = self._strike() + self._visit()
        won = world.visited == len(world.beacons)
        crashed = world.hits >= 2
        terminated = won or crashed
        return self._picture(), reward, terminated, self.steps >= LIMIT and not terminated, self._facts(won)

    def _strike(self) -> float:
        world, harm = self.world, 0.0
        if self.steps % 20 == 0:
            aim = world.rover + pygame.Vector2(self.np_random.normal(0, 9, size=2).tolist())
            world.meteorites.append(Meteorite(aim.x, aim.y))
        for meteorite in world.meteorites:
            meteorite.fuse -= 1
            if meteorite.fuse == 0 and world.rover.distance_to((meteorite.x, meteorite.y)) < 7:
                world.hits += 1
                harm -= 1.0
        world.meteorites = [meteorite for meteorite in world.meteorites if meteorite.fuse > 0]
        return harm

    def _visit(self) -> float:
        world = self.world
        if world.visited < 3 and world.rover.distance_to(world.beacons[world.visited]) < 5:
            world.visited += 1
            return 4.0 if world.visited == 3 else 1.0
        return 0.0

    def _facts(self, won: bool) -> dict[str, Any]:
        return {"is_success": won, "visited": self.world.visited, "hits": self.world.hits}

    def _picture(self) -> Frame:
        board, world = self._board, self.world
        board.fill((96, 96, 104))
        for crater in world.craters:
            pygame.draw.circle(board, (66, 66, 74), crater * SCALE, 8 * SCALE)
        for number, (beacon, colour) in enumerate(zip(world.beacons, COLOURS, strict=True)):
            width = 2 if number < world.visited else 0
            pygame.draw.circle(board, colour, beacon * SCALE, 5 * SCALE, width)
        for meteorite in world.meteorites:
            pygame.draw.circle(
                board, (24, 20, 20), (meteorite.x * SCALE, meteorite.y * SCALE), 7 * SCALE - meteorite.fuse // 2
            )
        body = pygame.Rect(0, 0, 6 * SCALE, 5 * SCALE)
        body.center = (int(world.rover.x * SCALE), int(world.rover.y * SCALE))
        pygame.draw.rect(board, (250, 250, 250), body)
        for number in range(2 - world.hits):
            pygame.draw.rect(board, (120, 220, 255), (6 + 15 * number, 6, 12, 9))
        small = pygame.transform.smoothscale(board, (SIDE, SIDE))
        return np.ascontiguousarray(pygame.surfarray.array3d(small).transpose(1, 0, 2))

    def render(self) -> Frame:
        return self._picture()
