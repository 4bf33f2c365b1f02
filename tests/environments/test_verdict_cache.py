"""``envcraft.make`` takes the verdicts of ``envcraft validate``, and no others."""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

import envcraft
from envcraft.cli.commands.validate import validate
from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.contracts.lookup import contract_named
from envcraft.corpus.store import Store
from envcraft.environments import sources
from envcraft.environments.sources import Untrusted
from envcraft.judging import verdict_cache
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.selection import driver_named, select_checks
from envcraft.judging.severity import SeverityPolicy
from envcraft.model.contract import Contract
from envcraft.model.project import with_project
from envcraft.model.target import read_target
from envcraft.model.verdict import CheckReport, Finding, Ignored, ProjectFiles, Report, Severity, SubjectReport, Verdict

from .conftest import POINT, game, judged

#: Passes every check under ``gymnasium``.
LINE = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Line(gym.Env):
    def __init__(self):
        self.observation_space = spaces.Box(-20, 20, (2,), np.float32)
        self.action_space = spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = int(self.np_random.integers(-3, 4)), 0
        self.goal = int(self.np_random.choice([-5, 5]))
        return self._observation(), {}

    def step(self, action):
        before = abs(self.goal - self.at)
        self.at = max(-10, min(10, self.at + int(action) - 1))
        self.steps += 1
        left = abs(self.goal - self.at)
        return self._observation(), float(before - left), left == 0, self.steps >= 60, {}

    def _observation(self):
        return np.array([self.at, self.goal], np.float32)
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(verdict_cache.VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "verdicts"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "lantern.py"
    path.write_text(game())
    return path


def _plan(file: Path, contract: Contract = ARCADE, skip: str | None = None, seed: int = 0) -> Plan:
    checks = select_checks(None, skip)
    return Plan([read_target(str(file))], contract, driver_named("process"), checks, BUDGETS["quick"], seed)


def _record(plan: Plan, verdict: Verdict = Verdict.PASS, checks: list[CheckReport] | None = None) -> None:
    target = plan.targets[0]
    name = next(name for name in ("Point", "Line", "Game") if f"class {name}".encode() in target.source)
    report = SubjectReport(target.path, name, target.sha256, verdict, "process", 0.1, 10, checks or [])
    if target.project is not None:
        report.project = ProjectFiles(target.project.root, target.project.digests)
    verdict_cache.record(plan, Report(plan.contract.name, plan.seed, [report]))


def _validate(file: Path) -> int:
    words = [str(file), "--contract", "gymnasium", "--sandbox", "process", "--budget", "quick"]
    return CliRunner().invoke(validate, words).exit_code


def test_a_run_of_the_command_lets_make_import_the_file(tmp_path: Path, cache: Path) -> None:
    file = tmp_path / "line.py"
    file.write_text(LINE)
    with pytest.raises(Untrusted, match="has no verdict under the contract arcade"):
        envcraft.make(file)
    assert _validate(file) == 0
    env = envcraft.make(file)
    assert type(env.unwrapped).__name__ == "Line"
    assert env.observation_space.contains(env.reset(seed=3)[0])


def _with_files(file: Path, source: str) -> Plan:
    """A plan with a file of LINE, and the files of its project that the first line names."""
    file.write_text(source + LINE)
    plan = _plan(file, GYMNASIUM)
    return msgspec.structs.replace(plan, targets=[with_project(plan.targets[0])])


def test_a_file_that_imports_its_project_is_not_kept(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "sizes.py").write_text("SIZE = 4\n")
    _record(_with_files(tmp_path / "line.py", "from sizes import SIZE\n"))
    assert not cache.exists()
    with pytest.raises(Untrusted, match="imports files of its project"):
        envcraft.make(tmp_path / "line.py")


def test_a_verdict_holds_for_the_files_that_were_read(tmp_path: Path, cache: Path) -> None:
    (tmp_path / "levels.txt").write_text("one")
    _record(_with_files(tmp_path / "line.py", "LEVELS = 'levels.txt'\n"))
    envcraft.make(tmp_path / "line.py").close()
    (tmp_path / "levels.txt").write_text("two")
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(tmp_path / "line.py")


def test_a_run_of_the_function_that_fails_is_remembered(tmp_path: Path, cache: Path) -> None:
    file = tmp_path / "point.py"
    file.write_text(POINT)
    report = envcraft.validate(file, contract="gymnasium", sandbox="process", budget="quick")
    assert report.reports[0].verdict is Verdict.FAIL
    with pytest.raises(Untrusted, match=r"`envcraft validate .*point\.py --contract gymnasium` says why"):
        envcraft.make(file)


def test_a_pass_holds_for_one_source_and_one_contract(file: Path, cache: Path) -> None:
    _record(_plan(file))
    assert type(envcraft.make(file).unwrapped).__name__ == "Game"
    with pytest.raises(Untrusted, match="no verdict under the contract gymnasium"):
        envcraft.make(file, contract="gymnasium")
    file.write_text(game(end="self.steps >= 8"))
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(file)


def test_the_contract_is_the_one_that_the_file_has_passed(file: Path, cache: Path) -> None:
    _record(_plan(file, GYMNASIUM))
    _record(_plan(file), Verdict.FAIL)
    assert sources.resolve(file).contract == GYMNASIUM
    with pytest.raises(Untrusted, match=r"has the verdict fail .*`envcraft validate .*lantern\.py` says why"):
        envcraft.make(file, contract="arcade")


def test_another_seed_does_not_revoke_a_failure(file: Path, cache: Path) -> None:
    _record(_plan(file, seed=1), Verdict.FAIL)
    _record(_plan(file))
    with pytest.raises(Untrusted, match="has the verdict fail"):
        envcraft.make(file)


def test_a_failure_counts_against_an_audit(file: Path, cache: Path) -> None:
    with Store.create(file.parent / ".envcraft", folder=True) as store:
        judged(store, "lantern.py", game(), "Game", ARCADE, Verdict.PASS)
    envcraft.make(file)
    _record(_plan(file), Verdict.FAIL)
    with pytest.raises(Untrusted, match="`envcraft validate"):
        envcraft.make(file)


def test_other_promises_of_the_same_name_are_not_taken(
    file: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _record(_plan(file))
    changed = msgspec.structs.replace(ARCADE, min_steps_per_second=1.0)
    monkeypatch.setattr(sources, "contract_named", lambda name: changed if name == "arcade" else contract_named(name))
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(file)


def test_a_verdict_of_other_code_is_not_taken(file: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _record(_plan(file))
    monkeypatch.setattr(verdict_cache, "rules_version", lambda *_: "another version")
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(file)


def test_the_command_in_the_hint_names_the_contract_of_an_earlier_verdict(
    file: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _record(_plan(file, GYMNASIUM))
    monkeypatch.setattr(verdict_cache, "rules_version", lambda *_: "another version")
    with pytest.raises(Untrusted, match=r"`envcraft validate .*lantern\.py --contract gymnasium` judges it"):
        envcraft.make(file)
    with pytest.raises(Untrusted, match=r"`envcraft validate .*lantern\.py` judges it"):
        envcraft.make(file, contract="arcade")


def test_a_time_limit_that_was_not_reached_changes_nothing(file: Path, cache: Path) -> None:
    plan = msgspec.structs.replace(_plan(file), time_limit=60.0)
    target = plan.targets[0]
    report = SubjectReport(target.path, "Game", target.sha256, Verdict.PASS, "process", 0.1, 10, [], out_of_time=True)
    verdict_cache.record(plan, Report(plan.contract.name, plan.seed, [report]))
    assert not cache.exists()
    _record(plan)
    envcraft.make(file).close()


def test_a_lenient_run_is_not_kept(file: Path, cache: Path) -> None:
    plan = _plan(file)
    finding = Finding("EC204", Severity.ERROR, "differs")
    waived = CheckReport("determinism", Verdict.PASS, ignored=[Ignored(finding, "known", 3)])
    _record(_plan(file, skip="determinism"))
    _record(plan, checks=[waived])
    _record(plan, checks=[CheckReport("determinism", Verdict.PASS, known=[finding])])
    _record(plan, Verdict.ERROR)
    _record(msgspec.structs.replace(plan, severity=SeverityPolicy(ignore=("EC204",))))
    _record(msgspec.structs.replace(plan, severity=SeverityPolicy({"EC204": "off"})))
    _record(msgspec.structs.replace(plan, fail_fast=True))
    _record(msgspec.structs.replace(plan, targets=[msgspec.structs.replace(plan.targets[0], kwargs={"start": 1})]))
    assert not cache.exists()
    _record(plan)
    assert len(list(cache.iterdir())) == 1


def test_a_cache_that_is_broken_is_ignored(file: Path, cache: Path) -> None:
    _record(_plan(file))
    [kept] = cache.iterdir()
    content = kept.read_bytes()
    kept.write_bytes(content[:-9])
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(file)
    kept.unlink()
    other = hashlib.sha256(b"other").hexdigest()
    kept.with_name(kept.name.replace(kept.name[:64], other)).write_bytes(content)
    assert verdict_cache.cached(other) == []
    for left in cache.iterdir():
        left.unlink()
    cache.rmdir()
    cache.write_text("not a folder")
    _record(_plan(file))
    with pytest.raises(Untrusted, match="no verdict"):
        envcraft.make(file)


def test_the_folder_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: Path) -> None:
    monkeypatch.delenv(verdict_cache.VARIABLE)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    _record(_plan(file))
    assert len(list((tmp_path / "home" / ".cache" / "envcraft" / "verdicts").iterdir())) == 1
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    with pytest.raises(Untrusted):
        envcraft.make(file)
    _record(_plan(file))
    assert len(list((tmp_path / "xdg" / "envcraft" / "verdicts").iterdir())) == 1
    envcraft.make(file)
