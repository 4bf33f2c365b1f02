"""What lint says of things that are drawn beyond the picture, or in the colour of a background."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import found

GAME = """
import numpy as np
import pygame
import gymnasium as gym
SIDE, BAT, SAND, DARK = 84, (9, 8, 7), (200, 180, 90), (1, 2, 3)
CAVES = ({{"air": (40, 40, 40), "bat": (1, 1, 1)}}, {{"air": (9, 8, 7), "bat": (40, 50, 60)}})
class Game(gym.Env):
    TOP = 90
    def __init__(self):
        self.screen = pygame.Surface({size})
        self.grid = np.zeros((84, 84, 3), np.uint8)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.cave = 0
        self.bats = [1, 2]
        return self.see(), {{}}
    def step(self, action):
        self.x += 1
        self.cave = self.x // 10 % 2
        self.bats = [bat + 1 for bat in self.bats]
        return self.see(), 0.0, False, self.x > 99, {{}}
    def see(self):
        frame = np.zeros((SIDE, 84, 3), np.uint8)
        top = SIDE
        {draw}
        return frame
"""


def drawn(draw: str, size: str = "(SIDE, 84)") -> set[str]:
    return found(GAME.format(draw=draw.replace("\n", "\n        "), size=size)) & {"EC072", "EC073"}


@pytest.mark.parametrize(
    "draw",
    [
        "frame[84:88, : self.x] = 255",
        "frame[top + 2 :, 0:9] = self.x % 200",
        "frame[0:4, SIDE:] = self.x % 9",
        "self.grid[self.TOP : self.TOP + 4] = self.x % 9",
        "for bat in self.bats: frame[90:94, 0:4] = 255",
        "if self.x > 5: frame[90:94, 0:4] = 255",
        "pygame.draw.rect(self.screen, BAT, (4, top, self.x, 5))",
        "pygame.draw.rect(self.screen, BAT, pygame.Rect(self.x, top + 1, 5, 5))",
        "pygame.draw.ellipse(self.screen, (self.x, 0, 0), (84, 3, 5, 5))",
        "for i in range(self.x): pygame.draw.rect(self.screen, BAT, (5 * i, 2 * i + top, 5, 5))",
        "self.screen.blit(self.text(self.x), (3, self.TOP))",
    ],
)
def test_drawings_beyond_the_picture(draw: str) -> None:
    assert drawn(draw) == {"EC072"}


@pytest.mark.parametrize(
    ("draw", "size"),
    [
        ("frame[80:88, : self.x] = 255", "(84, 84)"),
        ("frame[84:88, 0:9] = 255", "(84, 84)"),
        ("frame[self.x :, 0:9] = self.x % 9", "(84, 84)"),
        ("if self.x: top = 2\nframe[top:, 0:9] = self.x % 9", "(84, 84)"),
        ("self.grid = np.zeros((99, 99))\nself.grid[90:94, 0:4] = self.x", "(84, 84)"),
        ("self.screen.fill(DARK)\npygame.draw.rect(self.screen, BAT, (4, 90, 5, 5))", "(84, 84)"),
        ("self.screen.blit(self.sky, (self.x % 84 + 84, 0))", "(84, 84)"),
        ("pygame.draw.rect(self.screen, BAT, (4, top, self.x, 5))", "(84, 99)"),
        ("pygame.draw.rect(self.screen, BAT, (4, top, self.x, 5))", "self.size"),
        ("frame[()] = self.x", "(84, 84)"),
        ("frame[..., 90:] = self.x", "(84, 84)"),
        ("frame[0:4, 84:2:-1] = self.x", "(84, 84)"),
        ("big = pygame.transform.scale(self.screen, (168, 168))\nbig.blit(self.text(self.x), (3, 90))", "(84, 84)"),
        ("self.board.blit(self.text(self.x), (3, 90))", "(84, 84)"),
        ("pygame.draw.circle(self.screen, BAT, (4, top + 2), self.x)", "(84, 84)"),
    ],
)
def test_drawings_that_show(draw: str, size: str) -> None:
    assert drawn(draw, size) == set()


@pytest.mark.parametrize(
    "draw",
    [
        'frame[:] = CAVES[self.cave]["air"]\nfor bat in self.bats: frame[bat, bat] = BAT',
        'cave = CAVES[self.cave]\nself.screen.fill(cave["air"])\n'
        "for bat in self.bats: pygame.draw.rect(self.screen, BAT, (bat, 1, 5, 5))",
        'frame = np.full((84, 84, 3), CAVES[self.cave]["air"], np.uint8)\nfor bat in self.bats: frame[bat, 0] = BAT',
    ],
)
def test_things_that_the_background_hides(draw: str) -> None:
    assert drawn(draw) == {"EC073"}


@pytest.mark.parametrize(
    "draw",
    [
        'frame[:] = CAVES[self.cave]["air"]\nfor bat in self.bats: frame[bat, bat] = SAND',
        'frame[:] = CAVES[self.cave]["air"]\nfor bat in self.bats: frame[bat, bat], frame[bat, 0] = BAT, SAND',
        'frame[:] = CAVES[self.cave]["air"]\nfor bat in self.bats: frame[bat, bat] = CAVES[self.cave]["bat"]',
        'frame[:9] = CAVES[self.cave]["air"]\nfor bat in self.bats: frame[bat, bat] = BAT',
        "frame[:] = BAT\nfor bat in self.bats: frame[bat, bat] = BAT",
    ],
)
def test_things_that_are_seen(draw: str) -> None:
    assert drawn(draw) == set()
