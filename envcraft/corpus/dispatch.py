"""Judge an audit on an executor: submit tasks, collect the verdicts, and resubmit lost tasks."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait

import msgspec

from envcraft.corpus import tasks
from envcraft.corpus.executors import ExecutorPlugin, Opened
from envcraft.errors import EnvCraftError, TargetLost
from envcraft.judging.engine import Plan, not_judged
from envcraft.model.events import Event, SubjectFinished, SubjectStarted
from envcraft.model.verdict import SubjectReport

#: Submitted tasks per slot. With two, a worker always has a next task, and few sources are in memory.
_EACH = 2
#: Losses after which a task is not resubmitted, because it probably kills its workers.
_LOSSES = 3
#: Consecutive failures without a verdict after which the executor counts as broken.
_FAILURES = 5
#: Seconds between two looks at the number of slots, which may grow.
_LOOK = 5.0
#: Seconds for which an executor may have no slots.
_EMPTY = 60.0

_Events = Generator[tuple[int, Event], None, None]


def stream(
    plugin: ExecutorPlugin, workers: int | None, scheduler: str | None, order: tasks.Order, plan: Plan
) -> _Events:
    """Judge every target of a plan on an executor and yield each event with the number of its subject.

    It is the counterpart of :func:`envcraft.judging.engine.stream`. Each subject starts once and finishes once, even if
    tasks are lost. Closing the iterator, or an exception such as KeyboardInterrupt, cancels the tasks that have not
    started.

    Args:
        plugin: opens the executor.
        workers: for :meth:`envcraft.corpus.executors.ExecutorPlugin.open`.
        scheduler: for :meth:`envcraft.corpus.executors.ExecutorPlugin.open`.
        order: the plan as data.
        plan: the targets and the settings.

    Raises:
        EnvCraftError: a worker rejects the order, or the executor returns no verdicts.
    """
    dispatch = _Dispatch(plugin.name, order, plan)
    while not dispatch.done:
        with plugin.open(workers, scheduler) as opened:
            yield from dispatch.on(opened)


class _Named(msgspec.Struct, frozen=True):
    """The environment of a number."""

    path: str
    env_class: str | None
    sha256: str


class _Dispatch:
    """The pending, submitted and lost tasks. It outlives an executor that breaks."""

    def __init__(self, name: str, order: tasks.Order, plan: Plan) -> None:
        self.done = False
        self._name, self._order, self._plan = name, order.to_bytes(), plan
        self._fresh = iter(range(1, len(plan.targets) + 1))
        self._again: deque[int] = deque()
        self._out: dict[Future[bytes], int] = {}
        self._started: dict[int, _Named] = {}
        self._losses: Counter[int] = Counter()
        self._verdicts = self._failures = 0
        self._empty: float | None = None

    def on(self, opened: Opened) -> _Events:
        """Judge on an executor until all is done or the executor breaks. Raises EnvCraftError."""
        try:
            broken = ""
            while not broken:
                before, trouble = self._verdicts, ""
                broken = yield from self._send(opened)
                if not self._out and not broken:
                    self.done = True
                    return
                finished, _ = wait(self._out, timeout=0 if broken else _LOOK, return_when=FIRST_COMPLETED)
                for future in finished:
                    number = self._out.pop(future)
                    try:
                        report = msgspec.json.decode(future.result(), type=SubjectReport)
                    except EnvCraftError:
                        raise
                    except CancelledError:
                        trouble = "a task was cancelled"
                        yield from self._lose(number, trouble)
                    except BrokenExecutor as error:
                        trouble = broken = _words(error)
                        yield from self._lose(number, trouble)
                    except Exception as error:
                        trouble = _words(error)
                        yield self._give_up(number, f"the executor {self._name} returned no verdict: {trouble}")
                    else:
                        self._verdicts += 1
                        named = self._started.pop(number)
                        yield number, SubjectFinished(msgspec.structs.replace(report, path=named.path))
                self._count(self._verdicts > before, trouble or broken)
            for number in list(self._out.values()):
                yield from self._lose(number, broken)
        finally:
            for future in self._out:
                future.cancel()
            self._out.clear()

    def _send(self, opened: Opened) -> Generator[tuple[int, Event], None, str]:
        """Submit tasks up to the limit. Return why the executor accepts none, or an empty string."""
        try:
            slots = opened.slots()
        except Exception as error:
            # Each engine has its own errors for a lost connection.
            return _words(error)
        self._wait_for_workers(slots)
        room = _EACH * max(slots, 1)
        while len(self._out) < room:
            number = self._again.popleft() if self._again else next(self._fresh, None)
            if number is None:
                break
            try:
                target = self._plan.targets[number - 1]
            except TargetLost as lost:
                yield from self._begin(number, _Named(lost.path, lost.env_class, lost.sha256))
                yield self._give_up(number, str(lost))
                continue
            yield from self._begin(number, _Named(target.path, target.env_class, target.sha256))
            try:
                self._out[opened.executor.submit(tasks.judge, tasks.encode(self._order, target))] = number
            except Exception as error:
                self._again.appendleft(number)
                return _words(error)
        return ""

    def _wait_for_workers(self, slots: int) -> None:
        """Raise EnvCraftError if there have been no slots for `_EMPTY` seconds."""
        if slots:
            self._empty = None
            return
        self._empty = self._empty or time.monotonic()
        if time.monotonic() - self._empty > _EMPTY:
            raise EnvCraftError(
                f"the executor {self._name} has had no worker for {_EMPTY:.0f} s: start workers, then run this again"
            )

    def _begin(self, number: int, named: _Named) -> _Events:
        """Yield the event of an environment's start, unless it was yielded before."""
        if number not in self._started:
            self._started[number] = named
            yield number, SubjectStarted(named.path, number, len(self._plan.targets))

    def _lose(self, number: int, why: str) -> _Events:
        """Queue a lost task again, unless it was lost too often."""
        self._losses[number] += 1
        if self._losses[number] < _LOSSES:
            self._again.append(number)
        else:
            yield self._give_up(number, f"the executor {self._name} lost this task {_LOSSES} times: {why}")

    def _give_up(self, number: int, reason: str) -> tuple[int, Event]:
        named = self._started.pop(number)
        return number, SubjectFinished(not_judged(self._plan, named.path, named.env_class, named.sha256, reason))

    def _count(self, verdict: bool, trouble: str) -> None:
        """Raise EnvCraftError after `_FAILURES` consecutive failures without a verdict."""
        if verdict:
            self._failures = 0
        elif trouble:
            self._failures += 1
        if self._failures >= _FAILURES:
            raise EnvCraftError(
                f"the executor {self._name} failed {_FAILURES} times in a row without a verdict, the last time with "
                f"{trouble}; the verdicts so far are kept"
            )


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
