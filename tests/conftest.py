"""Shared by all tests: what is skipped elsewhere must not be skipped where CI set it up.

``ENVCRAFT_REQUIRE_DRIVERS=docker,bubblewrap`` turns the skips of tests with these markers into failures.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
_REQUIRED = {name for name in os.environ.get("ENVCRAFT_REQUIRE_DRIVERS", "").split(",") if name}


def pytest_configure() -> None:
    # A shell lets what it starts in the background ignore Ctrl-C, and what the tests start would inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


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


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT
