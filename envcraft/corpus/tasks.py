"""One environment to judge, as bytes, and the judging of it in whichever process an executor runs that.

MessagePack on the way there, since a contract may have infinities in it, which JSON lacks; JSON on the way back, as the
corpus keeps it. Whoever judges must come to the settings that the verdict will be kept under: other rules, or another
image, give other verdicts.
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
from envcraft.model.target import Target
from envcraft.model.verdict import plain


class Order(msgspec.Struct, frozen=True):
    """How to judge: the plan of an audit as data.

    Attributes:
        settings: what verdicts are kept under: among others the driver, the budget and the seed.
        contract: whole, since it may be that of a file here.
        checks: their names, in their order.
        runtime: the container runtime, if one was asked for.
        isolation: the least isolation, if one was asked for.
        limits: of each job.
    """

    settings: Settings
    contract: Contract
    checks: list[str]
    runtime: str | None = None
    isolation: str | None = None
    limits: Limits = Limits()

    def to_bytes(self) -> bytes:
        return msgspec.msgpack.encode(self)


class Task(msgspec.Struct, frozen=True):
    """An environment and the order to judge it, which is encoded by itself so that a process reads it once."""

    order: bytes
    path: str
    source: bytes
    env_class: str | None


def encode(order: bytes, target: Target) -> bytes:
    """A file to judge, as :func:`judge` takes it."""
    return msgspec.msgpack.encode(Task(order, plain(target.path), target.source, target.env_class))


def judge(task: bytes) -> bytes:
    """Judge one environment: a :class:`Task` in, a :class:`envcraft.model.verdict.SubjectReport` as JSON out.

    Raises EnvCraftError where this process cannot judge as the one that sent the task would.
    """
    told = msgspec.msgpack.decode(task, type=Task)
    plan = _plan(told.order)
    target = Target(told.path, told.source, told.env_class)
    with WorkerPool(plan.driver, plan.limits, 1) as pool, contextlib.closing(judge_here(plan, target, pool)) as events:
        report = next(event.report for event in events if isinstance(event, SubjectFinished))
    return msgspec.json.encode(plain(report))


@functools.lru_cache(maxsize=1)
def _plan(order: bytes) -> Plan:
    """The plan of an order in this process, made once for all tasks of an audit. Raises EnvCraftError."""
    told = msgspec.msgpack.decode(order, type=Order)
    wanted = told.settings
    try:
        checks = checks_named(told.checks)
        driver = driver_named(wanted.driver, told.isolation, told.runtime, probe=False)
        ensure(driver)
        if wanted.budget not in BUDGETS:
            raise EnvCraftError(f"there is no budget {wanted.budget}")
        here = settings_of(told.contract, checks, driver, BUDGETS[wanted.budget], wanted.seed)
        if differing := here.differing(wanted):
            raise EnvCraftError(f"{'; '.join(differing)}; install there what is installed here")
    except EnvCraftError as error:
        # Wrong use here is none of the person who audits.
        raise EnvCraftError(f"the worker on {platform.node()} cannot judge as this process does: {error}") from None
    # Tasks are what is run side by side.
    return Plan(
        [], told.contract, driver, checks, BUDGETS[wanted.budget], wanted.seed, limits=told.limits, parallel_jobs=1
    )
