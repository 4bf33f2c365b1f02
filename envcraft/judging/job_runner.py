"""Runs the jobs of one subject on the workers of its lease, several at a time."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Isolation, Limits, Player, Worker
from envcraft.judging.job_scheduler import JobScheduler, Placement, Task
from envcraft.judging.time_limit import OutOfTime, TimeLimit
from envcraft.judging.trace_builder import TraceBuilder
from envcraft.judging.worker_pool import Lease
from envcraft.model.contract import Contract
from envcraft.model.job import ExitReason, JobResult
from envcraft.model.target import Target, imported
from envcraft.model.trace import Trace

if TYPE_CHECKING:
    from envcraft_protocol.jobs import Job

#: Retries of a subject's jobs on another worker after theirs was lost. The cause may have been outside of the job.
_RETRIES = 2
#: Seconds of a measured job besides the measurement: the import, the reset, and a step that takes long.
_BESIDE = 15.0
#: Once a job hangs, a deadline is this many times what the longest call or job took that ended well, and at least so
#: many seconds.
_TIMES, _HURRIED_CALL, _HURRIED_JOB = 20, 2.0, 5.0
#: Modules whose changes to a process a worker can restore. Episodes of a file may share a process if it imports no
#: other modules.
_RESTORABLE = {
    "__future__", "abc", "bisect", "collections", "colorsys", "copy", "dataclasses", "enum", "fractions", "functools",
    "gymnasium", "heapq", "itertools", "math", "numpy", "operator", "pygame", "queue", "random", "re", "statistics",
    "string", "textwrap", "time", "types", "typing",
}  # fmt: skip

_T = TypeVar("_T")


class _NotForkable(Exception):
    """A worker has threads, so it must not fork jobs."""


@dataclass(frozen=True)
class PendingRollout:
    """A rollout or a search that was submitted. It does not count before a check requests it."""

    builder: TraceBuilder
    task: Task


class JobRunner:
    """Runs jobs on workers that it launches when they are needed.

    Args:
        lease: where the workers come from.
        target: the target whose jobs these are.
        contract: names the libraries that workers import before they fork jobs.
        parallel_jobs: the most jobs that run at a time.
        time_limit: of the subject.

    Attributes:
        about: what the first worker reports about itself (:attr:`envcraft.judging.driver.Worker.about`), {} before.
        seconds: the total wall time of the jobs whose results were requested.
        time_limit: when the last job ends.
        series: whether jobs may share a process. False after a job failed in a shared process.
    """

    def __init__(
        self, lease: Lease, target: Target, contract: Contract, parallel_jobs: int, time_limit: TimeLimit
    ) -> None:
        self.about: dict[str, Any] = {}
        self.seconds = 0.0
        self.time_limit = time_limit
        imports = set(imported(target.source))
        # Modules of a project would stay imported.
        self.series = not target.installed and target.project is None and imports <= _RESTORABLE
        self._lease = lease
        self._libraries = sorted(imports & set(contract.libraries or ()))
        self._modules: list[str] = []
        self._prepared: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._lost = 0
        #: Whether deadlines are short, and the longest call and job of those that ended well, in seconds.
        self._hurried = False
        self._longest_call = self._longest_job = 0.0
        self._scheduler = JobScheduler(self._launch, parallel_jobs)

    @property
    def isolation(self) -> Isolation:
        """How the workers are isolated."""
        return self._lease.pool.driver.isolation

    def close(self) -> None:
        """End the workers and release the lease."""
        self._scheduler.close()
        self._lease.release()

    def preload(self, modules: list[str]) -> None:
        """Have workers import modules once, before they fork further jobs, unless one of them starts a thread.

        Args:
            modules: installed modules that a job has imported.
        """
        self._modules = []
        if not modules:
            return

        def attempt(worker: Worker) -> None:
            self._prepared.add(worker)
            if not worker.preload(modules):
                # The exception ends the worker.
                raise _NotForkable

        try:
            self._scheduler.wait(self._scheduler.submit(Placement(), attempt))
        except (_NotForkable, WorkerLost):
            # Each job imports them then.
            return
        self._modules = modules

    def submit(
        self, placement: Placement, job: Job, builder: TraceBuilder, player: Player | None = None
    ) -> PendingRollout:
        """Queue a job whose messages go to `builder`, and return at once.

        Raises:
            WorkerLost: the runner is closed.
        """
        return PendingRollout(
            builder, self._scheduler.submit(placement, lambda worker: self._run(worker, job, builder, player))
        )

    def cancel(self, pending: PendingRollout) -> bool:
        """Remove a job from the queue; False if it has started."""
        return self._scheduler.cancel(pending.task)

    def result(self, pending: PendingRollout) -> Trace:
        """Wait for a job, and add its time.

        Raises:
            EnvCraftError: the sandbox failed.
            OutOfTime: the time limit of the subject ended the job.
        """
        try:
            end: JobResult = self._scheduler.wait(pending.task)
        except OutOfTime:
            raise self.time_limit.skip() from None
        self.seconds += end.seconds
        trace = pending.builder.main
        trace.end = end
        return trace

    def hurry(self) -> None:
        """Shorten the deadlines of later jobs, because a job is known to hang. Each new hang costs less then."""
        self._hurried = True

    def find_modules(self, names: list[str]) -> tuple[list[str], list[str]]:
        """Look modules up in a worker, see :meth:`envcraft.judging.driver.Worker.find`."""

        def attempt() -> tuple[list[str], list[str]]:
            task = self._scheduler.submit(Placement(), lambda worker: worker.find(names))
            found: tuple[list[str], list[str]] = self._scheduler.wait(task)
            return found

        return self.retry(attempt)

    def retry(self, attempt: Callable[[], _T]) -> _T:
        """Call `attempt`, and once more if its worker was lost.

        Raises:
            WorkerLost: too many workers of this subject were lost.
        """
        try:
            return attempt()
        except WorkerLost:
            self._lost += 1
            if self._lost > _RETRIES:
                raise
        return attempt()

    def _run(self, worker: Worker, job: Job, builder: TraceBuilder, player: Player | None) -> JobResult:
        if worker not in self._prepared:
            self._prepared.add(worker)
            if self._modules:
                worker.preload(self._modules)
        end = self._watch(worker, job, builder, player)
        wrong = end.reason is not ExitReason.DONE or builder.trace.fault is not None
        if not wrong or not job.get("series"):
            return end
        if not end.before and end.phase != "close":
            return end
        # An earlier episode in the process may be the cause, or the cleanup after this one.
        self.series = False
        builder.restart()
        alone = self._watch(worker, {**job, "series": False}, builder)
        return msgspec.structs.replace(alone, seconds=end.seconds + alone.seconds)

    def _watch(self, worker: Worker, job: Job, builder: TraceBuilder, player: Player | None = None) -> JobResult:
        """Run a job within the deadlines that hold now. Raises OutOfTime if the subject's time limit ends it."""
        limits = self._limits(job)
        # The time of a player is its own.
        left = self.time_limit.left if player is None else math.inf
        if left <= 0:
            raise OutOfTime
        end = worker.run(job, builder, msgspec.structs.replace(limits, job=min(limits.job, left)), player)
        if end.reason is ExitReason.DONE:
            self._longest_call = max(self._longest_call, max(builder.trace.costs, default=0) / 1e6)
            self._longest_job = max(self._longest_job, end.seconds)
        if end.reason is not ExitReason.TIMEOUT:
            return end
        if end.seconds >= left:
            raise OutOfTime
        return msgspec.structs.replace(end, whole=end.seconds >= limits.job)

    def _limits(self, job: Job) -> Limits:
        limits = self._lease.pool.limits
        call, most = limits.call, limits.job
        if job.get("count_waits"):
            most = min(most, job["seconds"] + _BESIDE)
        if self._hurried:
            call = min(call, max(_HURRIED_CALL, _TIMES * self._longest_call))
            most = min(most, max(_HURRIED_JOB, _TIMES * self._longest_job))
        return msgspec.structs.replace(limits, call=call, job=most)

    def _launch(self, placement: Placement) -> Worker:
        worker = self._lease.launch(placement.hash_seed, placement.fresh)
        self.about = self.about or worker.about
        if self._libraries:
            try:
                worker.preload(self._libraries)
            except BaseException:
                worker.close()
                raise
        return worker
