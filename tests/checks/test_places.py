"""Where two traces differ: the part of an observation, and the line that writes a key of info."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from envcraft_checks.comparing.places import located, writing_line
from envcraft_checks.linting.program import program_of

import envcraft
from envcraft.judging.differences import part
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Target
from envcraft.model.trace import Divergence, Trace

FOUND = Divergence(2, "observation")
FRAME = np.zeros((8, 8, 3), np.uint8)


def _painted() -> Any:
    frame = FRAME.copy()
    frame[2:5, 3] = 9
    frame[4, 6] = 1, 2, 3
    return frame


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        (FRAME, _painted(), " in rows 2 to 4 and columns 3 to 6, first at [2, 3] ([0, 0, 0], then [9, 9, 9])"),
        (np.array([1.0, 2.0]), np.array([1.0, 3.0]), " at [1] (2.0, then 3.0)"),
        (np.array([np.nan, 2.0, 0]), np.array([np.nan, 3.0, 1]), " in 2 of 3 values, first at [1] (2.0, then 3.0)"),
        (np.array(4), np.array(5), " at [] (4, then 5)"),
        (np.array([0.0]), np.array([-0.0]), ""),
        (3, 4, " (3, then 4)"),
        (np.float32(0.5), np.float32(0.25), " (0.5, then 0.25)"),
        ("left", "right", " (left, then right)"),
        ({"at": 1, "to": 2}, {"at": 1, "to": 3}, " in ['to'] (2, then 3)"),
        ({"at": (1, 2), "to": [3]}, {"at": (1, 5), "to": [4]}, " in 2 parts, first in ['at'][1] (2, then 5)"),
        (
            {"at": 1, "screen": FRAME},
            {"at": 1, "screen": _painted()},
            " in ['screen'] in rows 2 to 4 and columns 3 to 6, first at [2, 3] ([0, 0, 0], then [9, 9, 9])",
        ),
        ((np.array([1, 2]), 7), (np.array([1, 3]), 7), " in [0] at [1] (2, then 3)"),
        ((np.array([1, 2]), 7), (np.array([1]), 7), " in [0]"),
        ({"at": float("nan")}, {"at": float("nan")}, ""),
        ({"at": 1}, {"to": 1}, ""),
        ({"at": None}, {"at": 1}, " in ['at']"),
        (np.int64(3), np.int32(3), " in its type (int64, then int32)"),
        ({"at": np.array([3])}, {"at": np.array([3], np.int32)}, " in ['at'] in its type (int64, then int32)"),
        ({"at": np.int64(3), "to": 1}, {"at": 3, "to": 2}, " in ['to'] (1, then 2)"),
        ({"on": {"at": FRAME, "a": 1}}, {"on": {"at": FRAME, "b": 1}}, " in ['on']"),
    ],
)
def test_the_part_of_an_observation_that_differs(first: Any, second: Any, words: str) -> None:
    assert str(part(FOUND, first, second)) == f"observation differs at step 2{words}"


_TOURIST = """import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Tourist(gym.Env):
    observation_space = spaces.Dict(
        at=spaces.Box(0, 9, (2,), np.int64), seen=spaces.Tuple((spaces.Discrete(3), spaces.Discrete(99)))
    )
    action_space = spaces.Discrete(2)
    visits = 0

    def _look(self):
        return {"at": np.array([self.at, 5]), "seen": (1, Tourist.visits % 99)}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        Tourist.visits += 1
        self.at = int(self.np_random.integers(3))
        return self._look(), {}

    def step(self, action):
        self.at = min(self.at + int(action), 9)
        return self._look(), float(self.at == 9), self.at == 9, False, {}
"""


def test_a_finding_names_the_keys_of_an_observation_that_differ() -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick", "checks": "determinism"}
    report = envcraft.validate(_TOURIST, **options)
    found = [finding for check in report.reports[0].checks for finding in check.findings]
    # The episodes differ for the same reason.
    assert [finding.code for finding in found] == ["EC207"]
    assert " in ['seen'][1] (" in found[0].message
    line = 1 + _TOURIST.splitlines().index("        Tourist.visits += 1")
    assert f"; line {line} assigns Tourist.visits, which all" in found[0].message
    assert found[0].line == line
    assert found[0].evidence["second"] == found[0].evidence["first"] + 1


def test_what_instances_share_is_reported_as_a_leak_where_its_code_is_ignored() -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick", "checks": "determinism"}
    report = envcraft.validate(_TOURIST, ignore="EC207", **options)
    assert [finding.code for check in report.reports[0].checks for finding in check.findings] == ["EC206"]


@pytest.mark.parametrize(
    ("ignored", "severity"), [("EC206, EC207", ""), ("EC206", '[tool.envcraft.severity]\nEC207 = "warning"\n')]
)
def test_a_comment_about_a_leak_is_used_where_the_same_cause_has_another_code(
    ignored: str, severity: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pyproject.toml").write_text(severity)
    Path("tourist.py").write_text(f"# envcraft: ignore-file[{ignored}] all see the visits\n{_TOURIST}")
    # The budget is standard: a smaller one says of no comment that it is unused.
    report = envcraft.validate("tourist.py", contract="gymnasium", sandbox="process", checks="determinism")
    found = [finding.code for check in report.reports[0].checks for finding in check.findings]
    assert (report.outcome, found) == ("pass", ["EC207"] if severity else [])


class Played:
    """A subject whose frames differ at step 2 under a condition, and that affords some steps."""

    def __init__(self, frames: bool, steps: int = 100) -> None:
        self._frames, self._steps = frames, steps

    def affords(self, steps: int) -> bool:
        return steps <= self._steps

    def rerun(self, rollout: Rollout) -> Trace:
        assert (len(rollout.actions), rollout.keep) == (2, 3)
        last = _painted() if rollout.conditions.fresh else FRAME
        digests = [b"a", b"b", last.tobytes()]
        frames = [FRAME, FRAME, last] if self._frames else []
        flags: Any = [False, False]
        return Trace(rollout, digests, [b"{}"] * 3, [0.0, 0.0], [], flags, flags, frames=frames)


@pytest.mark.parametrize(
    ("found", "subject", "place"),
    [
        (FOUND, Played(frames=True), "in rows 2 to 4 and columns 3 to 6, first at [2, 3]"),
        (FOUND, Played(frames=False), ""),
        (FOUND, Played(frames=True, steps=1), ""),
        (Divergence(2, "reward", 0.0, 1.0), Played(frames=True), ""),
        (Divergence(1, "observation"), SimpleNamespace(affords=lambda steps: False), ""),
    ],
)
def test_both_episodes_run_again_for_their_frames(found: Divergence, subject: Any, place: str) -> None:
    assert located(subject, Rollout(0, [[0], [0], [0]]), Conditions(fresh=True), found).where == place


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ("x = 1\ninfo = {'at': 1}\n", 2),
        ("info = {}\ninfo['at'] = 1\nprint(info['at'])\n", 2),
        ("info = dict(\n  at=1)\n", 2),
        ("info = {'at': 1}\ninfo['at'] = 2\n", None),
        ("info = {name: 1}\n", None),
    ],
)
def test_the_only_line_that_writes_a_key_of_info(source: str, line: int | None) -> None:
    subject: Any = SimpleNamespace(target=Target("game.py"), text=source, class_statement=None)
    assert writing_line(subject, Divergence(1, "info", {"at.now": 1}, {"at.now": 2})) == line
    assert writing_line(subject, Divergence(1, "reward", 1.0, 2.0)) is None
    assert writing_line(subject, Divergence(1, "info")) is None


_GAME = "class {0}:\n    def reset(self): {1}\n    def step(self, action):\n        return {{'at': 1}}\n"


@pytest.mark.parametrize(
    ("more", "own"),
    [
        ("self.x = 1", ["Game"]),
        ("self.x = Other()", ["Game", "Other"]),
        ("self.x = WORLD", ["Game", "Other"]),
        ("self.x = make()", ["Game", "Other"]),
    ],
)
def test_a_line_of_another_environment_writes_no_key_of_info(more: str, own: list[str]) -> None:
    made = "WORLD = Other()\ndef make(): return Other()\n"
    source = f"{_GAME.format('Game', more)}{_GAME.format('Other', 'pass')}{made}"
    subject: Any = SimpleNamespace(target=Target("game.py"), text=source, class_statement="Game")
    program = program_of(subject)
    assert program is not None
    assert program.own_classes == own
    line = writing_line(subject, Divergence(1, "info", {"at": 1}, {"at": 2}))
    assert line == (4 if own == ["Game"] else None)
