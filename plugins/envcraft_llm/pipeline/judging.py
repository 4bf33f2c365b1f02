"""Judging beside an event loop: threads of this process, workers in the sandbox, one subject a thread."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import msgspec

from envcraft.budget import Budget
from envcraft.check import Check
from envcraft.contract import Contract
from envcraft.corpus.store import decode
from envcraft.engine import Plan, cores, judge
from envcraft.errors import EnvCraftError, SandboxUnavailable
from envcraft.events import SubjectFinished
from envcraft.pool import Pool
from envcraft.sandbox import Driver
from envcraft.subject import Subject
from envcraft.target import PolicyFile, Target
from envcraft.verdict import SubjectReport, Verdict, plain
from envcraft_llm.guard import profile

_T = TypeVar("_T")

#: More subjects than any run has: a pool goes on launching ahead.
_SUBJECTS = 1_000_000
#: Episodes by which it is told how often a policy wins.
_EPISODES = 6


class CouldNotJudge(EnvCraftError):
    """The sandbox failed, or a check broke: nothing is known of the environment."""


class Judges:
    """Judges sources, as many at a time as `workers` says, by default as there are cores. Leave the context to end all
    workers; nothing is launched before there is something to judge.
    """

    def __init__(
        self, contract: Contract, driver: Driver, checks: Sequence[Check], budget: Budget, workers: int | None = None
    ) -> None:
        self.workers = workers or cores()
        self._plan = Plan([], contract, driver, checks, budget, lanes=max(cores() // self.workers, 1))
        self._threads = ThreadPoolExecutor(self.workers, "envcraft-judge")
        self._pool: Pool | None = None

    def __enter__(self) -> Judges:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            # Without workers the threads have nothing left to do.
            self._pool.end()
        self._threads.shutdown(cancel_futures=True)

    async def judge(self, target: Target) -> tuple[SubjectReport, dict[str, Any]]:
        """The report of all checks, and the profile of what was played. Raises CouldNotJudge, SandboxUnavailable."""
        return await self._run(self._plan, target, profile)

    async def play(self, target: Target, policy: str) -> tuple[SubjectReport, tuple[int, int]]:
        """The report of ``difficulty`` with a privileged policy, and in how many of how many episodes it wins, none
        where it cannot be played with. Raises CouldNotJudge, SandboxUnavailable.
        """
        checks = [check for check in self._plan.checks if check.name in ("source", "difficulty")]
        plan = msgspec.structs.replace(self._plan, checks=checks, policy=PolicyFile("policy.py", policy))
        return await self._run(plan, target, _wins)

    async def _run(self, plan: Plan, target: Target, look: Callable[[Subject], _T]) -> tuple[SubjectReport, _T]:
        if self._pool is None:
            self._pool = Pool(plan.driver, plan.limits, _SUBJECTS)
        work = functools.partial(_judged, plan, target, self._pool, look)
        try:
            report, seen = await asyncio.get_running_loop().run_in_executor(self._threads, work)
        except (CouldNotJudge, SandboxUnavailable):
            raise
        except (OSError, EnvCraftError) as error:
            raise CouldNotJudge(f"{target.path} could not be judged: {error}") from None
        if report.verdict is Verdict.ERROR:
            raise CouldNotJudge(f"{target.path} could not be judged: {report.reason}")
        # As a later run reads it, so that a model is told the same by both; and what was raised may have no encoding.
        return decode(msgspec.json.encode(plain(report)).decode()), seen


def _judged(plan: Plan, target: Target, pool: Pool, look: Callable[[Subject], _T]) -> tuple[SubjectReport, _T]:
    seen: list[_T] = []
    for event in judge(plan, target, pool, look=lambda subject: seen.append(look(subject))):
        if isinstance(event, SubjectFinished):
            return event.report, seen[0]
    raise CouldNotJudge(f"{target.path} could not be judged")


def _wins(subject: Subject) -> tuple[int, int]:
    """Of what the check has played with the policy, so that nothing is played for this alone."""
    played = [trace for trace in subject.traces if trace.rollout.policy]
    usable = [trace for trace in played[:_EPISODES] if trace.fault is None and not trace.refused]
    return sum(trace.positive for trace in usable), len(usable)
