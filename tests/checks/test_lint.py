"""What the check lint reads from code alone, and when it stays silent."""

from __future__ import annotations

import ast
import contextlib
import time
from pathlib import Path

import pytest
from envcraft_checks.lint import Lint

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import Skip, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named, select_checks
from envcraft.judging.severity import SeverityPolicy
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Finished
from envcraft.model.target import Kind, Target
from envcraft.model.verdict import Severity, SubjectReport, Verdict
from evaluation.fixtures import FIXTURES, fixtures

GAME = """
import functools, math, random, time
import numpy as np
import gymnasium as gym
LIMIT = 5
class Game(gym.Env):
    shared = []
    def __init__(self):
        self.count = 0
        self.canvas = np.zeros(4)
    def reset(self, *, seed=None, options=None):
        {super}
        {reset}
        return self.see(), {{}}
    def step(self, action):
        {step}
        return self.see(), 0.0, {ended}, False, {{}}
    def see(self):
        {see}
    {more}
"""

SHOWN = "return np.full(4, self.x)"
EMPTY = "return self.x == 0"
WON = "return self.see(), 1.0, True, False, {}"
GUST = "def more(self): self.x = self.np_random.random()"


def codes(**parts: str) -> set[str]:
    """The codes that lint reports, also those that are off by default, on a game with these statements."""
    filled = {
        "super": "super().reset(seed=seed)",
        "reset": "pass",
        "step": "pass",
        "ended": "False",
        "see": "return np.zeros(4)",
        "more": "",
        **parts,
    }
    return found(GAME.format(**filled))


def found(source: str) -> set[str]:
    ast.parse(source)
    with subject_of(Target("game.py", source.encode())) as subject:
        return {finding.code for finding in Lint().judge(subject)}


def subject_of(target: Target) -> Subject:
    return Subject(target, ARCADE, WorkerPool(driver_named("process", probe=False)).lease(), BUDGETS["quick"])


@pytest.mark.parametrize(
    ("code", "parts"),
    [
        ("EC050", {"step": "self.x = random.random()", "see": SHOWN}),
        ("EC050", {"step": "self.x = np.random.default_rng().random()", "see": SHOWN}),
        ("EC050", {"reset": "self.x = self.more()", "more": "def more(self): return np.random.rand()", "see": SHOWN}),
        ("EC050", {"step": "self.x = self.action_space.sample()", "see": SHOWN}),
        ("EC050", {"reset": "self.np_random.random()", "super": "super().reset()"}),
        ("EC050", {"super": "super().reset(seed=0)", "step": "self.x = self.np_random.random()"}),
        ("EC050", {"super": "super().reset(seed=LIMIT)", "step": "self.more()", "more": GUST}),
        ("EC051", {"step": "self.x = time.time()", "see": "return np.full(4, self.x)"}),
        ("EC051", {"step": "late = time.monotonic() > 5", "ended": "bool(late)", "see": "return np.zeros(4)"}),
        ("EC052", {"step": "self.x = list({'a', 'b'})[0]"}),
        ("EC052", {"step": "self.x = hash('a') % 7"}),
        ("EC052", {"step": "self.x = {name: self.np_random.random() for name in {'a', 'b'}}"}),
        ("EC053", {"step": "self.shared.append(1)"}),
        ("EC053", {"step": "type(self).seen = 1", "ended": "self.seen > 9", "more": "seen = 0"}),
        (
            "EC053",
            {"reset": "self.x = self.new()", "step": "self.x.append(1)", "more": "def new(self, x=[]): return x"},
        ),
        ("EC053", {"reset": "self.x = getattr(self, 'x', -1) + 1", "ended": "self.x > 9"}),
        ("EC053", {"reset": "self.hurt = False if not hasattr(self, 'hurt') else self.hurt", "ended": "self.hurt"}),
        ("EC053", {"step": "self.count += 1", "ended": "self.count > 9"}),
        ("EC053", {"see": "page = self.canvas[self.count]; self.count = 1 - self.count; return page.copy()"}),
        ("EC053", {"see": "page = self.shared[self.count]; self.count += 1; page[:2] = 1; return page.copy()"}),
        ("EC053", {"step": "self.note()", "more": "def note(self, seen=[]): seen.append(1)"}),
        ("EC053", {"step": "global LIMIT; LIMIT += 1", "ended": "LIMIT > 9"}),
        (
            "EC053",
            {
                "reset": "self.x = 0",
                "step": "self.x += 1; self.f()",
                "more": "@functools.cache\n    def f(self): return self.x",
            },
        ),
        ("EC054", {"see": "self.canvas[:] = 1; return self.canvas"}),
        ("EC054", {"see": "self.canvas[:2, :] = 1; view = self.canvas[:, 1:]; return view"}),
        ("EC054", {"step": "self.x = action[0]; action[0] = 1"}),
        ("EC055", {"step": "open('x', 'w')"}),
        ("EC056", {"reset": "self.x = 0.0", "step": "self.x += 0.1; done = self.x == 1.0", "ended": "done"}),
        ("EC056", {"reset": "self.x = 0.0", "step": "self.x = self.x + 0.1; full = self.x == 1", "ended": "full"}),
        (
            "EC056",
            {
                "reset": "self.x = 1.0",
                "step": "self.x -= 0.1",
                "ended": "self.won()",
                "more": f"def won(self): {EMPTY}",
            },
        ),
        ("EC056", {"reset": "self.x = 0.0", "step": f"self.x += 0.1\n        if self.x == 0.3: {WON}"}),
        ("EC056", {"step": "self.x += 0.3 if action[0] else 0.1", "ended": "self.x == 1.0", "more": "x = 0.0"}),
        ("EC057", {"step": "self.x = 1 / math.hypot(action[0], action[1])"}),
        ("EC058", {"step": "\n        try: self.see()\n        except Exception: pass"}),
        (
            "EC059",
            {"reset": "self.x = 0", "step": "self.x = min(self.x + 1, LIMIT); done = self.x > LIMIT", "ended": "done"},
        ),
        ("EC059", {"reset": "self.won = False", "ended": "self.won"}),
        ("EC059", {"step": "done = action[0] == 1 and False", "ended": "done"}),
    ],
)
def test_each_rule_reads_what_play_may_never_reach(code: str, parts: dict[str, str]) -> None:
    assert codes(**parts) == {code}


@pytest.mark.parametrize(
    "parts",
    [
        {"reset": "self.rng = random.Random(seed)", "step": "self.x = self.rng.random()"},
        {"more": "def unused(self): return random.random()"},
        {"super": "super().reset(seed=0)", "reset": "self.x = self.np_random.random()"},
        {"super": "super().reset(seed=0)", "reset": "self.more()", "step": "self.more()", "more": GUST},
        {"super": "super().reset(seed=0 if seed is None else seed)", "step": "self.x = self.np_random.random()"},
        {"super": "super().reset(seed=0); super().reset(seed=seed)", "step": "self.x = self.np_random.random()"},
        {"super": "super().reset(seed=0)", "step": "self.x = self.np_random.random()", "see": "self.np_random = RNG"},
        {"super": "if options: super().reset(seed=0)", "step": "self.x = self.np_random.random()"},
        {"super": "super().reset(seed=self.count)", "step": "self.x = self.np_random.random()"},
        {"super": "self.x += 1; super().reset(seed=self.x)", "step": "self.np_random.random()", "more": "x = 0"},
        {"step": "if self.render_mode == 'human': self.x = random.random()"},
        {"step": "start = time.time(); print(time.time() - start)"},
        {"step": "self.x = sorted({'a', 'b'})[0] if 'a' in {'a', 'b'} else ''"},
        {"step": "self.x = [cell for cell in {(1, 2), (3, 4)}]"},
        {"reset": "self.shared = []", "step": "self.shared.append(1)"},
        {"reset": "self.count = 0", "step": "self.count += 1", "ended": "self.count > 9"},
        {"step": "self.note()", "more": "def note(self, seen=None): seen = seen or []; seen.append(1)"},
        {"see": "self.canvas[:] = 1; return self.canvas.copy()"},
        {"step": "action = action.copy(); action[0] = 1"},
        {"reset": "self.x = 0.0", "step": "self.x += 0.25", "ended": "self.x == 1.0"},
        {"reset": "self.x = 0.0", "step": "self.x = round(self.x + 0.1, 1)", "ended": "self.x == 1.0"},
        {"reset": "self.x = 0.0", "step": "self.x = min(self.x + 0.1, 1.0)", "ended": "self.x == 1.0"},
        {
            "reset": "self.x = 0.0",
            "step": "self.x += 0.1\n        if self.x > 1: self.x = 1.0",
            "ended": "self.x == 1.0",
        },
        {"reset": "self.x = 0.0", "step": "self.x += 0.1", "ended": "self.x == 1.0 or self.x > 1.0"},
        {"reset": "self.x = self.np_random.random()", "step": "self.x += 0.1", "ended": "self.x == 1.0"},
        {"reset": "self.x = 0.0", "step": "self.x += 0.1; self.y = self.x == 1.0"},
        {"step": "d = math.hypot(action[0], 1.0); self.x = 1 / d if d else 0.0"},
        {"step": "\n        try: self.x = {}['a']\n        except KeyError: pass"},
        {"reset": "self.x = 0", "step": "self.x = min(self.x + 1, LIMIT); done = self.x >= LIMIT", "ended": "done"},
        {"reset": "self.won = False", "step": "self.won = action[0] == 1", "ended": "self.won"},
        {"reset": "self.x = self.action_space.sample(); self.x.fill(0)"},
        {"reset": "self.np_random.random()", "super": "super().reset(seed=0)"},
        {"reset": "self.best = getattr(self, 'best', 0); self.x = 0", "step": "self.best = max(self.best, self.x)"},
        {"reset": "first, *self.x = [1, 2, 3]", "step": "self.x.append(1)", "ended": "len(self.x) > 9"},
        {"see": "page = self.shared[self.count]; self.count = 1 - self.count; page[:] = 1; return page.copy()"},
        {"see": "page = self.shared[self.count]; self.count = 1 - self.count; page.fill(1); return page.copy()"},
    ],
)
def test_what_only_looks_alike_is_not_reported(parts: dict[str, str]) -> None:
    assert codes(**parts) == set()


def ends(terminated: str, truncated: str, success: str, before: str = "") -> set[str]:
    """The codes that lint reports on a game whose step() returns these flags and this success."""
    end = f"return self.see(), 0.0, {terminated}, {truncated}, {{'is_success': {success}}}"
    statements = f"won = self.x > 9; lost = self.x < 0; late = self.x == 5; {before or 'pass'}; {end}"
    return codes(reset="self.x = self.np_random.integers(9)", step=statements)


@pytest.mark.parametrize(
    ("terminated", "truncated", "success", "before"),
    [
        ("won", "late", "False", ""),
        ("(won or lost) and not won", "late and not (won or lost)", "won", ""),
        ("done and not won", "late and not done", "won", "done = bool(won) or lost"),
        ("lost", "late and not won", "won and not lost", ""),
    ],
)
def test_success_that_no_episode_can_end_with(terminated: str, truncated: str, success: str, before: str) -> None:
    assert ends(terminated, truncated, success, before) == {"EC059"}


@pytest.mark.parametrize(
    ("terminated", "truncated", "success", "before"),
    [
        ("won", "late", "won", ""),
        # The episode goes on, and its end may come while success still holds.
        ("lost", "late", "won", ""),
        ("lost", "late", "won and not lost", ""),
        # Survival to the limit.
        ("lost", "late and not lost", "late and not lost", ""),
        # A wrapper truncates.
        ("lost and not won", "False", "won", ""),
        ("False", "False", "won", ""),
        # The text is the same, and the value may not be.
        ("self.x > 9", "late and not won", "won", "self.x += 1"),
        ("lost and not self.more()", "late and lost and not self.more()", "self.more()", ""),
        ("lost", "stop", "won and not lost", "stop = late and not won; won = self.x > 8"),
    ],
)
def test_success_that_an_episode_may_end_with(terminated: str, truncated: str, success: str, before: str) -> None:
    assert ends(terminated, truncated, success, before) == set()


def test_a_game_without_a_notion_of_success_may_deny_it() -> None:
    end = "return self.see(), 0.0, self.x > 9, self.x == 5, {'is_success': False}"
    assert codes(reset="self.x = self.np_random.integers(9)", step=end) == set()


@pytest.mark.parametrize(
    "statements",
    [
        "info = {'is_success': False}; info['is_success'] = won",
        "info = {'is_success': False}; info.update(is_success=won)",
        "info = dict(is_success=False); key = 'is_success'; info[key] = won",
    ],
)
def test_success_that_another_line_reports(statements: str) -> None:
    end = "return self.see(), 0.0, won, self.x == 5, info"
    assert codes(reset="self.x = self.np_random.integers(9)", step=f"won = self.x > 9; {statements}; {end}") == set()


@pytest.mark.parametrize("fixture", [one for one in fixtures() if not one.codes], ids=lambda one: one.path.stem)
def test_no_good_fixture_has_an_error(fixture: object) -> None:
    path: Path = fixture.path  # type: ignore[attr-defined]
    header = path.read_text("utf-8").partition("\n")[0]
    assert all(f"warning {code}" in header for code in found(path.read_text("utf-8")) - {"EC057"})


def judged(path: Path, checks: str | None = None, select: tuple[str, ...] = ()) -> SubjectReport:
    target = Target(str(path), path.read_bytes())
    chosen = select_checks(checks, None, select)
    severity = SeverityPolicy(select=select)
    *_, last = validate(Plan([target], ARCADE, driver_named("process"), chosen, BUDGETS["quick"], severity=severity))
    assert isinstance(last, Finished)
    return last.report.reports[0]


def test_what_play_has_shown_is_not_said_twice() -> None:
    game = FIXTURES / "determinism" / "bad" / "random_module_shuffle.py"
    alone = judged(game, "lint")
    assert [finding.code for check in alone.checks for finding in check.findings] == ["EC050"]
    both = judged(game, "determinism,lint")
    (shown,) = (finding for check in both.checks for finding in check.findings)
    (read,) = (finding for check in alone.checks for finding in check.findings)
    assert (shown.code, shown.line) == ("EC204", read.line)
    assert read.message in shown.message
    assert next(check.verdict for check in both.checks if check.check == "lint") is Verdict.PASS


def test_only_selected_rules_report(tmp_path: Path) -> None:
    path = tmp_path / "game.py"
    source = (FIXTURES / "determinism" / "bad" / "random_module_shuffle.py").read_text("utf-8")
    path.write_text(
        source.replace("def step(self, action):", "def step(self, action):\n        1 / np.linalg.norm(action)")
    )
    reported = {
        select: {finding.code for check in judged(path, "lint", select).checks for finding in check.findings}
        for select in ((), ("EC05",), ("EC057",), ("EC050",))
    }
    assert reported == {(): {"EC050"}, ("EC05",): {"EC050", "EC057"}, ("EC057",): {"EC057"}, ("EC050",): {"EC050"}}
    assert [check.name for check in select_checks(None, None, ("EC2",))] == ["source", "determinism", "sandbox"]
    with pytest.raises(UsageError, match="there is no rule 'EC999'"):
        select_checks(None, None, ("EC999",))


@pytest.mark.parametrize(
    "statements",
    [
        "type(self).a{0} = self.b{0}",
        "self.a{0}.append(self.b{0})",
        "self.a{0} = self.a{1} + random.random()",
        "x{0} = x{1} = self.f{0}(time.time())",
        "done = self.a{0} >= 9; self.a{0} += 1",
        "self.a{0} = {{n for n in self.a{1}}}; list(self.a{0})",
        "if self.a{0} not in self.b: self.b[{0}] = 1 / len(self.a{1})",
    ],
)
def test_no_file_takes_long(statements: str) -> None:
    lines = [statements.format(number, number + 1) for number in range(500)]
    source = GAME.format(super="pass", reset="pass", ended="done", see="pass", more="", step="\n        ".join(lines))
    started = time.process_time()
    with contextlib.suppress(Skip):
        found(source)
    assert time.process_time() - started < 20


def test_large_numbers_and_large_files_are_left_alone() -> None:
    huge = "9" * 400
    assert codes(reset=f"self.x = {huge} * 2", step=f"done = self.x > {huge} * {huge}", ended="done") == set()
    with pytest.raises(Skip, match="nodes"):
        codes(step="x = [" + "1, " * 30_000 + "]")


def test_installed_and_deeply_nested_code_is_skipped() -> None:
    with subject_of(Target("CartPole-v1", kind=Kind.ID)) as subject, pytest.raises(Skip, match="only files"):
        list(Lint().judge(subject))
    deep = "class Game:\n    def reset(self): pass\n    def step(self, action): return " + "+".join("1" * 3000)
    with subject_of(Target("game.py", deep.encode())) as subject, pytest.raises(Skip, match="nested too deeply"):
        list(Lint().judge(subject))


@pytest.mark.parametrize(
    ("added", "severity"), [("0.1", Severity.ERROR), ("0.3 if action[0] else 0.1", Severity.WARNING)]
)
def test_a_sum_that_only_some_orders_miss_is_a_warning(added: str, severity: Severity) -> None:
    source = GAME.format(
        super="super().reset(seed=seed)",
        reset="self.x = 0.0",
        step=f"self.x += {added}",
        ended="self.x == 1.0",
        see="return np.zeros(4)",
        more="",
    )
    with subject_of(Target("game.py", source.encode())) as subject:
        (finding,) = Lint().judge(subject)
    assert finding.severity is severity
    assert "is 0.9999999999999999" in finding.message
    assert ("no other sum is equal" in finding.message) == (severity is Severity.ERROR)


#: A game with three buttons, whose statements the tests below fill in.
BUTTONS = """
import enum, logging
import numpy as np
import gymnasium as gym
LOG = logging.getLogger("game")
MOVES = {{0: (0, 0), 1: (0, 1), {moves}}}
class Key(enum.IntEnum):
    STAY = 0
    JUMP = 7
class Game(gym.Env):
    def __init__(self):
        self.observation_space = gym.spaces.Discrete(9)
        self.action_space = gym.spaces.{space}
        self.total = 0
        self.record = []
        self.grid = np.zeros((9, 9))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.y = self.streak = self.streak_left = 0
        self.hearts = np.uint8(5)
        self.lives = np.full(3, 4, dtype=np.uint8)
        {reset}
        return self.see(), {{}}
    def step(self, action):
        reward = 0.0
        self.y += 1
        {step}
        return self.see(), reward, False, self.y > 99, {info}
    def see(self):
        return self.x % 9
    def _go(self, code, far=1):
        {go}
{more}
"""


def pressed(step: str, **parts: str) -> dict[str, bool]:
    """The codes that lint reports on a game with these statements, and whether each is an error."""
    filled = {
        "space": "MultiDiscrete([5, 2, 2])",
        "moves": "2: (1, 0)",
        "reset": "pass",
        "info": "{}",
        "go": "self.x += code",
        "more": "",
        **parts,
    }
    source = BUTTONS.format(step=step.replace("\n", "\n        "), **filled)
    ast.parse(source)
    with subject_of(Target("game.py", source.encode())) as subject:
        return {finding.code: finding.severity is Severity.ERROR for finding in Lint().judge(subject)}


@pytest.mark.parametrize(
    "parts",
    [
        {"reset": "self.total += 1; LOG.info('episode %d', self.total)"},
        {"reset": "self.total += 1; print('episode', self.total)"},
        {"reset": "self.total += 1; text = f'episode {self.total}'; LOG.debug(text)"},
        {"reset": "self.total += 1", "step": "if self.total % 100 == 0: LOG.info('many')"},
        {"step": "self.total += 1; self.record.append(self.total)"},
        {"step": "self.total += 1\nif self.total % 9 == 0:\n    if self.x: print(self.total)\n    else: pass"},
        {"step": "self.total += 1; count = self.total", "info": "{'count': count}"},
        {"step": "self.total += 1; info = {}; info['count'] = self.total", "info": "info"},
    ],
)
def test_a_counter_that_only_the_log_or_info_tells(parts: dict[str, str]) -> None:
    assert pressed(**{"step": "pass", **parts}) == {}


@pytest.mark.parametrize(
    "parts",
    [
        {"reset": "self.total += 1; LOG.info('episode %d', self.total); self.x = self.total"},
        {"reset": "self.total += 1", "step": "if self.total % 100 == 0: LOG.info('many'); self.x += 1"},
        {"step": "self.total += 1; count = self.total; print(count); reward += count"},
        {"step": "self.record.append(1); print(self.record); self.x = len(self.record)"},
    ],
)
def test_a_counter_that_is_logged_and_used(parts: dict[str, str]) -> None:
    assert pressed(**{"step": "pass", **parts}) == {"EC053": True}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("if action[2] == 2: self.x += 1", {}),
        ("if int(action[1]) in (2, 3): self.x += 1", {}),
        ("move, jump, bomb = action\nif bomb == 2: self.x += 1", {}),
        ("move, *_ = action\njump = int(action[1])\nself.x += (jump == 1) - (2 == jump)", {}),
        ("move, jump, bomb = (int(one) for one in action)\nself.x += bomb == 2", {}),
        ("move, jump, bomb = map(int, action)\nif jump == 2: self.x += 1", {}),
        (
            "action = np.asarray(action).tolist()\nmatch action[0]:\n    case 1: self.x += 1\n    case 5: self.x -= 1",
            {},
        ),
        ("action = int(action)\nif action == 4: self.x += 1", {"space": "Discrete(4)"}),
        ("if action == 0: self.x += 1", {"space": "Discrete(4, start=1)"}),
        ("if action == Key.JUMP: self.x += 1", {"space": "Discrete(4)"}),
        ("self._go(action[1])", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self._go(action[1] if self.x else 0)", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self.x += MOVES[int(action[0])][0]", {"moves": "1: (1, 0)"}),
    ],
)
def test_an_action_that_the_space_does_not_have(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {"EC059": True}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("if action[2] == 1 or action[0] == 4: self.x += 1", {}),
        ("if action[2] == 2: raise ValueError('no such action')", {}),
        ("if not 0 <= action[0] < 5: raise ValueError('no such action')", {}),
        ("assert action[1] < 2", {}),
        ("bomb = action[2]\nif self.x: bomb = 2\nif bomb == 2: self.x += 1", {}),
        ("bomb = int(action[2])\nbomb += 1\nif bomb == 2: self.x += 1", {}),
        ("for bomb in range(3): self.x += bomb == 2 and action[0] == 1", {}),
        ("self.x += sum(action == 2 for action in (1, 2))", {}),
        ("if action == 4: self.x += 1", {"space": "Discrete(len(MOVES) + 2)"}),
        ("if action == 4: self.x += 1", {"space": "Discrete(5)"}),
        ("self._go(action[1]); self._go(2)", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self._go(action[1])", {"go": "self.x += 1 if far == 2 or code == 1 else 0"}),
        ("self.x += 1 if action[1] in (1, 2) else 0", {}),
        ("self.x += MOVES[int(action[0])][0]", {"moves": "1: (0, 1)"}),
        (
            "if action == 4: self.x += 1",
            {"space": "Discrete(4)", "more": "class _More(Game):\n    action_space = gym.spaces.Discrete(5)"},
        ),
    ],
)
def test_an_action_that_the_space_may_have(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {}


@pytest.mark.parametrize(
    "step",
    [
        "if action[0] == 1: self.x += 1\nelif action[0] == 2: self.x -= 1\nelif action[0] == 1: self.y += 1",
        "if self.x > 3: self.x = 0\nelif self.x > 3 and self.y: self.y = 0",
        "if self.x in (1, 2): self.x = 0\nelif self.y: self.y = 1\nelif 2 == self.x: self.x = 9",
        "if self.x == 1 or self.x == 2: self.x = 0\nelse:\n    if self.x == 2: self.y = 0",
        "self.x += -1 if action[0] == 3 else 1 if action[0] == 3 else 0",
        "match int(action[0]):\n    case 1 | 2: self.x += 1\n    case 3: self.x -= 1\n    case 2: self.y = 0",
    ],
)
def test_a_branch_that_never_runs(step: str) -> None:
    assert pressed(step) == {"EC059": True}


@pytest.mark.parametrize(
    "step",
    [
        "if action[0] == 1: self.x += 1\nif action[0] == 1: self.y += 1",
        "if action[0] == 1: self.x += 1\nelif self.x == 1: self.y += 1",
        "if self.np_random.random() < 0.5: self.x += 1\nelif self.np_random.random() < 0.5: self.x -= 1",
        "if self.x > 3: self.x = 0\nelif self.see() and self.x: pass\nelif self.x > 3: self.x = 1",
        "if self.x > 3 and self.y: self.x = 0\nelif self.x > 3: self.x = 1",
        "if self.x == 1: self.x = 0\nelif self.x in (1, 2): self.x = 1",
        "if self.x == 1: self.x = 0\nelif self.x == 1: raise RuntimeError",
        "match int(action[0]):\n    case 1 if self.x: self.x += 1\n    case 1: self.x -= 1",
    ],
)
def test_a_branch_that_may_run(step: str) -> None:
    assert pressed(step) == {}


RESULT = "result = self.see(), reward, False, self.y > 99, {}"


@pytest.mark.parametrize(
    "step",
    [
        f"{RESULT}\nif self.x == 9: reward += 5.0\nreturn result",
        f"{RESULT}\nreward = reward + 5.0\nreturn result",
        f"{RESULT}\nfor _ in range(self.x): reward += 1.0\nreturn result",
        "ended = False\nresult = self.see(), reward, ended, False, {}\nif self.y > 9: ended = True\nreturn result",
    ],
)
def test_a_result_that_changes_too_late(step: str) -> None:
    assert pressed(step) == {"EC059": True}


@pytest.mark.parametrize(
    "step",
    [
        f"if self.x == 9: reward += 5.0\n{RESULT}\nreturn result",
        f"{RESULT}\nif self.x == 9:\n    reward += 5.0\n    {RESULT}\nreturn result",
        f"{RESULT}\nreward += 5.0\nreturn result[0], reward, *result[2:]",
        f"{RESULT}\nif self.x == 9:\n    return result\nreward += 5.0",
        f"{RESULT}\nself.x = 3\nreturn result",
        "info = {}\nresult = self.see(), reward, False, self.y > 99, info\ninfo['x'] = 1; info |= {}\nreturn result",
    ],
)
def test_a_result_that_changes_in_time(step: str) -> None:
    assert pressed(step) == {}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("x = self.x - int(action[1])\ntry: self.x = int(self.grid[x, 0])\nexcept IndexError: self.x = 0", {}),
        ("x = self.x\nx -= 1\ntry: self.y = self.grid[x][0]\nexcept IndexError: self.y = 0", {}),
        ("dx = (-1, 1)[action[1]]\ntry: self.y = self.grid[self.x + dx][0]\nexcept IndexError: self.y = 0", {}),
        (
            "self._go(self.x - 1)",
            {"go": "\n        try: self.x = self.grid[code, 0]\n        except IndexError: return"},
        ),
    ],
)
def test_a_border_that_only_an_exception_guards(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {"EC058": False}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("x = self.x - 1\ntry: self.x = -9 if x < 0 else self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("x = max(self.x - 1, 0)\ntry: self.x = self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("x = (self.x - 1) % 9\ntry: self.x = self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("try: self.x = self.grid[self.x + 1, 0]\nexcept IndexError: self.x = 0", {}),
        ("try: self.x = self.record[int(action[0])]\nexcept IndexError: self.x = 0", {}),
        ("x = self.x - 1\ntry: self.x = {1: 2}[x]\nexcept KeyError: self.x = 0", {}),
    ],
)
def test_a_border_that_is_tested(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("self.streak += 1\nreward += 0.1 * 2 ** (self.streak // 3)", {}),
        ("self.streak += 1\nbonus = 1.5**self.streak\nreward = bonus if action[1] else 0.0", {}),
        ("self.streak += 1\nreward += self._go(1)", {"go": "return 1 << self.streak"}),
        ("self.streak += 1\nreward += np.power(2.0, self.streak)", {}),
    ],
)
def test_a_reward_that_doubles_without_end(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {"EC057": False}


@pytest.mark.parametrize(
    "step",
    [
        "self.streak += 1\nreward += min(2**self.streak, 8)",
        "self.streak = min(self.streak + 1, 5)\nreward += 2**self.streak",
        "self.streak += 1\nif self.streak > 4: self.streak = 0\nreward += 2**self.streak",
        "self.streak += 1\nreward += 2**self.streak\nreward = float(np.clip(reward, -1, 1))",
        "self.streak += 1\nreward += 0.9**self.streak",
        "self.streak += 1\nreward += 2 ** (3 - self.streak)",
        "self.streak += 1\nself.x = 2**self.streak\nreward += self.see()",
        "self.streak += 1\nreward += 2 ** min(self.streak, 4)",
    ],
)
def test_a_reward_with_a_limit(step: str) -> None:
    assert pressed(step) == {}


@pytest.mark.parametrize(
    ("step", "certain"),
    [
        ("self.hearts -= 2\nif self.hearts < 0: self.x = 9", True),
        ("self.hearts -= np.uint8(1)\nreward -= self.hearts < 0", True),
        ("self.hearts -= np.uint8(2 if action[1] else 1)\nif self.hearts == 0: self.x = 9", False),
        ("self.lives[0] -= 3\nself.x = int(self.lives[0] <= 0)", False),
    ],
)
def test_an_unsigned_number_that_wraps(step: str, certain: bool) -> None:
    assert pressed(step) == {"EC059": certain}


@pytest.mark.parametrize(
    "step",
    [
        "self.hearts -= 1\nif self.hearts == 0: self.x = 9",
        "if self.hearts > 1: self.hearts -= 2\nif self.hearts == 0: self.x = 9",
        "self.hearts -= min(self.hearts, 2)\nif self.hearts == 0: self.x = 9",
        "self.hearts = np.uint8(max(0, int(self.hearts) - 2))\nif self.hearts == 0: self.x = 9",
        "self.hearts = int(self.hearts) - 2\nif self.hearts < 0: self.x = 9",
        "self.x -= 2\nif self.x < 0: self.x = 0",
    ],
)
def test_a_number_that_does_not_wrap(step: str) -> None:
    assert pressed(step) == {}
