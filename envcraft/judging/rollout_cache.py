"""The traces and search outcomes of one subject: each request runs once, and may run before a check needs it."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

import msgspec

from envcraft.errors import EnvCraftError, Skip
from envcraft.judging.budget import Budget
from envcraft.judging.coverage import Coverage
from envcraft.judging.driver import Player
from envcraft.judging.job_builder import JobBuilder
from envcraft.judging.job_runner import JobRunner, PendingRollout
from envcraft.judging.trace_builder import MeasuredTraceBuilder, TraceBuilder
from envcraft.model.job import ExitReason, SearchOutcome
from envcraft.model.rollout import Conditions, Rollout, Search
from envcraft.model.trace import Trace

#: After this many jobs that went wrong in the same way, no more are started.
_ENOUGH = 3
#: The ways to go wrong that settle the finding, in words.
_TROUBLES = {
    ExitReason.TIMEOUT: "hung",
    ExitReason.DIED: "died",
    ExitReason.FORGED: "broke the protocol",
    ExitReason.FLOOD: "printed more than the limit",
    ExitReason.MEMORY: "used more memory than the limit",
    ExitReason.PROCESSES: "started more processes or threads than the limit",
    ExitReason.DISK: "wrote more than the limit",
}


class RolloutCache:
    """Runs rollouts and searches, and keeps their results.

    A rollout counts when a check requests it, whenever it ran. So nothing that a check sees depends on which job ends
    first, or on how many run at a time. Methods that run something raise WorkerLost when the sandbox itself fails, and
    Skip when the subject has used up its time or has gone wrong in the same way too often.

    Args:
        jobs: makes the jobs.
        runner: runs them.
        budget: how much the validation spends.
        coverage: learns what each request reaches.

    Attributes:
        steps: environment steps of every kind in what was requested: of episodes, of those before and beside them,
            and of searches.
        on_steps: called with `steps` when they have grown, once for each episode or search.
    """

    def __init__(self, jobs: JobBuilder, runner: JobRunner, budget: Budget, coverage: Coverage) -> None:
        self.steps = 0
        self.on_steps: Callable[[int], None] | None = None
        self._jobs = jobs
        self._runner = runner
        self._budget = budget
        self._coverage = coverage
        self._troubles: Counter[ExitReason] = Counter()
        self._policy_troubles = 0
        self._enough = _ENOUGH
        #: How the first trace reads long frames. All others must do the same, or their digests differ.
        self._columns: bool | None = None
        self._traces: dict[bytes, Trace] = {}
        self._searches: dict[bytes, SearchOutcome] = {}
        self._pending: dict[tuple[bytes, bool], PendingRollout] = {}
        #: Rollouts that are compared bit by bit, and those that may have run after others in their process.
        self._compared: set[bytes] = set()
        self._followed: set[bytes] = set()
        #: Traces of plain rollouts by their seed, and the prefixes of these that were requested.
        self._plain: dict[int, list[Trace]] = {}
        self._prefixes: dict[tuple[bytes, bytes], Trace] = {}

    @property
    def traces(self) -> list[Trace]:
        """Every trace so far, in the order of the requests."""
        return list(self._traces.values())

    @property
    def steps_left(self) -> int:
        """The environment steps that the budget has left, negative if more were requested."""
        return self._budget.steps - self.steps

    def prefetch(self, requests: Iterable[Rollout | Search], again: bool = False, alone: bool = False) -> None:
        """Start requests that are nearly sure to come, in this order, and return at once. A request that never comes
        counts nowhere.

        Args:
            requests: rollouts and searches.
            again: :meth:`rerun` will request them.
            alone: nothing runs before the rollout in its process, because it is compared with others bit by bit.
        """
        if self._settled or self._runner.time_limit.over:
            return
        for request in requests:
            key = (request.key(), again)
            if alone:
                self._compared.add(key[0])
            known = not again and (key[0] in self._traces or key[0] in self._searches)
            if alone and key[0] in self._followed:
                known = False
            if not known and not again and isinstance(request, Rollout):
                known = self._shared(request, alone) is not None
            if not known and key not in self._pending:
                self._pending[key] = self._start(request, again, alone=again)

    def cancel_pending(self) -> None:
        """Remove the prefetched requests from the queue that have not started."""
        self._pending = {key: pending for key, pending in self._pending.items() if not self._runner.cancel(pending)}

    @contextlib.contextmanager
    def patient(self, troubles: int) -> Iterator[None]:
        """Start jobs although others went wrong, until so many more have gone wrong in the same way."""
        self._enough = max(self._troubles.values(), default=0) + troubles
        try:
            yield
        finally:
            self._enough = _ENOUGH

    def clear_traces(self) -> None:
        """Forget the traces so far, to save memory when thousands of episodes are played once."""
        self._traces.clear()
        self._plain.clear()
        self._prefixes.clear()

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        """Run a rollout, or give its known trace; `alone` as in :meth:`prefetch`.

        A plain rollout is known when a longer one with the same seed and actions is, or a shorter one that ended.
        """
        key = rollout.key()
        if alone:
            self._compared.add(key)
            if key in self._followed:
                self._followed.remove(key)
                self._forget(key, rollout.seed)
        if key not in self._traces:
            if (shared := self._shared(rollout, alone)) is not None:
                return shared
            self._traces[key] = trace = self._record(rollout)
            if _is_plain(rollout) and trace.usable:
                self._plain.setdefault(rollout.seed, []).append(trace)
        return self._traces[key]

    def _forget(self, key: bytes, seed: int) -> None:
        trace = self._traces.pop(key, None)
        self._plain[seed] = [other for other in self._plain.get(seed, []) if other is not trace]

    def _shared(self, rollout: Rollout, alone: bool) -> Trace | None:
        """The trace of a plain rollout as a part of another trace; None if there is none."""
        if rollout.conditions != Conditions() or not _is_plain(rollout):
            return None
        for trace in self._plain.get(rollout.seed, ()):
            if alone and trace.rollout.key() in self._followed:
                continue
            steps = len(rollout.actions)
            if trace.rollout.actions[:steps] != rollout.actions[: len(trace.rollout.actions)]:
                continue
            if trace.steps >= steps or trace.ended:
                key = trace.rollout.key(), rollout.key()
                if key not in self._prefixes:
                    self._prefixes[key] = trace.prefix(rollout)
                return self._prefixes[key]
        return None

    def rollouts(self, rollouts: Sequence[Rollout]) -> list[Trace]:
        """Run several rollouts at a time."""
        self.prefetch(rollouts)
        return [self.rollout(rollout) for rollout in rollouts]

    def rerun(self, rollout: Rollout, alone: bool = True) -> Trace:
        """Run a rollout even if its trace is known, a fresh one in a worker of its own.

        Without `alone` it may follow others in a process: a difference must then be confirmed.
        """
        return self._record(rollout, again=True, alone=alone)

    def measured(self, rollout: Rollout, seconds: float) -> Trace:
        """Run a rollout for some seconds in a process that ends with it, and measure it.

        Args:
            rollout: the request.
            seconds: the step that is under way then is the last one.

        Returns:
            A trace that may be shorter than the rollout. Its end says how much processor time the steps used, and how
            many calls waited.
        """
        self._refuse()
        trace = self._runner.retry(lambda: self._result(self._start(rollout, again=True, measured=seconds)))
        if self._note(trace):
            trace = self._look_closer(rollout, trace, again=True)
            self._traces.setdefault(rollout.key(), trace)
        self._count(trace)
        return trace

    def search(self, search: Search) -> SearchOutcome:
        """Run a search, or give its known outcome."""
        key = search.key()
        if key not in self._searches:
            trace = self._request(search)
            self._searches[key] = trace.result or {}
            self._count(trace)
        return self._searches[key]

    # Interactive episodes

    def start(self, rollout: Rollout, player: Player, kind: type[TraceBuilder] = TraceBuilder) -> PendingRollout:
        """Start an episode whose actions `player` chooses, and return at once."""
        return self._start(rollout, player=player, kind=kind)

    def finish(self, pending: PendingRollout) -> Trace:
        """Wait for the end of such an episode, and keep its trace as that of the same actions from a list."""
        trace = self._result(pending)
        trace.rollout = msgspec.structs.replace(trace.rollout, actions=trace.actions, interactive=False, max_steps=0)
        self._count(trace)
        if trace.columns in (None, self._columns):
            self._traces[trace.rollout.key()] = trace
        return trace

    def discard(self, pending: PendingRollout) -> None:
        """Count the steps and the time of such an episode after its end, without keeping its trace."""
        if pending.task.future.exception() is None:
            self._runner.result(pending)
        self._count(pending.builder.trace)

    def _record(self, rollout: Rollout, again: bool = False, alone: bool = False) -> Trace:
        trace = self._request(rollout, again, alone)
        if self._columns is None:
            self._columns = trace.columns
        elif trace.columns is (not self._columns):
            trace = self._runner.retry(lambda: self._result(self._start(rollout, again, alone=alone)))
        trace = self._look_closer(rollout, trace, again)
        self._count(trace)
        return trace

    def _look_closer(self, rollout: Rollout, trace: Trace, again: bool) -> Trace:
        """Run a rollout that died or hung again, and send each step at once instead of in batches: that shows how far
        the episode came. Of hangs only the first call that misses its deadline runs again.
        """
        end = trace.end
        hung = end is not None and end.reason is ExitReason.TIMEOUT
        if end is None or not (end.reason is ExitReason.DIED or (hung and self._troubles[end.reason] == 1)):
            return trace
        if not end.whole:
            slow = self._runner.retry(lambda: self._result(self._start(rollout, again, every_step=True)))
            if slow.end is not None and slow.end.reason is end.reason:
                trace = slow
            elif slow.end is not None and hung and slow.end.reason is ExitReason.DONE:
                # The machine missed the first deadline, not the program.
                self._troubles[end.reason] -= 1
                return slow
        if hung:
            self._runner.hurry()
        return trace

    def _count(self, trace: Trace) -> None:
        """Count the steps that a job reports; of one that does not come to report, those that its trace shows."""
        if trace.end is not None:
            self._coverage.add(trace.end.reached)
        shown = trace.steps + (trace.earlier.steps if trace.earlier is not None else 0)
        shown += sum(earlier.steps for earlier in trace.before)
        self.steps += max(trace.end.steps if trace.end is not None else 0, shown)
        if self.on_steps is not None:
            self.on_steps(self.steps)

    @property
    def _settled(self) -> str:
        """Why no more jobs are started although there is time; empty if they are."""
        for reason, times in self._troubles.items():
            if times >= self._enough:
                words = f"{times} episodes or searches {_TROUBLES[reason]}"
                return f"{words}: see sandbox{', or difficulty for the policy' if self._policy_troubles else ''}"
        return ""

    def _refuse(self) -> None:
        """Raise Skip if no more jobs are started."""
        if settled := self._settled:
            raise Skip(settled)
        if self._runner.time_limit.over:
            raise self._runner.time_limit.skip()

    def _note(self, trace: Trace) -> bool:
        """Count how a job went wrong, if it did."""
        reason = trace.end.reason if trace.end is not None else ExitReason.DONE
        if reason not in _TROUBLES and trace.fault is not None and trace.fault.limit is not None:
            reason = trace.fault.limit
        wrong = reason in _TROUBLES
        self._troubles[reason] += wrong
        self._policy_troubles += wrong and trace.rollout.policy
        if self._settled:
            self.cancel_pending()
        return wrong

    def _request(self, request: Rollout | Search, again: bool = False, alone: bool = False) -> Trace:
        """Wait for what a check requests. All that depends on the order of requests happens here."""
        self._refuse()
        key = (request.key(), again)

        def attempt() -> Trace:
            pending = self._pending.pop(key) if key in self._pending else self._start(request, again, alone=alone)
            return self._result(pending)

        trace = self._runner.retry(attempt)
        if isinstance(request, Rollout):
            # The prefetched rollout may have had another player's name.
            trace.rollout = request
        self._note(trace)
        return trace

    def _result(self, pending: PendingRollout) -> Trace:
        try:
            return self._runner.result(pending)
        except EnvCraftError:
            # The sandbox failed, and would fail for the prefetched jobs, too.
            self.cancel_pending()
            raise

    def _start(
        self,
        request: Rollout | Search,
        again: bool = False,
        *,
        alone: bool = False,
        every_step: bool = False,
        measured: float | None = None,
        player: Player | None = None,
        kind: type[TraceBuilder] = TraceBuilder,
    ) -> PendingRollout:
        if isinstance(request, Search):
            # An exhaustive search is a proof, so nothing may have run before it.
            return self._runner.submit(*self._jobs.search(request, self._runner.series and request.kind != "exhaust"))
        series = self._runner.series and not (every_step or measured or request.live) and request.conditions.passing
        new_process = series and (alone or (not again and request.key() in self._compared))
        if series and not again and not new_process:
            self._followed.add(request.key())
        prepared = self._jobs.rollout(
            request,
            again=again,
            series=series,
            new_process=new_process,
            every_step=every_step,
            measured=measured,
            columns=self._columns,
            kind=MeasuredTraceBuilder if measured else kind,
        )
        return self._runner.submit(*prepared, player)


def _is_plain(rollout: Rollout) -> bool:
    """Whether a trace of the rollout says all about the same episode with fewer actions."""
    plain = rollout.conditions in (Conditions(), Conditions(after_end=rollout.conditions.after_end))
    return plain and not (rollout.live or rollout.keep or rollout.fields)
