"""A finding about the reward names the line that causes it, in games whose line is known, and else that of step()."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path
from typing import Any

import pytest
from envcraft_checks.linting.program import Program
from envcraft_checks.reward import Reward, _kind
from envcraft_checks.rewards.blame import Blame, Call, blamed_line
from envcraft_checks.rewards.lines import RewardLines

import envcraft
from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Repro, Severity

_GAME = """
import math
import gymnasium as gym
import numpy as np
from gymnasium import spaces

LOSS = -1000.0
{top}

class Base(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])
    PRIZE = 500.0

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.lane, self.gate, self.reward = 0, 5, 9, 0.0
        self.hits, self.shots, self.total = np.float64(0), np.float64(0), 0.0
        return self.render(), {{"is_success": False}}

    def _move(self, action):
        self.time += 1
        self.lane = max(self.lane + (0, 0, 0, -1, 1)[int(action[0])], 0)
        self.shots += int(action[1])
        self.dead, self.won = self.lane == 3, self.lane >= self.gate

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[:, min(self.gate, 83)] = 90
        frame[70:80, min(self.lane, 83)] = 255
        frame[0, self.time % 84] = 60
        return frame
{base}

class Lane(Base):
{methods}
    def step(self, action):
        self._move(action)
{step}
"""
_END = "return self.render(), {}, self.won or self.dead, self.time >= 100, {{'is_success': self.won}}\n"
_LEFT, _RIGHT, _STAY, _SHOOT = [3, 0, 0], [4, 0, 0], [0, 0, 0], [0, 1, 0]
#: Ordinary calls come first, then the lane leads to the loss at 3, or to the gate at 9.
_LOSES = [_STAY, _RIGHT, _LEFT, _LEFT, _LEFT]
_WINS = [_STAY, _LEFT, *[_RIGHT] * 5]


def _game(step: str, reward: str = "reward", methods: str = "", base: str = "", top: str = "") -> str:
    def inside(text: str, spaces: int) -> str:
        return textwrap.indent(textwrap.dedent(text), " " * spaces)

    step = inside(step, 8) + "\n" + inside(_END.format(reward) if reward else "", 8)
    return _GAME.format(top=textwrap.dedent(top), base=inside(base, 4), methods=inside(methods, 4), step=step)


class _Workers:
    """One process for all games."""

    def __init__(self) -> None:
        self._pool = WorkerPool(driver_named("process", probe=False))

    def found(self, source: str, actions: list[Any]) -> tuple[Finding, int | None]:
        """The first finding of an episode, and the line that is blamed for it."""
        with self._subject(source) as subject:
            trace = subject.rollout(Rollout(0, actions))
            finding = next(Reward().find(subject, trace))
            steps = subject.steps
            line = blamed_line(subject, finding, bounded=False)
            assert subject.steps <= steps + len(actions)
            return finding, line

    def blamed(self, source: str, actions: list[Any], code: str, **evidence: Any) -> int | None:
        """The line that is blamed for a finding that more than one episode shows."""
        finding = Finding(code, Severity.ERROR, "", None, evidence, Repro(0, actions))
        with self._subject(source) as subject:
            return blamed_line(subject, finding, bounded=False)

    def _subject(self, source: str) -> Subject:
        target = Target("game.py", source.encode(), env_class="Lane")
        return Subject(target, ARCADE, self._pool.lease(), BUDGETS["quick"])


@pytest.fixture(scope="module")
def workers() -> _Workers:
    return _Workers()


CASES: dict[str, tuple[str, list[Any], str]] = {
    "one of several branches": (
        "EC303",
        _LOSES,
        _game("""
        reward = -0.01
        if self.won:
            reward = 10.0
        elif self.dead:
            reward = -1000.0  # here
        """),
    ),
    "one of several augmented assignments": (
        "EC303",
        _WINS,
        _game("""
        reward = -0.01
        reward += 0.1 * self.lane
        if self.won:
            reward += 1.0
            reward += 50.0 * self.lane  # here
        """),
    ),
    "the constant that is too large": (
        "EC303",
        [_STAY],
        _game("""
        reward = -0.01
        reward -= 0.5 * self.lane
        reward += self.PRIZE  # here
        """),
    ),
    "a choice of constants that is too small to matter": (
        "EC303",
        [_STAY],
        _game("""
        reward = 0.5 if self.lane > 4 else -0.5
        reward += 100.0 * self.lane  # here
        reward -= 0.1 if self.dead else 0.0
        """),
    ),
    "an assignment that adds to the value": (
        "EC303",
        _LOSES,
        _game("""
        reward = 0.1
        if self.dead:
            reward = reward + LOSS  # here
        """),
    ),
    "a helper method": (
        "EC303",
        _LOSES,
        _game(
            "reward = self._score()",
            methods="""
            def _score(self):
                if self.dead:
                    return -1000.0  # here
                if self.won:
                    return 5.0
                return -0.01
            """,
        ),
    ),
    "a helper method in a sum": (
        "EC303",
        _LOSES,
        _game(
            "reward = self._pace() + self._danger() - 0.01",
            methods="""
            def _pace(self):
                return 0.01 * self.lane

            def _danger(self):
                if self.dead:
                    return LOSS  # here
                return 0.0
            """,
        ),
    ),
    "an argument of a helper that returns everything": (
        "EC303",
        _LOSES,
        _game(
            """
            if self.dead:
                return self._result(-1000.0, True)  # here
            return self._result(0.1 * self.lane, self.won)
            """,
            reward="",
            methods="""
            def _result(self, reward, over):
                return self.render(), float(reward), over, self.time >= 100, {}
            """,
        ),
    ),
    "an attribute": (
        "EC303",
        _LOSES,
        _game(
            """
            self.reward = -0.01
            if self.won:
                self.reward += 3.0
            self._collide()
            """,
            reward="self.reward",
            methods="""
            def _collide(self):
                if self.dead:
                    self.reward -= 1000.0  # here
            """,
        ),
    ),
    "a class of the file that is inherited": (
        "EC303",
        _LOSES,
        _game(
            """
            frame, reward, over, late, info = self._turn(action)
            return frame, reward - 0.01, over, late, info
            """,
            reward="",
            base="""
            def _turn(self, action):
                reward = 0.1 * self.lane
                if self.dead:
                    reward = -1000.0  # here
                return self.render(), reward, self.won or self.dead, self.time >= 100, {}
            """,
        ),
    ),
    "a limit around the value": (
        "EC303",
        _LOSES,
        _game(
            """
            reward = 0.1 * self.lane
            if self.dead:
                reward -= 1000.0  # here
            """,
            reward="float(np.clip(reward, -2000, 2000))",
        ),
    ),
    "a dictionary of rewards": (
        "EC303",
        _LOSES,
        _game(
            """
            parts = {"time": -0.01, "lane": 0.1 * self.lane, "loss": 0.0}
            if self.dead:
                parts["loss"] = -1000.0  # here
            if self.won:
                parts["win"] = 10.0
            """,
            reward="sum(parts.values())",
        ),
    ),
    "a table of rewards": (
        "EC303",
        _LOSES,
        _game(
            """
            event = "loss" if self.dead else "none"
            reward = REWARDS[event]  # here
            """,
            top='REWARDS = {"loss": -1000.0, "none": 0.0}',
        ),
    ),
    "a factor at the end": (
        "EC303",
        _LOSES,
        _game("""
        reward = 0.1 * self.lane
        if self.dead:
            reward *= -5000.0  # here
        """),
    ),
    "a division in a helper": (
        "EC301",
        [_STAY],
        _game(
            "reward = 0.1 + 2.0 * self._accuracy() - 0.01 * self.time / 100.0",
            methods="""
            def _accuracy(self):
                share = self.hits / self.shots  # here
                return share
            """,
        ),
    ),
    "a division among other terms": (
        "EC301",
        [_SHOOT, _STAY, _SHOOT],
        _game("""
        reward = 0.1 * self.lane
        reward += self.hits / (self.shots - 2.0)  # here
        reward -= 0.01 * self.time / 100.0
        """),
    ),
    "a logarithm before the reward": (
        "EC301",
        _WINS,
        _game("""
        distance = np.float64(self.gate - self.lane)
        closeness = -np.log(distance)  # here
        reward = 0.1 * closeness
        """),
    ),
    "a division that is guarded, and one that is not": (
        "EC301",
        [_STAY],
        _game("""
        pace = self.lane / max(self.time, 1)
        share = self.hits / self.shots  # here
        aim = self.hits / self.shots if self.shots else 0.0
        reward = pace + share + aim
        """),
    ),
    "a method that returns nothing": (
        "EC302",
        _LOSES,
        _game(
            "reward = self._score()",
            methods="""
            def _score(self):
                if self.dead:
                    return None  # here
                return 1.0
            """,
        ),
    ),
    "a text": (
        "EC302",
        _LOSES,
        _game("""
        reward = 0.1 * self.lane
        if self.dead:
            reward = f"{reward:.1f}"  # here
        """),
    ),
}


@pytest.mark.parametrize(("code", "actions", "source"), CASES.values(), ids=CASES)
def test_the_line_that_causes_a_finding(code: str, actions: list[Any], source: str, workers: _Workers) -> None:
    finding, line = workers.found(source, actions)
    assert finding.code == code
    assert line is not None
    assert source.splitlines()[line - 1].endswith("# here"), source.splitlines()[line - 1]


UNKNOWN: dict[str, tuple[str, list[Any], str]] = {
    "two terms that always run": (
        "EC303",
        [_STAY],
        _game("""
        reward = 100.0 * self.lane
        reward += 70.0 * self.time
        """),
    ),
    "a sum of two choices": (
        "EC303",
        [_STAY],
        _game("""
        reward = 60.0 if self.lane > 4 else -60.0
        reward += 60.0 if self.time else -60.0
        """),
    ),
    "two lines of the same call that are new": (
        "EC303",
        _LOSES,
        _game("""
        reward = -0.01
        if self.dead:
            reward -= 100.0 * self.lane
            reward -= 70.0 * self.time
        """),
    ),
    "a condition on the line of the statement": (
        "EC303",
        _LOSES,
        _game("""
        reward = 0.1 * self.lane
        if self.time > 0: reward += 0.2 * self.time
        if self.dead: reward -= 300.0 * self.lane
        """),
    ),
    "two divisions": (
        "EC301",
        [_STAY],
        _game("""
        aim = self.hits / self.shots
        pace = self.lane / self.shots
        reward = 0.0
        reward += aim
        reward += pace
        """),
    ),
    "a value from a loop": (
        "EC303",
        _LOSES,
        _game("""
        for reward in (1.0, 2.0, -1000.0 if self.dead else 0.0):
            pass
        """),
    ),
    "the result of a library": (
        "EC303",
        _LOSES,
        _game("return (lambda: (self.render(), -1000.0, True, False, {}))()", reward=""),
    ),
}


@pytest.mark.parametrize(("code", "actions", "source"), UNKNOWN.values(), ids=UNKNOWN)
def test_no_line_where_several_may_cause_a_finding(
    code: str, actions: list[Any], source: str, workers: _Workers
) -> None:
    finding, line = workers.found(source, actions)
    assert finding.code == code
    assert line is None
    assert source.splitlines()[(finding.line or 0) - 1].strip() == "def step(self, action):"


JUDGED: dict[str, tuple[str, dict[str, Any], list[Any], str]] = {
    "a wage that rises": (
        "EC304",
        {},
        [*[_RIGHT, _LEFT] * 20, *[_SHOOT] * 20],
        _game("""
        reward = 0.05 * self.time  # here
        reward -= 0.01
        if self.shots:
            reward += 0.2
        if self.time == 7:
            reward += 0.5 * self.lane
        """),
    ),
    "a sum of all steps": (
        "EC304",
        {},
        [_STAY] * 40,
        _game("self.reward += 1.0  # here", reward="self.reward"),
    ),
    "a win of zero": (
        "EC305",
        {},
        _WINS,
        _game("""
        reward = -0.01
        if self.won:
            reward = 0.0  # here
        """),
    ),
    "a reward that is always zero": (
        "EC306",
        {"certain": True},
        [_STAY],
        _game("""
        reward = 0.0  # here
        score = 5.0
        """),
    ),
    "a reward that no play reaches": (
        "EC306",
        {"certain": False},
        [_STAY],
        _game("""
        reward = 0.0
        if self.lane > 1000:
            reward = 1.0  # here
        """),
    ),
    "a step that pays on the way and not on the way back": (
        "EC307",
        {"loop": [_RIGHT, _LEFT]},
        [_RIGHT, _LEFT] * 6,
        _game("""
        reward = -0.01
        if self.lane == 6:
            reward += 0.5  # here
        if self.won:
            reward += 2.0
        """),
    ),
    "waiting that pays": (
        "EC308",
        {},
        [*[_RIGHT, _LEFT] * 2, *[_STAY] * 30],
        _game("""
        reward = 0.01 * self.lane / 10.0
        if int(action[0]) == 0:
            reward += 1.0  # here
        if self.won:
            reward += 5.0
        """),
    ),
    "a loss that pays": (
        "EC308",
        {},
        _LOSES,
        _game("""
        reward = -0.01
        if self.won:
            reward = 1.0
        if self.dead:
            reward = 20.0  # here
        """),
    ),
}


@pytest.mark.parametrize(("code", "evidence", "actions", "source"), JUDGED.values(), ids=JUDGED)
def test_the_line_that_causes_a_finding_of_several_episodes(
    code: str, evidence: dict[str, Any], actions: list[Any], source: str, workers: _Workers
) -> None:
    line = workers.blamed(source, actions, code, **evidence)
    assert line is not None
    assert source.splitlines()[line - 1].endswith("# here"), source.splitlines()[line - 1]


UNDECIDED: dict[str, tuple[str, dict[str, Any], list[Any], str]] = {
    "two wages that rise": (
        "EC304",
        {},
        [_STAY] * 40,
        _game("""
        reward = 0.05 * self.time
        reward -= 0.01 * self.time * self.lane
        """),
    ),
    "a win that no line mentions": (
        "EC305",
        {},
        _WINS,
        _game("""
        reward = -0.01
        reward -= 0.02 * self.lane
        """),
    ),
    "two lines that write a zero": (
        "EC306",
        {"certain": True},
        [_STAY],
        _game("""
        reward = 0.0
        if self.dead:
            reward = 0 * 5.0
        """),
    ),
    "two lines that pay alike": (
        "EC308",
        {},
        [_STAY] * 20,
        _game("""
        reward = 0.5
        reward += 0.4
        """),
    ),
}


@pytest.mark.parametrize(("code", "evidence", "actions", "source"), UNDECIDED.values(), ids=UNDECIDED)
def test_no_line_where_several_episodes_do_not_tell(
    code: str, evidence: dict[str, Any], actions: list[Any], source: str, workers: _Workers
) -> None:
    assert workers.blamed(source, actions, code, **evidence) is None


def test_calls_whose_lines_end_too_early_tell_nothing() -> None:
    """The worker notes the first lines of a long call only."""
    source = CASES["one of several branches"][2]
    end = next(number for number, text in enumerate(source.splitlines(), 1) if text.endswith("# here"))
    finding = Finding("EC303", Severity.ERROR, "", None, {"reward": -1000.0}, Repro(0, [_STAY]))
    lines = RewardLines(Program(ast.parse(source), "Lane"))
    blame = Blame(lines, finding, (-100.0, 100.0), [Call(frozenset({end}), -1000.0)])
    assert blame.line() is None


def test_a_validation_names_the_line(tmp_path: Path) -> None:
    source = CASES["one of several augmented assignments"][2]
    file = tmp_path / "lane.py"
    file.write_text(source)
    report = envcraft.validate(file, sandbox="process", budget="quick", checks="reward", env_class="Lane")
    [found] = [finding for check in report.reports[0].checks for finding in check.findings if finding.code == "EC303"]
    assert source.splitlines()[(found.line or 0) - 1].endswith("# here")


def test_a_reward_of_two_zeros_has_the_line_of_step(tmp_path: Path) -> None:
    body = "reward = BONUS * self.lane\nif self.dead:\n    reward -= PENALTY\n"
    file = tmp_path / "lane.py"
    file.write_text(_game(body, top="BONUS = 0.0\nPENALTY = 0.0"))
    report = envcraft.validate(file, sandbox="process", budget="quick", checks="reward", env_class="Lane")
    [found] = [finding for check in report.reports[0].checks for finding in check.findings if finding.code == "EC306"]
    assert file.read_text().splitlines()[(found.line or 0) - 1].strip() == "def step(self, action):"


@pytest.mark.parametrize(
    ("kind", "words"), [("str", "a str"), ("None", "None"), ("another type", "of another type"), ("int", "an int")]
)
def test_the_kind_of_a_reward_is_written_with_its_article(kind: str, words: str) -> None:
    assert _kind(kind) == words


@pytest.mark.parametrize(
    ("reward", "words"),
    [("[1.0]", "a list"), ("(1.0, 0)", "a tuple"), ("{}", "a dict"), ("object()", "of another type")],
)
def test_a_reward_in_a_container_is_named_by_its_type(reward: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "lane.py"
    file.write_text(_game(f"reward = {reward}"))
    report = envcraft.validate(file, sandbox="process", budget="quick", checks="reward", env_class="Lane")
    [found] = [finding for check in report.reports[0].checks for finding in check.findings if finding.code == "EC302"]
    assert f" is {words}, not a number " in found.message
