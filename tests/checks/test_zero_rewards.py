"""Code whose ``step`` returns no reward but zero, for certain, and code that may pay."""

from __future__ import annotations

import pytest
from envcraft_checks.rewards.zeros import pays_nothing

_STEP = """
BONUS = 0.0
class Game:
    prize = 0
    def step(self, action):
        {}
        return self.frame, {}, done, False, {{}}
"""


@pytest.mark.parametrize(
    ("before", "reward"),
    [
        ("pass", "0.0"),
        ("pass", "-0"),
        ("reward = 0", "reward"),
        ("reward: float = 0.0", "float(reward)"),
        ("reward = BONUS * self.score", "reward"),
        ("reward = 0; reward += BONUS", "reward"),
        ("reward = 0; reward *= 5", "reward"),
        ("reward, won = 0.0, True", "np.float32(reward)"),
        ("pass", "self.prize if won else BONUS"),
        ("reward = self.prize\n        reward = reward - reward", "reward"),
    ],
)
def test_nothing_is_paid(before: str, reward: str) -> None:
    assert pays_nothing(_STEP.format(before, reward))


@pytest.mark.parametrize(
    ("before", "reward"),
    [
        ("pass", "1.0"),
        ("reward = 0\n        if won: reward = 1", "reward"),
        ("reward = 0; reward += self.gain", "reward"),
        ("reward = 0; reward -= 1", "reward"),
        ("reward = 0; reward **= 0", "reward"),
        ("reward, won = self.pay()", "reward"),
        ("for reward in self.rewards: pass", "reward"),
        ("reward = 0.0\n        with open() as reward: pass", "reward"),
        ("pass", "self._reward()"),
        ("pass", "unknown"),
        ("self.prize = 3", "self.prize"),
        ("if done: return self.last", "0.0"),
        ("pass", "None"),
    ],
)
def test_something_may_be_paid(before: str, reward: str) -> None:
    assert not pays_nothing(_STEP.format(before, reward))


def test_a_name_of_another_function_is_another_one() -> None:
    game = _STEP.format("reward = 0", "reward")
    assert pays_nothing(game + "    def other(self):\n        reward = 1\n")
    held = _STEP.format("reward = self.prize", "reward")
    assert not pays_nothing(held + "    def other(self, gain):\n        self.prize = gain\n")
    assert not pays_nothing(held + "    def other(self):\n        value = 3\n        self.prize = value\n")


def test_code_without_a_step_may_pay() -> None:
    assert not pays_nothing("class Game(Base): pass")
    assert not pays_nothing("def step(: pass")
