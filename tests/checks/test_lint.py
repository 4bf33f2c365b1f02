"""What the check lint reads from code alone, and when it stays silent."""

from __future__ import annotations

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
from envcraft.model.events import Finished
from envcraft.model.target import Kind, Target
from envcraft.model.verdict import SubjectReport, Verdict
from evaluation.fixtures import FIXTURES
from tests.checks.lint_games import GAME, codes, found, pressed, subject_of

SHOWN = "return np.full(4, self.x)"
EMPTY = "return self.x == 0"
WON = "return self.see(), 1.0, True, False, {}"
GUST = "def more(self): self.x = self.np_random.random()"


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
        (
            "EC052",
            {"step": "self.x = []\n        for row, name in enumerate({'a', 'b'}):\n            self.x.append(name)"},
        ),
        ("EC052", {"step": "self.x = dict(zip({'a', 'b'}, (1, 2)))['a']"}),
        (
            "EC052",
            {"step": "self.x = {}\n        for name, row in zip({'a', 'b'}, (1, 2)):\n            self.x[name] = row"},
        ),
        (
            "EC052",
            {"step": "self.x = {}\n        for row, name in enumerate({'a', 'b'}):\n            self.x[name] = row"},
        ),
        (
            "EC052",
            {"step": "self.x, rows = {}, [1, 2]\n        for one in {'a', 'b'}:\n            self.x[one] = rows.pop()"},
        ),
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
        (
            "EC053",
            {"see": "page = self.shared[self.count]; self.count = self.count + 1; page[:2] = 1; return page.copy()"},
        ),
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
        {"super": "super().reset(seed=0)", "step": "self.x = self.np_random.random()", "see": "self.np_random = LIMIT"},
        {"super": "if options: super().reset(seed=0)", "step": "self.x = self.np_random.random()"},
        {"super": "super().reset(seed=self.count)", "step": "self.x = self.np_random.random()"},
        {"super": "self.x += 1; super().reset(seed=self.x)", "step": "self.np_random.random()", "more": "x = 0"},
        {"step": "if self.render_mode == 'human': self.x = random.random()"},
        {"step": "start = time.time(); print(time.time() - start)"},
        {"step": "self.x = sorted({'a', 'b'})[0] if 'a' in {'a', 'b'} else ''"},
        {"step": "self.x = [cell for cell in {(1, 2), (3, 4)}]"},
        # Only the number of its items matters.
        {"step": "self.x = []\n        for row, _ in enumerate({'a', 'b'}):\n            self.x.append(row)"},
        {"step": "self.x = [(row, self.np_random.random()) for row, _ in enumerate({'a', 'b'})]"},
        {"step": "self.x = {}\n        for row, name in enumerate({'a', 'b'}):\n            self.x[name] = 1"},
        {"step": "self.x = {'a': 1}\n        for name in {'a', 'b'}:\n            self.x.pop(name, None)"},
        {"step": "self.x = dict(zip({'a', 'b'}, itertools.repeat(1)))['a']"},
        {"step": "self.x = [self.np_random.random() for _ in {'a', 'b'}]"},
        {"step": "self.x = 0\n        for _ in {'a', 'b'}:\n            self.x += int(self.np_random.integers(9))"},
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
        # The line raises, which play shows.
        {"reset": "self.missed = 0", "step": "self.mised += 1; done = self.missed > 2", "ended": "done"},
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
