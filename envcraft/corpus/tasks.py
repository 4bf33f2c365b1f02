"""One environment to judge as bytes, and the function that judges it in the process of an executor.

A task is MessagePack, because a contract may contain infinities, which JSON cannot represent. The result is JSON, which
the corpus stores. The process that judges must have the settings under which the verdict is stored, because other rules
or another image may give another verdict.
"""

from __future__ import annotations

import contextlib
import functools
import platform

import msgspec

from envcraft.errors import EnvCraftError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Limits, ensure
from envcraft.judging.engine import Plan
from envcraft.judging.engine import judge as judge_here
from envcraft.judging.selection import checks_named, driver_named
from envcraft.judging.settings import Settings, settings_of
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import SubjectFinished
from envcraft.model.target import PolicyFile, Project, Target
from envcraft.model.verdict import plain


class Order(msgspec.Struct, frozen=True):
    """The plan of an audit as data.

    Attributes:
        settings: the settings of the verdicts, among them the driver, the budget and the seed.
        contract: the whole contract, because its definition may be in a file of this machine.
        checks: the names of the checks in order.
        runtime: the container runtime, if the user requested one.
        isolation: the minimum isolation, if the user requested one.
        limits: of each job.
        time_limit: of each environment in seconds; None takes the budget's.
        fail_fast: an environment ends at its first error.
        policy: the privileged policy of the check ``difficulty``, if the user named one.
    """

    settings: Settings
    contract: Contract
    checks: list[str]
    runtime: str | None = None
    isolation: str | None = None
    limits: Limits = Limits()
    time_limit: float | None = None
    fail_fast: bool = False
    policy: PolicyFile | None = None

    def to_bytes(self) -> bytes:
        return msgspec.msgpack.encode(self)


class Task(msgspec.Struct, frozen=True):
    """An environment and the order, which is encoded separately so that a process decodes it once."""

    order: bytes
    path: str
    source: bytes
    env_class: str | None
    project: Project | None = None


def encode(order: bytes, target: Target) -> bytes:
    """Encode a task for :func:`judge`.

    Args:
        order: an encoded :class:`Order`.
        target: the file to judge.
    """
    return msgspec.msgpack.encode(Task(order, plain(target.path), target.source, target.env_class, target.project))


def judge(task: bytes) -> bytes:
    """Judge one environment.

    Args:
        task: an encoded :class:`Task`.

    Returns:
        The :class:`envcraft.model.verdict.SubjectReport` as JSON.

    Raises:
        EnvCraftError: the settings of this process differ from those of the order.
    """
    decoded = msgspec.msgpack.decode(task, type=Task)
    plan = _plan(decoded.order)
    target = Target(decoded.path, decoded.source, decoded.env_class, project=decoded.project)
    with WorkerPool(plan.driver, plan.limits, 1) as pool, contextlib.closing(judge_here(plan, target, pool)) as events:
        report = next(event.report for event in events if isinstance(event, SubjectFinished))
    return msgspec.json.encode(plain(report))


@functools.lru_cache(maxsize=1)
def _plan(order: bytes) -> Plan:
    """Build the plan of an order, once for all tasks of an audit. Raises EnvCraftError if the settings differ."""
    decoded = msgspec.msgpack.decode(order, type=Order)
    wanted = decoded.settings
    try:
        checks = checks_named(decoded.checks)
        driver = driver_named(wanted.driver, decoded.isolation, decoded.runtime, probe=False)
        ensure(driver)
        if wanted.budget not in BUDGETS:
            raise EnvCraftError(f"there is no budget {wanted.budget}")
        here = settings_of(decoded.contract, checks, driver, BUDGETS[wanted.budget], wanted.seed, decoded.policy)
        if differing := here.differing(wanted):
            raise EnvCraftError(f"{'; '.join(differing)}; install there what is installed here")
    except EnvCraftError as error:
        # A UsageError of this process is not the user's mistake.
        raise EnvCraftError(f"the worker on {platform.node()} cannot judge as this process does: {error}") from None
    budget, limits = BUDGETS[wanted.budget], decoded.limits
    # The executor runs tasks in parallel, so a task runs one job at a time.
    return Plan(
        [],
        decoded.contract,
        driver,
        checks,
        budget,
        wanted.seed,
        decoded.policy,
        limits=limits,
        parallel_jobs=1,
        time_limit=decoded.time_limit,
        fail_fast=decoded.fail_fast,
    )
