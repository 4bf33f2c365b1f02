"""Runs the jobs of one subject on the workers of its lease, several at a time."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Isolation, Player, Worker
from envcraft.judging.job_scheduler import JobScheduler, Placement, Task
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
#: Modules whose changes to a process a worker can restore. Episodes of a file may share a process if it imports no
#: other modules.
_RESTORABLE = {
    "__future__", "abc", "bisect", "collections", "colorsys", "copy", "dataclasses", "enum", "fractions", "functools",
    "gymnasium", "heapq", "itertools", "math", "numpy", "operator", "queue", "random", "re", "statistics", "string",
    "textwrap", "time", "types", "typing",
}  # fmt: skip

_T = TypeVar("_T")


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

    Attributes:
        about: what the first worker reports about itself (:attr:`envcraft.judging.driver.Worker.about`), {} before.
        seconds: the total wall time of the jobs whose results were requested.
        series: whether jobs may share a process. False after a job failed in a shared process.
    """

    def __init__(self, lease: Lease, target: Target, contract: Contract, parallel_jobs: int) -> None:
        self.about: dict[str, Any] = {}
        self.seconds = 0.0
        imports = set(imported(target.source))
        self.series = not target.installed and imports <= _RESTORABLE
        self._lease = lease
        self._libraries = sorted(imports & set(contract.libraries or ()))
        self._modules: list[str] = []
        self._prepared: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._lost = 0
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
        """Have workers import these modules before they fork further jobs. A job must have imported them before."""
        self._modules = modules
        self._prepared.clear()

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
        """
        end: JobResult = self._scheduler.wait(pending.task)
        self.seconds += end.seconds
        trace = pending.builder.trace
        trace.end = end
        return trace

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
        limits = self._lease.pool.limits
        if worker not in self._prepared:
            self._prepared.add(worker)
            # A fork server that is not isolated itself must not import them; each job does.
            if self._modules and self.isolation is not Isolation.PROCESS:
                worker.preload(self._modules)
        end = worker.run(job, builder, limits, player)
        wrong = end.reason is not ExitReason.DONE or builder.trace.fault is not None
        if not wrong or not job.get("series"):
            return end
        if not end.before and end.phase != "close":
            return end
        # An earlier episode in the process may be the cause, or the cleanup after this one.
        self.series = False
        builder.restart()
        alone = worker.run({**job, "series": False}, builder, limits)
        return msgspec.structs.replace(alone, seconds=end.seconds + alone.seconds)

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
