"""Results of step() and rewards that the check lint reports as being the wrong ones."""

from __future__ import annotations

import ast
import textwrap

import pytest
from envcraft_checks.lint import Lint
from envcraft_checks.linting.program import Program
from envcraft_checks.linting.unpaid import unpaid_successes

from envcraft.model.target import Target
from envcraft.model.verdict import Severity
from tests.checks.lint_games import found, subject_of

GAME = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.picked, self.hearts, self.pills, self.steps, self.won = 0, 0, 3, 1, 0, False
        self.crates, self.lamps, self.sparks = [3, 5], [False] * 3, []
        self.y = 2 * int(self.np_random.integers(9))
        self.rock = np.zeros((84, 84), bool)
        return self.at, {}
    def step(self, action):
        self.steps += 1
        self.at += int(action[0])
        self.y = min(max(self.y - int(action[1]), 0), 80)
        terminated = truncated = False
        reward = 0.0
STEP
    def _info(self):
        return {"is_success": self.won}
    def _is_outside(self):
        return self.y <= 0
    def _listed(self):
        return list(self._info())
"""


def codes(step: str) -> set[str]:
    """The codes that lint reports on a game with these statements in step(), the last of which gives the results."""
    if "self.won = True" not in step and ("self.won" in step or "_info" in step):
        step = f"if self.at > 70:\n    self.won = terminated = True\n{step}"
    return found(GAME.replace("STEP", textwrap.indent(step, " " * 8)))


@pytest.mark.parametrize(
    "step",
    [
        "return self.at, reward, truncated, terminated, self._info()",
        "truncated = self.steps >= 99\nreturn self.at, reward, terminated or truncated, False, self._info()",
        "truncated = self.steps >= 99\ndone = terminated or truncated\nreturn self.at, reward, bool(done), False, {}",
        "terminated = self.won or self.at < 0\nreturn self.at, reward, False, terminated or truncated, self._info()",
        "return self.at, reward, terminated, truncated, list(self._info())",
        "return self.at, reward, terminated, truncated, self._listed() if self.at else self._info()",
        "return self.at, reward, terminated, truncated, None",
        "if self.hearts < 1:\n    return self.at, -1.0, True, False, {'hearts': 0}\n"
        "return self.at, reward, terminated, truncated, self._info()",
        "if self.hearts < 1:\n    info = {'hearts': 0}\n    return self.at, reward - 1, True, False, info\n"
        "info = {'is_success': self.won}\nreturn self.at, reward, terminated, truncated, info",
    ],
)
def test_a_wrong_result(step: str) -> None:
    assert codes(step) == {"EC061"}


@pytest.mark.parametrize(
    "step",
    [
        "return self.at, reward, terminated, truncated, self._info()",
        "return self.at, reward, terminated, truncated, dict(self._info())",
        "return self.at, reward, terminated or truncated, False, self._info()",
        "truncated = self.steps >= 99\ndone = terminated or truncated\nreturn self.at, reward, done, truncated, {}",
        # Success is reported at the end only.
        "if self.won:\n    return self.at, 5.0, True, False, {'is_success': True}\n"
        "return self.at, reward - 0.01, False, truncated, {}",
        # After the end.
        "if self.won:\n    return self.at, 0.0, True, False, {}\n"
        "return self.at, reward, terminated, truncated, self._info()",
        "info = {'at': self.at}\nif self.steps > 3:\n    info['is_success'] = self.won\n"
        "return self.at, reward, terminated, truncated, info",
        "info = self._info()\nif self.hearts < 1:\n    info['hearts'] = 0\n"
        "    return self.at, reward - 1, True, False, info\nreturn self.at, reward, terminated, truncated, info",
    ],
)
def test_a_right_result(step: str) -> None:
    assert not codes(step)


END = "\nreturn self.at, {}, {}, self.steps >= 99, {{'is_success': {}}}"
PICKED = "if self.at in self.crates:\n    self.picked += 1\n    reward = {}\n"


@pytest.mark.parametrize(
    "step",
    [
        PICKED.format("-1.0") + END.format("reward", "self.picked >= 3", "self.picked >= 3"),
        PICKED.format("1.0") + END.format("-reward", "self.picked >= 3", "self.picked >= 3"),
        "if self.at == 9:\n    self.won = True\n    reward -= 5.0" + END.format("reward", "self.won", "self.won"),
        "if self.at in self.crates:\n    self.crates.remove(self.at)\n    reward -= 1.0\nwon = not self.crates"
        + END.format("reward", "won", "won"),
        "if self.at < 3:\n    self.lamps[self.at] = True\n    reward = -0.5\nwon = all(self.lamps)"
        + END.format("reward", "won", "won"),
    ],
)
def test_progress_that_costs(step: str) -> None:
    assert codes(step) == {"EC062"}


@pytest.mark.parametrize(
    "step",
    [
        PICKED.format("1.0") + END.format("reward", "self.picked >= 3", "self.picked >= 3"),
        PICKED.format("float(self.hearts)") + END.format("-reward", "self.picked >= 3", "self.picked >= 3"),
        # Each step costs, and time is what brings success.
        "reward -= 0.01" + END.format("reward", "self.steps >= 50", "self.steps >= 50"),
        # What gets away costs, what is caught pays.
        "if self.at in self.crates:\n    self.crates.remove(self.at)\n    reward += 1.0\n"
        "elif self.crates and self.crates[0] < 0:\n    self.crates.pop()\n    reward -= 0.5\nwon = not self.crates"
        + END.format("reward", "won", "won"),
        "if self.at == 9:\n    self.hearts -= 1\n    reward = -1.0"
        + END.format("reward", "self.hearts < 1", "self.won"),
    ],
)
def test_progress_that_pays(step: str) -> None:
    assert "EC062" not in codes(step)


@pytest.mark.parametrize(
    ("prize", "expected"),
    [
        ("12 - 0.2 * self.steps", {"EC062"}),
        ("left = 50 - self.steps\n    reward += 5 + left", {"EC062"}),
        ("max(12 - 0.2 * self.steps, 0.0)", set()),
        ("12 - 0.1 * self.steps", set()),
        ("0.1 * self.steps", set()),
        ("12 - 0.2 * self.steps\n    reward += 10", set()),
        ("12 - 0.2 * self.hearts", set()),
    ],
)
def test_a_prize_that_falls_with_time(prize: str, expected: set[str]) -> None:
    paid = prize if "=" in prize.partition("\n")[0] else f"reward += {prize}"
    step = f"won = self.at == 9\nif won:\n    {paid}" + END.format("reward", "won", "won")
    assert codes(step) & {"EC062"} == expected


def test_a_price_is_a_warning() -> None:
    prize = "won = self.picked >= 3\nif won:\n    reward += 5.0"
    step = PICKED.format("-0.1") + prize + END.format("reward", "won", "won")
    source = GAME.replace("STEP", textwrap.indent(step, " " * 8))
    with subject_of(Target("game.py", source.encode())) as subject:
        [finding] = Lint().judge(subject)
    assert (finding.code, finding.severity) == ("EC062", Severity.WARNING)


@pytest.mark.parametrize(
    ("reward", "success", "warned"),
    [
        ("0.0 if won else reward", "won", True),
        ("0 if bool(won) else float(reward)", "bool(won)", True),
        ("0.0 if self.picked >= 3 else reward", "self.picked >= 3", True),
        # The distance to the goal.
        ("0.0 if won else -1.0", "won", False),
        ("0.0 if won else reward", "self.won", False),
        ("0.0 if not won else reward", "won", False),
        ("reward if won else 0.0", "won", False),
        # Whoever has won plays no more: success is one of the last step.
        ("0.0 if self.won else self._advance()", "self.won", False),
    ],
)
def test_a_step_of_success_that_loses_its_reward(reward: str, success: str, warned: bool) -> None:
    step = PICKED.format("1.0") + "won = self.picked >= 3" + END.format(reward, success, success)
    helper = "    def _advance(self):\n        return 1.0\n"
    text = GAME.replace("STEP", textwrap.indent(step, " " * 8)) + helper
    assert [suspect.certain for suspect in unpaid_successes(Program(ast.parse(text)))] == [False] * warned


@pytest.mark.parametrize(
    ("reward", "costs"),
    [
        ("reward = -(5.0 if won else 0.0)", True),
        ("reward = -float(won)", True),
        ("reward = 0.0\nif won and self.hearts:\n    reward -= 5.0", True),
        ("reward = -4.4 if won else -0.4", True),
        ("reward = 1.0 if self.at else 0.0\nif won:\n    reward -= 2.0", True),
        # A fee that is less than what the last of three pays.
        ("if won:\n    reward -= 0.5", False),
        # Winning costs less than losing.
        ("reward = -0.1 if won else -1.0", False),
        ("reward = 0.0\nif not won and self.hearts < 1:\n    reward = -5.0", False),
        ("reward = 0.0\nif won or self.hearts < 1:\n    reward = -5.0", False),
        ("reward = -1.0 if won else self.hearts", False),
        # What it pays stands in another place.
        ("reward = -float(won)\nif self.picked >= 3:\n    reward += 5.0", False),
        ("reward = -float(won)\nif won:\n    reward += self.hearts", False),
    ],
)
def test_success_that_costs(reward: str, costs: bool) -> None:
    step = (
        PICKED.format("1.0" if reward.startswith("if") else "0.0")
        + f"won = self.picked >= 3\n{reward}"
        + END.format("reward", "won", "won")
    )
    text = GAME.replace("STEP", textwrap.indent(step, " " * 8))
    assert [suspect.certain for suspect in unpaid_successes(Program(ast.parse(text)))] == [True] * costs


@pytest.mark.parametrize(("sign", "expected"), [("-", {"EC062"}), ("", set())])
def test_a_prize_on_top_of_what_the_step_has_earned(sign: str, expected: set[str]) -> None:
    advance = """
    def _advance(self):
        before = self.picked
        if self.at in self.crates:
            self.picked += self.hearts
        gained = 0.5 * (self.picked - before)
        if self.picked >= 3:
            self.won = True
            return gained + 4.0
        return gained
"""
    end = END.format(f"{sign}self._advance()", "self.won", "self.won").lstrip()
    assert found(GAME.replace("STEP", textwrap.indent(end, " " * 8)) + advance.lstrip("\n")) & {"EC062"} == expected


LOSS = "if self.hearts < 1:\n    self.lost = True\n    reward {}= 1.0\n"
GAIN = "reward += 0.1 * max(self.at - self.y, 0)\nif self.at > 70:\n    self.won = True\n    reward {}= 5.0\n"


@pytest.mark.parametrize(
    ("gain", "loss", "sign", "expected"),
    [
        ("+", "-", "-", {"EC062"}),
        ("-", "+", "", {"EC062"}),
        ("+", "-", "", set()),
        ("-", "-", "-", set()),
    ],
)
def test_a_calculated_reward(gain: str, loss: str, sign: str, expected: set[str]) -> None:
    end = END.format(f"{sign}reward", "self.won or self.lost", "self.won")
    assert codes(GAIN.format(gain) + LOSS.format(loss) + end.lstrip()) & {"EC062"} == expected


LAST = "\nreturn self.at, reward, terminated, truncated, self._info()"


@pytest.mark.parametrize(
    ("step", "code"),
    [
        ("if action[1] and self.pills > 1:\n    self.pills -= 1\n    reward = 1.0", "EC059"),
        ("terminated = self.at > 9 and len(self.crates) < 0", "EC059"),
        ("terminated = bool(self.rock[self.y - 1 : self.y + 3, 9:12].any())", "EC059"),
        ("top = self.y - 2\nhit = self.rock[top : self.y + 3]\nterminated = bool(np.any(hit))", "EC059"),
        (
            "for s in self.sparks:\n    s[1] -= 0.7\nself.sparks = [s for s in self.sparks if s[1]]\n"
            "reward = float(len(self.sparks))",
            "EC056",
        ),
    ],
)
def test_what_never_holds(step: str, code: str) -> None:
    assert codes(step + LAST) == {code}


@pytest.mark.parametrize(
    "step",
    [
        "if action[1] and self.pills > 0:\n    self.pills -= 1\n    reward = 1.0",
        "terminated = self.at > 9 and len(self.crates) < 1",
        "terminated = self.at > 9 and len(self.crates) - self.picked < 0",
        "terminated = bool(self.rock[max(self.y - 1, 0) : self.y + 3, 9:12].any())",
        "terminated = self.y > 0 and bool(self.rock[self.y - 1 : self.y + 3, 9:12].any())",
        "terminated = self._is_outside() or bool(self.rock[self.y - 1 : self.y + 3, 9:12].any())",
        "for s in self.sparks:\n    s[1] -= 0.7\nself.sparks = [s for s in self.sparks if s[1] > 0]\n"
        "reward = float(len(self.sparks))",
        "for s in self.sparks:\n    s.height -= 0.3\nself.sparks = [s for s in self.sparks if s.glows]\n"
        "reward = float(len(self.sparks))",
        "for s in self.sparks:\n    s.life -= 0.1\n    if s.life < 0:\n        s.life = 0\n"
        "self.sparks = [s for s in self.sparks if s.life]\nreward = float(len(self.sparks))",
        "for s in self.sparks:\n    s[1] -= 1\nself.sparks = [s for s in self.sparks if s[1]]\n"
        "reward = float(len(self.sparks))",
    ],
)
def test_what_may_hold(step: str) -> None:
    assert not codes(step + LAST)


DRAWING = (
    GAME.replace("STEP", "        return self.at, reward, self.steps > 99, truncated, self._info()")
    + "    def render(self):\n"
)


@pytest.mark.parametrize(
    ("render", "expected"),
    [
        ("self.steps += 1", {"EC063"}),
        ("self._draw()", {"EC063"}),
        ("self.y = self.y - 1 if self.y else 80", {"EC063"}),
        # step() only sets it.
        ("self.shake = self.shake - 1", set()),
        # A new value, which does not depend on how often it is drawn.
        ("self.y = 2 * self.at", set()),
    ],
)
def test_a_picture_that_changes_the_game(render: str, expected: set[str]) -> None:
    helper = "    def _draw(self):\n        self.steps -= 1\n"
    source = DRAWING.replace("reward = 0.0", "reward, self.shake = 0.0, 3") + f"        {render}\n{helper}"
    assert found(source) & {"EC063"} == expected
