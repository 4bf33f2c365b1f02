"""Hooks for all tests.

``ENVCRAFT_REQUIRE_DRIVERS=docker,bubblewrap`` turns the skips of tests with these markers into failures: CI installs
the drivers, so nothing may skip their tests.

``ENVCRAFT_TEST_DEADLINE`` is the time, in seconds since the epoch, after which no test starts. CI sets it, so that a
slow machine reports the results that it has. The later tests are skipped, and the summary says so.

``make test`` distributes whole files to the processes of pytest-xdist, in the order that is defined here.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from envcraft_sandbox.bubblewrap import BubblewrapDriver
from envcraft_sandbox.process import ProcessDriver

from envcraft.judging.driver import Driver
from envcraft.judging.engine import cores
from envcraft.judging.installed import Installed

# Several tests run at a time, and threads that wait for each other actively would take their processors.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# As in the command `envcraft`: the modules and tests of a process are many objects, and little of them is garbage.
gc.set_threshold(50_000, 20, 20)
ROOT = Path(__file__).resolve().parent.parent
# Other tests may take the processor for seconds while Hypothesis draws one example.
hypothesis.settings.register_profile("envcraft", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile("envcraft")
_REQUIRED = {name for name in os.environ.get("ENVCRAFT_REQUIRE_DRIVERS", "").split(",") if name}
_DEADLINE = float(os.environ.get("ENVCRAFT_TEST_DEADLINE", "inf"))
_LATE = pytest.StashKey[bool]()
#: Slow files run first, so that none of them is the last. The hostile programs start first of all, beside other tests
#: that wait for deadlines.
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
    "plugins/dqn/test_learnability.py",
    "plugins/dqn/test_proof.py",
    "plugins/dqn/test_resume.py",
    "plugins/dqn/test_study_run.py",
    "checks/test_guides.py",
    "e2e/test_plugin_package.py",
    "e2e/test_targets.py",
    "test_site.py",
)
_SECTIONS = pytest.StashKey[dict[str, str]]()


def pytest_configure() -> None:
    # A background job of a shell ignores SIGINT, and the child processes of the tests would inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # A verdict of one test, or of the developer, must not let another test trust a file.
    os.environ["ENVCRAFT_CACHE"] = ""
    # The size of the developer's terminal would apply to every terminal that a test opens.
    for name in ("COLUMNS", "LINES"):
        os.environ.pop(name, None)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    if time.time() > _DEADLINE:
        item.stash[_LATE] = True
        pytest.skip("not run: this machine is too slow for the time that ENVCRAFT_TEST_DEADLINE leaves")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report: pytest.TestReport = yield
    needed = _REQUIRED & {mark.name for mark in item.iter_markers()}
    # pytest reports an expected failure as skipped, too.
    if report.skipped and needed and not hasattr(report, "wasxfail") and _LATE not in item.stash:
        reason: Any = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome = "failed"
        report.longrepr = f"ENVCRAFT_REQUIRE_DRIVERS names {', '.join(sorted(needed))}, but: {reason}"
    return report


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One process per core, one that waits for the hostile programs, and one that waits for other deadlines."""
    return cores() + 2


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if hasattr(config, "workerinput"):
        order = {ROOT / "tests" / name: number for number, name in enumerate(_FIRST)}
        items.sort(key=lambda item: order.get(item.path, len(order)))


def pytest_collection_finish() -> None:
    # The tests stay to the end, so that no search for garbage needs to visit them.
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Collect the report sections of the pytest-xdist processes."""
    sections = node.config.stash.setdefault(_SECTIONS, {})
    sections.update((getattr(node, "workeroutput", None) or {}).get("sections", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for title, text in config.stash.get(_SECTIONS, {}).items():
        terminalreporter.section(title)
        terminalreporter.write_line(text)


@pytest.fixture(scope="session")
def zygotes() -> Generator[dict[tuple[str, Installed], Driver]]:
    """Drivers that fork their workers, by the driver's name and what its workers can import."""
    with contextlib.ExitStack() as closing:
        found: dict[tuple[str, Installed], Driver] = {}
        yield found
        for driver in found.values():
            closing.callback(type(driver).close, driver)


@pytest.fixture(scope="module", autouse=True)
def shared_zygotes(zygotes: dict[tuple[str, Installed], Driver]) -> Generator[None]:
    """Fork the workers of all validations in this process from the same zygotes, as one audit does.

    A launched worker imports NumPy and Gymnasium, which takes longer than most tests. Workers that a check wants fresh
    are launched, and commands that run in a process of their own launch all workers.
    """

    def sharing(original: Callable[[Any], Driver]) -> Callable[[Any], Driver]:
        def shared_layout(driver: Any) -> Driver:
            key = (driver.name, driver._found)
            if key not in zygotes:
                zygotes[key] = original(driver)
                # The pool closes the driver, and the next validation uses it again.
                vars(zygotes[key])["close"] = lambda: None
            return zygotes[key]

        return shared_layout

    with pytest.MonkeyPatch.context() as patch:
        for driver in (ProcessDriver, BubblewrapDriver):
            patch.setattr(driver, "shared_layout", sharing(driver.shared_layout))
            patch.setattr(driver, "shares_from", 0)
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT
