"""Judging beside an event loop: one thread per subject, and workers in the sandbox."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import msgspec

from envcraft.corpus.store import decode
from envcraft.errors import EnvCraftError, SandboxUnavailable
from envcraft.judging.budget import Budget
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver
from envcraft.judging.engine import Plan, cores, judge
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import SubjectFinished
from envcraft.model.target import PolicyFile, Target
from envcraft.model.verdict import SubjectReport, Verdict, plain
from envcraft_llm.degenerate import profile

_T = TypeVar("_T")

#: More subjects than any run has, so that the pool keeps launching workers ahead.
_SUBJECTS = 1_000_000
#: Episodes from which a policy's wins are counted.
_EPISODES = 6


class JudgingError(EnvCraftError):
    """The sandbox or a check failed, so the environment has no verdict."""


class JudgeExecutor:
    """Judges sources, `workers` of them concurrently; by default one per core.

    Use as a context manager: leaving it ends all workers. No worker starts before the first subject.
    """

    def __init__(
        self, contract: Contract, driver: Driver, checks: Sequence[Check], budget: Budget, workers: int | None = None
    ) -> None:
        self.workers = workers or cores()
        self._plan = Plan([], contract, driver, checks, budget, parallel_jobs=max(cores() // self.workers, 1))
        self._threads = ThreadPoolExecutor(self.workers, "envcraft-judge")
        self._pool: WorkerPool | None = None

    def __enter__(self) -> JudgeExecutor:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            # The threads end once their workers are gone.
            self._pool.close()
        self._threads.shutdown(cancel_futures=True)

    async def judge(self, target: Target) -> tuple[SubjectReport, dict[str, Any]]:
        """Run all checks, and return the report and the profile of the episodes.

        Raises:
            JudgingError: If the sandbox or a check failed.
            SandboxUnavailable: If no sandbox can be started.
        """
        return await self._run(self._plan, target, profile)

    async def play(self, target: Target, policy: str) -> tuple[SubjectReport, tuple[int, int]]:
        """Run the check ``difficulty`` with a privileged policy.

        Returns:
            The report, and the number of episodes that the policy won and played; it plays none if it cannot run.

        Raises:
            JudgingError: If the sandbox or a check failed.
            SandboxUnavailable: If no sandbox can be started.
        """
        checks = [check for check in self._plan.checks if check.gate or check.name == "difficulty"]
        plan = msgspec.structs.replace(self._plan, checks=checks, policy=PolicyFile("policy.py", policy))
        return await self._run(plan, target, _wins)

    async def _run(self, plan: Plan, target: Target, look: Callable[[Subject], _T]) -> tuple[SubjectReport, _T]:
        if self._pool is None:
            self._pool = WorkerPool(plan.driver, plan.limits, _SUBJECTS)
        work = functools.partial(_judge, plan, target, self._pool, look)
        try:
            report, seen = await asyncio.get_running_loop().run_in_executor(self._threads, work)
        except (JudgingError, SandboxUnavailable):
            raise
        except (OSError, EnvCraftError) as error:
            raise JudgingError(f"{target.path} could not be judged: {error}") from None
        if report.verdict is Verdict.ERROR:
            raise JudgingError(f"{target.path} could not be judged: {report.reason}")
        # As a later run reads it from the corpus, so that both send the same requests; an exception's text may have
        # characters without an encoding.
        return decode(msgspec.json.encode(plain(report)).decode()), seen


def _judge(plan: Plan, target: Target, pool: WorkerPool, look: Callable[[Subject], _T]) -> tuple[SubjectReport, _T]:
    seen: list[_T] = []
    for event in judge(plan, target, pool, look=lambda subject: seen.append(look(subject))):
        if isinstance(event, SubjectFinished):
            return event.report, seen[0]
    raise JudgingError(f"{target.path} could not be judged")


def _wins(subject: Subject) -> tuple[int, int]:
    """Count wins and episodes among those that the check has played with the policy."""
    played = [trace for trace in subject.traces if trace.rollout.policy]
    usable = [trace for trace in played[:_EPISODES] if trace.fault is None and not trace.refused]
    return sum(trace.positive for trace in usable), len(usable)
