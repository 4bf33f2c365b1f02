"""One suite for every driver: a job can end itself, and affects nothing else."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from pkgutil import resolve_name
from typing import Any

import pytest
from envcraft_sandbox.bubblewrap import BubblewrapDriver
from envcraft_sandbox.docker import DockerDriver
from envcraft_sandbox.process import ProcessDriver
from envcraft_sandbox.zygote import ZygoteDriver

from envcraft.judging.driver import Driver, Isolation, Limits, Worker
from envcraft.model.job import ExitReason

#: ``ENVCRAFT_CONFORMANCE_DRIVER=package.module:Class`` asks another driver in place of the built-in ones.
NAMED = os.environ.get("ENVCRAFT_CONFORMANCE_DRIVER")
DRIVERS = (
    [pytest.param(resolve_name(NAMED), id=NAMED)]
    if NAMED
    else [
        pytest.param(DockerDriver, marks=pytest.mark.docker, id="docker"),
        pytest.param(BubblewrapDriver, marks=pytest.mark.bubblewrap, id="bubblewrap"),
        pytest.param(lambda: BubblewrapDriver().shared_layout(), marks=pytest.mark.bubblewrap, id="bubblewrap-zygote"),
        pytest.param(ProcessDriver, id="process"),
        pytest.param(lambda: ProcessDriver().shared_layout(), id="process-zygote"),
    ]
)


Environment = Callable[..., str]


@pytest.fixture(scope="module", params=DRIVERS)
def driver(request: pytest.FixtureRequest) -> Iterator[Driver]:
    made: Driver = request.param()
    available = made.probe()
    if not available.works:
        (pytest.fail if NAMED else pytest.skip)(f"{available.reason}; {available.fix}")
    yield made
    # Or it was another driver that was asked.
    assert not isinstance(made, ZygoteDriver) or not made.refusal
    made.close()


@pytest.fixture(scope="module")
def isolating(driver: Driver) -> Driver:
    """The driver, if it has namespaces."""
    if driver.isolation is Isolation.PROCESS:
        pytest.skip("isolation by process shares the machine's files, network and processes")
    return driver


@pytest.fixture(scope="module")
def worker(driver: Driver, limits: Limits) -> Iterator[Worker]:
    """One worker for the whole suite: it must outlive all that the jobs do."""
    made = driver.launch(hash_seed=0, limits=limits)
    yield made
    made.close()


@pytest.fixture
def token() -> str:
    return "ec" + secrets.token_hex(6)


@pytest.fixture(autouse=True)
def _serves_the_next_job(request: pytest.FixtureRequest, environment: Environment, play: Any) -> Iterator[None]:
    """After every test, the shared worker runs an ordinary job as if nothing had been."""
    yield
    if "worker" in request.fixturenames:
        ran = play(request.getfixturevalue("worker"), environment())
        assert ran.end.reason is ExitReason.DONE
        assert ran.trace.steps == 8
        assert ran.end.output == ""
