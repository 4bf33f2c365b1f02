"""Shared by all tests: what is skipped elsewhere must not be skipped where CI set it up.

``ENVCRAFT_REQUIRE_DRIVERS=docker,bubblewrap`` turns the skips of tests with these markers into failures.

``make test`` gives whole files to processes of pytest-xdist, in the order in which they are collected here.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from envcraft.engine import cores

ROOT = Path(__file__).resolve().parent.parent
_REQUIRED = {name for name in os.environ.get("ENVCRAFT_REQUIRE_DRIVERS", "").split(",") if name}
#: Files that take long come before the others, so that none of them is the last. The slowest hostile programs are begun
#: first, beside tests that wait for deadlines, too.
_FIRST = (
    "hostile/test_hostile.py",
    "sandbox/conformance/test_ends.py",
    "sandbox/conformance/test_limits.py",
    "sandbox/conformance/test_remains.py",
    "sandbox/test_leftovers.py",
    "checks/test_fixtures.py",
    "e2e/test_examples.py",
    "corpus/test_audit_command.py",
    "plugins/generation/test_pipeline.py",
)
_SECTIONS = pytest.StashKey[dict[str, str]]()


def pytest_configure() -> None:
    # A shell lets what it starts in the background ignore Ctrl-C, and what the tests start would inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # The size of somebody's own terminal, which would be that of every terminal that a test opens.
    for name in ("COLUMNS", "LINES"):
        os.environ.pop(name, None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report: pytest.TestReport = yield
    needed = _REQUIRED & {mark.name for mark in item.iter_markers()}
    # An expected failure is reported as skipped, too, and is none of this.
    if report.skipped and needed and not hasattr(report, "wasxfail"):
        reason: Any = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome = "failed"
        report.longrepr = f"ENVCRAFT_REQUIRE_DRIVERS names {', '.join(sorted(needed))}, but: {reason}"
    return report


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """As many as there are cores: one of them waits for the hostile programs, which keep the cores busy meanwhile."""
    return max(cores(), 2)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if hasattr(config, "workerinput"):
        order = {ROOT / "tests" / name: number for number, name in enumerate(_FIRST)}
        items.sort(key=lambda item: order.get(item.path, len(order)))


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """What a process has to say at the end is said by the one that started it."""
    sections = node.config.stash.setdefault(_SECTIONS, {})
    sections.update((getattr(node, "workeroutput", None) or {}).get("sections", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for title, text in config.stash.get(_SECTIONS, {}).items():
        terminalreporter.section(title)
        terminalreporter.write_line(text)


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT
