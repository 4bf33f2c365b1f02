"""Short, different games, and a corpus with verdicts on them that no run had to compute."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from envcraft.contracts.builtin import ARCADE, ARCADE_NATIVE, GYMNASIUM
from envcraft.corpus.store import Environment, Store
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.contract import Contract
from envcraft.model.verdict import SubjectReport, Verdict

#: Frames of any size; `end` is when it ends, `body` what else a step does.
GAME = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class {name}(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}

    def __init__(self, render_mode=None, start=0):
        self.observation_space = spaces.Box(0, 255, ({height}, {width}, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode
        self.start = start

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.score = self.start, 0
        self.noise = self.np_random.integers(0, 256, ({height}, {width}, 3), dtype=np.uint8)
        return self.render(), {{"level": int(self.noise[0, 0, 0])}}

    def step(self, action):
        self.steps += 1
        self.score += int(action[0]) + 2 * int(action[1])
        {body}
        terminated = {end}
        info = {{"is_success": terminated, "score": self.score, "place": np.array([self.steps, 2.5], np.float32)}}
        if self.steps % 3 == 0:
            info["third"] = {{"steps": self.steps, "name": "three"}}
        return self.render(), self.score / 7, terminated, False, info

    def render(self):
        return np.roll(self.noise, self.steps + 3 * self.score, axis=1)
"""


def game(name: str = "Game", end: str = "self.steps >= 9", body: str = "pass", size: tuple[int, int] = (84, 84)) -> str:
    return GAME.format(name=name, end=end, body=body, height=size[0], width=size[1])


def judged(
    store: Store,
    name: str,
    text: str,
    env_class: str,
    contract: Contract,
    verdict: Verdict,
    rules: str = "rules",
    budget: str = "quick",
    checks: str = "",
    offered: str = "",
) -> None:
    """Add an environment with a verdict."""
    store.add(name, text.encode())
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    digest = contract_digest(contract)
    settings = Settings(contract.name, digest, rules, 0, budget, "process", "python 3", checks, offered)
    report = SubjectReport(name, env_class, sha256, verdict, "process", 0.1, 10, [])
    store.record(Environment(name, sha256, ""), store.settings(settings), report)


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    """Passed: four of ``arcade``, one of ``arcade-native``, one of ``gymnasium``. Beside them one that failed, and one
    that was not judged, each of which leaves a file where it is imported.
    """
    root = tmp_path / "games"
    trace = f"open({str(tmp_path / 'imported')!r}, 'w').close()\n"
    with Store.create(root) as store:
        for number, name in enumerate(("ant", "bee", "cat", "deep/dog")):
            text = game(name.rpartition("/")[2].title(), f"self.steps >= {5 + 2 * number}")
            judged(store, f"{name}.py", text, name.rpartition("/")[2].title(), ARCADE, Verdict.PASS)
        native = game("Native", "self.steps >= 2000", size=(125, 203))
        judged(store, "native.py", native, "Native", ARCADE_NATIVE, Verdict.PASS)
        judged(store, "point.py", POINT, "Point", GYMNASIUM, Verdict.PASS)
        judged(store, "failed.py", trace + game("Failed"), "Failed", ARCADE, Verdict.FAIL)
        store.add("new.py", (trace + game("New")).encode())
    return root


POINT = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Point(gym.Env):
    def __init__(self):
        self.observation_space = spaces.Box(-np.inf, np.array([1, 2], np.float32), (2,), np.float32)
        self.action_space = spaces.Discrete(3, start=-1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = self.np_random.normal(size=2).astype(np.float32) - 5
        return self.at.copy(), {}

    def step(self, action):
        assert isinstance(action, np.int64)
        self.at = self.at + np.float32(action) / 3
        return self.at.copy(), float(self.at.sum()), False, bool(self.at[0] < -7), {}
"""
