"""``make new-check`` writes a check, fixtures and a registration that hold as generated."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

import evaluation.fixtures
import evaluation.judge
from docs.generate import page
from envcraft.judging.check import Check
from envcraft.judging.guide import guide_of
from evaluation.judge import failing, judge_fixtures
from evaluation.new_check import create, free_code


def test_the_generated_check_judges_its_fixtures(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "envcraft").mkdir()
    shutil.copy(root / "envcraft" / "plugins.py", tmp_path / "envcraft")
    module, *_ = create("lantern_oil", tmp_path)
    registered = (tmp_path / "envcraft" / "plugins.py").read_text("utf-8")
    assert '    "envcraft_checks.lantern_oil": ("envcraft_checks",),\n    "envcraft_checks.sandbox"' in registered
    monkeypatch.setitem(sys.modules, "lantern_oil", load(module))
    (check,) = sys.modules["lantern_oil"].envcraft_checks()
    assert isinstance(check, Check)
    assert page(check).startswith("# lantern_oil\n")
    guide = guide_of(check, check.rules[0].code)
    assert guide is not None
    assert guide.code().source in (tmp_path / "tests/fixtures/lantern_oil/bad").joinpath(
        f"{check.rules[0].code.lower()}_always.py"
    ).read_text("utf-8")
    monkeypatch.setattr(evaluation.fixtures, "FIXTURES", tmp_path / "tests" / "fixtures")
    monkeypatch.setattr(evaluation.judge, "default_checks", lambda: [check])
    fixtures = evaluation.fixtures.fixtures("lantern_oil")
    assert [bool(fixture.codes) for fixture in fixtures] == [True] * 5 + [False] * 3
    judged = {fixture.name: failing(report) for fixture, report in judge_fixtures(fixtures, "process", narrow=True)}
    assert judged == {fixture.name: fixture.codes for fixture in fixtures}


def test_names_and_codes_are_not_taken_twice(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is a check reward already"):
        create("reward", tmp_path)
    with pytest.raises(ValueError, match="identifier"):
        create("Lantern-Oil", tmp_path)
    assert free_code({"EC001", "EC019"}) == "EC021"
    assert free_code({f"EC{decade:02}1" for decade in range(5)}) == "EC061"


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("lantern_oil", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
