"""Hostile programs mostly wait for deadlines: they are begun before the first test, and their tests come last."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from envcraft.engine import cores
from tests.hostile.judge import Runs, missing

_RUNS = pytest.StashKey[Runs]()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=_is_run)


def pytest_collection_finish(session: pytest.Session) -> None:
    # Every process of pytest-xdist would begin all of them.
    if session.config.option.collectonly or "PYTEST_XDIST_WORKER" in os.environ:
        return
    session.config.stash[_RUNS] = _begin(session.items, cores())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    runs = config.stash.get(_RUNS, None)
    if runs is not None and runs.seen:
        terminalreporter.section("hostile programs")
        terminalreporter.write_line(runs.table())


def pytest_unconfigure(config: pytest.Config) -> None:
    if _RUNS in config.stash:
        config.stash[_RUNS].__exit__()


@pytest.fixture(scope="session")
def runs(request: pytest.FixtureRequest) -> Iterator[Runs]:
    """All runs that this session asks for, side by side."""
    if _RUNS in request.config.stash:
        yield request.config.stash[_RUNS]
        return
    with _begin(request.session.items, cores() + 1) as begun:
        yield begun


def _is_run(item: pytest.Item) -> bool:
    return "runs" in getattr(item, "fixturenames", ()) and item.path.parent == Path(__file__).parent


def _begin(items: Iterable[pytest.Item], workers: int) -> Runs:
    begun = Runs(workers)
    for item in filter(_is_run, items):
        asked = item.callspec.params  # type: ignore[attr-defined]
        if not missing(asked["driver"]):
            begun.begin(asked["program"], asked["driver"])
    return begun
