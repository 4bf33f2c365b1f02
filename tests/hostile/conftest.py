"""Start the hostile programs before the first test and read their results last, because they mostly wait for deadlines.

Under pytest-xdist only the process that has their tests starts them.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from envcraft.judging.engine import cores
from tests.hostile.judge import Runs, missing

_RUNS = pytest.StashKey[Runs]()
_TITLE = "hostile programs"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not hasattr(config, "workerinput"):
        items.sort(key=_is_run)


def pytest_collection_finish(session: pytest.Session) -> None:
    if not session.config.option.collectonly and not hasattr(session.config, "workerinput"):
        session.config.stash[_RUNS] = _begin(session.items)


def pytest_sessionfinish(session: pytest.Session) -> None:
    runs = session.config.stash.get(_RUNS, None)
    if runs is not None and runs.seen and hasattr(session.config, "workeroutput"):
        session.config.workeroutput["sections"] = {_TITLE: runs.table()}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    runs = config.stash.get(_RUNS, None)
    if runs is not None and runs.seen:
        terminalreporter.section(_TITLE)
        terminalreporter.write_line(runs.table())


def pytest_unconfigure(config: pytest.Config) -> None:
    if _RUNS in config.stash:
        config.stash[_RUNS].__exit__()


@pytest.fixture(scope="session")
def runs(request: pytest.FixtureRequest) -> Runs:
    """All runs of this session, side by side."""
    stash = request.config.stash
    if _RUNS not in stash:
        stash[_RUNS] = _begin(request.session.items)
    return stash[_RUNS]


def _is_run(item: pytest.Item) -> bool:
    return "runs" in getattr(item, "fixturenames", ()) and item.path.parent == Path(__file__).parent


def _begin(items: Iterable[pytest.Item]) -> Runs:
    # The other tests run at the same time.
    runs = Runs(cores())
    for item in filter(_is_run, items):
        params = item.callspec.params  # type: ignore[attr-defined]
        if not missing(params["driver"]):
            runs.begin(params["program"], params["driver"])
    return runs
