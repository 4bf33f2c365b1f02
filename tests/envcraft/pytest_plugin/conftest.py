"""pytest driven by pytest itself, with the engine or one with given reports in its place."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

import envcraft.judging.engine
from envcraft.registry import offered
from tests.envcraft.pytest_plugin.stand_in import QUICK, Canned, NoDriver, Run


@pytest.fixture(scope="module", autouse=True)
def loaded() -> None:
    """What pytest imports in a run within this process it forgets after it: this is kept."""
    for hook in ("envcraft_checks", "envcraft_contracts", "envcraft_reporters", "envcraft_sandbox_drivers"):
        offered(hook)
    importlib.import_module("envcraft.cli.commands.validate")
    importlib.import_module("envcraft.pytest_plugin.fixture")


@pytest.fixture(autouse=True)
def without_hypothesis(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its plugin imports all of it at the end of each run, which takes longer than the run."""
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:hypothesispytest")


@pytest.fixture(autouse=True)
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where these are set, pytest repeats each failure whole in its summary."""
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.delenv("BUILD_NUMBER", raising=False)


@pytest.fixture
def canned(monkeypatch: pytest.MonkeyPatch) -> Canned:
    replacement = Canned()
    monkeypatch.setattr(envcraft.judging.engine, "validate", replacement.validate)
    monkeypatch.setattr("envcraft.pytest_plugin.judging.driver_named", lambda *_: NoDriver())
    return replacement


@pytest.fixture
def walk(good: Path, pytester: pytest.Pytester) -> Path:
    """A good environment at games/walk.py."""
    path = pytester.mkdir("games") / "walk.py"
    path.write_text(good.read_text())
    return path


@pytest.fixture
def run(pytester: pytest.Pytester) -> Run:
    """pytest in this process, with the plugin as it is installed."""
    return lambda *arguments: pytester.runpytest_inprocess(*QUICK, *arguments)
