"""The code that all games share. Mechanics fill the slots in double angle brackets."""

from __future__ import annotations

SKELETON = '''\
"""<<title>>

<<about>>
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE, MAX_STEPS = 84, 1000
<<constants>>
# The frame of a move: stay, up, down, left, right; and the opposite of each.
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
BACK = (0, 2, 1, 4, 3)
# The joint actions that differ in this game.
ACTIONS = (<<actions>>)
# Colours of <<colours>>.
PALETTE = np.array(bytearray.fromhex("<<palette>>")).reshape(-1, 3)


def sprite(rows: str) -> np.ndarray:
    """A mask of CELL by CELL pixels from five rows of five marks."""
    mask = np.array([[mark == "1" for mark in row] for row in rows.split()])
    scale = np.arange(CELL) * 5 // CELL
    return mask[scale][:, scale]


<<sprites>>


class <<class>>(gym.Env):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.steps, self.clock, self.reward, self.won, self.lost = 0, 0, 0.0, False, False
        <<build>>
        <<avatar>>
        <<place>>
        self._touch()
        self.total = self.fewest = self._remaining()
        self._paint()
        return self.render(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        move, first, second = (int(part) for part in action)
        self.steps, self.reward = self.steps + 1, 0.0
        if not (self.won or self.lost):
            self.clock, self.reward = self.clock + 1, -COST
            <<before>>
            <<act>>
            self._touch()
            <<stir>>
            <<again>>
            <<press>>
            self._settle()
        truncated = self.steps >= MAX_STEPS and not (self.won or self.lost)
        return self.render(), self.reward, self.won or self.lost, truncated, self._info()

    def get_state(self) -> dict[str, Any]:
        """The whole state for privileged players: `targets` are the places that count now."""
        state = {**vars(self), "targets": self._targets(), "remaining": self._remaining(), "actions": ACTIONS}
        return {name: value for name, value in state.items() if name not in ("picture", "_np_random")}

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "remaining": self._remaining()}

    def _settle(self) -> None:
        """Pay for progress beyond the best so far, and end the game."""
        left = self._remaining()
        self.reward += POINT * max(self.fewest - left, 0)
        self.fewest = min(left, self.fewest)
        if left == 0:
            self.won, self.lost = True, False
            self.reward += PRIZE
        elif self.lost:
            self.reward -= PENALTY

    def _touch(self) -> None:
        """What happens where the avatar is."""
        <<touch>>

    <<methods>>

    def render(self) -> np.ndarray:
        frame = self.picture.copy()
        <<draw>>
        self._blit(frame, self.at, HERO, PALETTE[3])
        <<over>>
        width = round(56 * (self.total - self._remaining()) / self.total)
        frame[1:4, 1 : 1 + width] = PALETTE[4]
        <<hud>>
        return frame

    def _blit(self, frame: np.ndarray, place: tuple, mask: np.ndarray, colour: np.ndarray) -> None:
        top, left = self._pixel(place)
        frame[top : top + CELL, left : left + CELL][mask] = colour
'''
