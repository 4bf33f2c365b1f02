"""Growth over many episodes is told from noise and from what levels off, and a leak is shown with few episodes."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest
from envcraft_checks.linting.effects import effect_lines
from envcraft_checks.linting.program import Program
from envcraft_checks.resources import _slower, steady

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.probes import Probes
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.events import SubjectFinished
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target, parse
from envcraft.model.trace import Trace
from envcraft.model.verdict import Finding
from envcraft.spaces.spec import read_space
from evaluation.fixtures import FIXTURES

GAME = (Path(__file__).resolve().parents[2] / "examples" / "sokoban.py").read_text()
STEP = "        self.steps += 1\n"
RESET = "        super().reset(seed=seed)\n"


def found(name: str, *, step: str = "pass", reset: str = "pass", budget: str = "quick") -> list[Finding]:
    """The findings of one check on a game with an additional statement in step() and one in reset()."""
    source = GAME.replace(STEP, f"        {step}\n{STEP}", 1).replace(RESET, f"{RESET}        {reset}\n", 1)
    checks = [check for check in default_checks() if check.name in ("source", name)]
    plan = Plan([Target("game.py", source.encode())], ARCADE, driver_named("process"), checks, BUDGETS[budget])
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    (own,) = [check for check in report.checks if check.check == name]
    assert not own.reason
    return own.findings


def test_only_steady_growth_counts() -> None:
    assert steady([10.0 * number for number in range(24)]) == 10
    assert steady([0.0, 5.0, 9.0] + [3.0 * number for number in range(21)]) == 3
    assert steady([7.0] * 24) == 0
    assert steady([min(number, 12) * 10.0 for number in range(24)]) == 0
    assert steady([-1.0 * number for number in range(24)]) == 0
    assert steady([1e6 * (number > 20) for number in range(24)]) == 0
    assert steady([number % 2 * 100.0 for number in range(24)]) == 0
    assert steady([1.0 * number for number in range(8)]) == 0


def test_slower_calls_are_told_from_noise() -> None:
    assert _slower([100.0 + 20 * number for number in range(64)])
    assert not _slower([100.0 + number for number in range(64)])
    assert not _slower([100.0 + 5_000 * (number > 60) for number in range(64)])
    assert not _slower([1.0 + number for number in range(64)])
    assert not _slower([100.0 + 5_000 * (number % 9 == 0) for number in range(64)])
    assert not _slower([100.0 + 50 * number for number in range(16)])


def test_slower_calls_are_told_from_a_machine_that_becomes_busy() -> None:
    draw = random.Random(0)
    for _ in range(200):
        # Every fourth call takes up to five times as long, because other programs have the processor.
        busy = [draw.uniform(1, 5) if draw.random() < 0.25 else draw.uniform(1, 1.3) for _ in range(72)]
        assert _slower([(1_000 + 300 * number) * busy[number] for number in range(72)])
        for start in (18, 36, 54):
            assert not _slower([1_000 * busy[number] * (1 + 4 * (number >= start)) for number in range(72)])


LEAKS = [
    ("EC910", {"reset": "self.kept = getattr(self, 'kept', []) + [bytearray(100_000)]"}),
    ("EC910", {"step": "globals().setdefault('seen', []).append({'step': self.steps, 'keys': [1] * 200})"}),
    ("EC911", {"reset": "self.kept = getattr(self, 'kept', []) + [open('log', 'w')]"}),
    ("EC912", {"reset": "open(f'{len(__import__(\"os\").listdir())}.txt', 'w').close()"}),
    ("EC913", {"reset": "self.kept = getattr(self, 'kept', []) + [0]", "step": "[int(one) for one in self.kept]"}),
    ("EC913", {"reset": "self.n = getattr(self, 'n', 0) + 1; sum(range(self.n * 20_000))"}),
]


@pytest.mark.parametrize(("code", "statements"), LEAKS)
def test_leaks_are_reported(code: str, statements: dict[str, str]) -> None:
    assert [finding.code for finding in found("resources", **statements)] == [code]


#: A queue that is not full by the end of a session.
QUEUE = "__import__('collections').deque([], 500)"
HARMLESS = [
    {"reset": "self.kept = (getattr(self, 'kept', []) + [bytearray(100_000)])[-9:]"},
    {"step": "self.kept = (getattr(self, 'kept', []) + [(self.steps, 0.5)])[-900:]", "reset": "self.kept = []"},
    {"reset": f"self.kept = getattr(self, 'kept', {QUEUE}); self.kept.append([9] * 99)"},
    {"reset": "self.kept = getattr(self, 'kept', {}); self.kept.setdefault(seed, bytearray(100_000))"},
    {"step": "self.kept = (getattr(self, 'kept', []) + [(self.steps, 0.5)])[-150:]"},
    {"reset": "open('log', 'w').write(str(seed))"},
    {"reset": "self.scores = getattr(self, 'scores', []) + [0.5]"},
]


@pytest.mark.parametrize("statements", HARMLESS)
def test_what_does_not_grow_passes(statements: dict[str, str]) -> None:
    assert found("resources", **statements) == []


COUNT = "self.n = getattr(self, 'n', 0) + 1"


@pytest.mark.parametrize("episodes", [12, 40])
def test_a_leak_through_many_resets_is_reported_with_as_many(episodes: int) -> None:
    (finding,) = found("determinism", reset=f"{COUNT}; self.np_random.random(int(self.n > {episodes}))")
    assert finding.code == "EC206"
    before = finding.repro.conditions["before"]
    assert len(before) == episodes
    assert not any(episode["actions"] for episode in before)


def test_a_leak_through_steps_is_reported_with_few_episodes() -> None:
    (finding,) = found("determinism", step=COUNT, reset="self.np_random.random(int(getattr(self, 'n', 0) > 50))")
    assert finding.code == "EC206"
    assert sum(len(episode["actions"]) for episode in finding.repro.conditions["before"]) < 120


@pytest.mark.parametrize(("budget", "wins", "longer"), [("quick", 3, 2), ("standard", 10, 4), ("thorough", 20, 13)])
def test_short_wins_are_played_several_times_before(budget: str, wins: int, longer: int) -> None:
    probes = Probes(ARCADE, BUDGETS[budget], 0, read_space(ARCADE.action))
    for steps, times in ((10, wins), (60, longer), (4 * BUDGETS[budget].earlier + 1, 0)):
        win = Trace(Rollout(7, [[4, 0, 0]] * steps), rewards=[1.0] * steps, infos=[b'{"is_success": true}'])
        before = probes.earlier(probes.random(0).cut(9), win, None)
        assert sum(episode.seed == 7 for episode in before) == times
        # What every second reset undoes shows after an odd number.
        assert len(before) % 2 == 1


@pytest.mark.parametrize("where", ["reset", "step"])
def test_what_fails_on_one_seed_is_shown_on_that_seed_alone(where: str) -> None:
    statement = {where: "assert self.seeded != 31", "reset": "self.seeded = seed"}
    if where == "reset":
        statement["reset"] = "assert seed != 31"
    (finding,) = found("api", **statement)
    assert finding.code == {"reset": "EC104", "step": "EC107"}[where]
    assert finding.repro.seed == 31
    assert len(finding.repro.actions) == (where == "step")
    assert not finding.repro.conditions


@pytest.mark.parametrize(
    ("game", "code", "words"),
    [
        ("steps_in_a_log", "EC912", r"95 more episodes of 4 steps write [\d.]+ KiB of data"),
        ("record_of_each_game", "EC912", r"71 more episodes of 0 steps write 71 more files and [\d.]+ KiB of data"),
        ("log_left_open", "EC911", r"open files grow with each episode: from \d+ to \d+ in 72 episodes"),
    ],
)
def test_files_that_grow_are_reported_once_where_they_are_opened(game: str, code: str, words: str) -> None:
    text = (FIXTURES / "resources" / "bad" / f"{game}.py").read_text("utf-8")
    checks = [check for check in default_checks() if check.name in ("source", "resources", "lint")]
    plan = Plan([Target("game.py", text.encode())], ARCADE, driver_named("process"), checks, BUDGETS["quick"])
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    (finding,) = [finding for check in report.checks for finding in check.findings]
    assert finding.code == code
    assert finding.line is not None
    assert " open(" in text.splitlines()[finding.line - 1]
    assert re.fullmatch(words, finding.message)


@pytest.mark.parametrize(
    ("reset", "step", "lines"),
    [
        ("pass", "open('levels.txt').read(); open('log', mode='a')", [6]),
        ("self.log = open('log', 'a')", "self.log.write('a')", [4]),
        ("pass", "open('levels.txt', 'rb').read()", []),
        ("pass", "threading.Thread(target=print).start(); open('log', self.mode)", [6]),
        ("pass", "np.save('state.npy', 0)\n  open('log', 'a')", [6, 7]),
    ],
)
def test_lines_that_may_write_files(reset: str, step: str, lines: list[int]) -> None:
    text = f"""import threading; import numpy as np; from gymnasium import Env
class Game(Env):
 def reset(self, *, seed=None, options=None):
  {reset}
 def step(self, action):
  {step}
"""
    assert effect_lines(Program(parse(text), "Game"), "step", files=True) == lines
