"""Short completions: a brief of sufficient length, a game that passes every check, and games that do not."""

from __future__ import annotations

import json
from pathlib import Path

from envcraft_llm.concepts.generation import concepts
from envcraft_llm.stages.briefs import SECTIONS
from envcraft_llm.stages.elaboration import PARTS

CONCEPTS = list(concepts(4, 0))

GAME = '''\
"""Errand: fetch the key, then go to the door. A guard walks its row; touching it loses."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 12
SIZE = 7
LIMIT = 200
KEY_PAY = 3.0
DOOR_PAY = 10.0
HIT_PAY = -5.0
MOVES = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.x, self.y = 0, SIZE - 1
        self.key = (int(self.np_random.integers(3, SIZE)), int(self.np_random.integers(4, SIZE)))
        self.door = (int(self.np_random.integers(4, SIZE)), 0)
        self.guard = int(self.np_random.integers(0, SIZE))
        self.heading = 1
        self.carrying = False
        self.ready = False
        self.lantern = False
        self.over = self.won = False
        return self._draw(), self._info()

    def step(self, action):
        if self.over or self.steps >= LIMIT:
            return self._draw(), 0.0, self.over, not self.over, self._info()
        move, grab, light = int(action[0]), int(action[1]), int(action[2])
        self.steps += 1
        reward = 0.0
        dx, dy = MOVES[move]
        self.x = min(max(self.x + dx, 0), SIZE - 1)
        self.y = min(max(self.y + dy, 0), SIZE - 1)
        self.lantern = light == 1
        reward += self._grab(grab)
        self._walk()
        if (self.x, self.y) == (self.guard, 3):
            reward += HIT_PAY
            self.over = True
        elif self.carrying and (self.x, self.y) == self.door and grab and light:
            reward += DOOR_PAY
            self.over = self.won = True
        return self._draw(), float(reward), self.over, not self.over and self.steps >= LIMIT, self._info()

    def _grab(self, grab):
        fresh = grab and not self.ready
        self.ready = bool(grab)
        if fresh and not self.carrying and (self.x, self.y) == self.key:
            self.carrying = True
            return KEY_PAY
        return 0.0

    def _walk(self):
        if self.steps % 3 == 0:
            if not 0 <= self.guard + self.heading < SIZE:
                self.heading = -self.heading
            self.guard += self.heading

    def _draw(self):
        frame = np.full((84, 84, 3), 30, np.uint8)
        if self.lantern:
            frame[:, :] = (70, 70, 40)
        self._cell(frame, self.door, (150, 90, 40))
        if not self.carrying:
            self._cell(frame, self.key, (240, 220, 60))
        self._cell(frame, (self.guard, 3), (220, 40, 40))
        self._cell(frame, (self.x, self.y), (90, 220, 120) if not self.carrying else (120, 220, 250))
        frame[82:84, : self.steps * 84 // LIMIT] = 200
        if self.ready:
            frame[0:2, 0:4] = 255
        return frame

    def _cell(self, frame, cell, colour):
        x, y = cell
        frame[y * CELL + 1 : y * CELL + CELL - 1, x * CELL + 1 : x * CELL + CELL - 1] = colour

    def _info(self):
        return {"is_success": bool(self.won), "steps": self.steps}

    def render(self):
        return self._draw()

    def close(self):
        pass
'''
#: Draws from the global random generator: EC204.
UNSEEDED = GAME.replace("import gymnasium", "import random\n\nimport gymnasium").replace(
    "int(self.np_random.integers(3, SIZE))", "random.randrange(3, SIZE)"
)
#: A degenerate repair: without the guard, the rewards and the buttons.
GUTTED = (
    GAME.replace("        self._walk()\n", "")
    .replace("        reward += self._grab(grab)\n", "        self.carrying = True\n")
    .replace("            reward += HIT_PAY\n", "")
    .replace(" and grab and light", "")
    .replace("int(action[0]), int(action[1]), int(action[2])", "int(action[0]), 0, 0")
)
POLICY = '''\
"""Go to the key, press, go to the door, press both; wait where the guard would be met."""


class Policy:
    def act(self, state):
        target = state.door if state.carrying else state.key
        x, y = state.x, state.y
        if (x, y) == tuple(target):
            return [0, int(not state.ready) if not state.carrying else 1, 1]
        if x != target[0]:
            return [4 if x < target[0] else 3, 0, 0]
        if y == 4 and target[1] < 4 and abs(state.guard - x) <= 1:
            return [0, 0, 0]
        return [1 if y > target[1] else 2, 0, 0]
'''
IDLE = "class Policy:\n    def act(self, state):\n        return [0, 0, 0]\n"


def brief(title: str = "Errand", words: int = 1600) -> str:
    """Return a brief of the game above with about this many words."""
    sentence = (
        "The guard walks its row one cell in 3 steps, the key pays 3 points, the door 10, and being hit costs 5. "
    )
    each = words // len(SECTIONS)
    body = (sentence * (each // 22 + 1)).split()[:each]
    return f"# {title}\n\n" + "\n".join(f"## {section}\n\n{' '.join(body)}\n" for section in SECTIONS)


def elaboration(numbers: str = "", words: int = 300) -> str:
    """Return an elaboration in six parts, with about this many words and these numbers."""
    each = " ".join(["the guard walks its row and the key is carried to the door"] * (words // len(PARTS) // 12 + 1))
    return "\n\n".join(f"{part}: {each} {numbers}".strip() for part in PARTS)


def verdict(viable: bool = True) -> str:
    objection = {"kind": "impossible-physics", "quote": "one cell in 3 steps", "why": "The guard is faster than light."}
    return json.dumps({"viable": viable, "objections": [] if viable else [objection], "summary": "An errand."})


def write(folder: Path, number: int, **files: str) -> None:
    """Write the recorded answers about the concept with this number, by file name without suffix."""
    place = folder / f"{number:02}_{CONCEPTS[number].id}"
    place.mkdir(parents=True)
    told = {"brief": brief(CONCEPTS[number].title), "viability": verdict(), **files}
    for name, text in told.items():
        ending = {"brief": ".md", "elaboration": ".md", "viability": ".json"}.get(name, ".py")
        (place / (name + ending)).write_text(text, "utf-8")


def small(folder: Path) -> Path:
    """Three concepts: one whose game and policy are repaired, one that is not viable, one whose repairs all fail.

    Short episodes make judging cheap. The last two repairs repeat the source of the first.
    """
    unseeded, game = (source.replace("LIMIT = 200", "LIMIT = 120") for source in (UNSEEDED, GAME))
    write(folder, 1, attempt_0=unseeded, attempt_1=game, policy_0=IDLE, policy_1=POLICY)
    write(folder, 2, viability=verdict(False))
    lost = {f"attempt_{number}": GAME.replace("import numpy", f"import numpy_{number}") for number in range(2)}
    write(folder, 3, **lost)
    return folder
