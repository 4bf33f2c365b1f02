"""The judging of an audit on an executor: tasks go out a few at a time, verdicts come back, lost tasks go out again."""

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

#: Tasks out for each that can run: a worker that has done one finds the next, and no more sources are held than these.
_EACH = 2
#: A task that is lost so often is given up: most likely it is what ends the workers.
_LOSSES = 3
#: After so many failures without a verdict in between, it is not the environments.
_FAILURES = 5
#: Seconds after which an executor is looked at again: it may have more workers than it had.
_LOOK = 5.0
#: Seconds for which an executor may have nobody to run a task.
_EMPTY = 60.0

_Events = Generator[tuple[int, Event], None, None]


def stream(
    plugin: ExecutorPlugin, workers: int | None, scheduler: str | None, order: tasks.Order, plan: Plan
) -> _Events:
    """Judge every target of `plan` on an executor, as :func:`envcraft.judging.engine.stream` does in this process;
    `order` is the same plan as data. Each subject starts once and finishes once, even if tasks are lost.

    Closing the iterator, or an exception such as KeyboardInterrupt, takes back what has not begun.

    Raises EnvCraftError where a worker refuses the order, or the executor gives no verdicts.
    """
    dispatch = _Dispatch(plugin.name, order, plan)
    while not dispatch.done:
        with plugin.open(workers, scheduler) as opened:
            yield from dispatch.on(opened)


class _Named(msgspec.Struct, frozen=True):
    """Which environment a number stands for."""

    path: str
    env_class: str | None
    sha256: str


class _Dispatch:
    """What is to be judged, what is out, and what was lost, beyond the end of one executor."""

    def __init__(self, name: str, order: tasks.Order, plan: Plan) -> None:
        self.done = False
        self._name, self._order, self._plan = name, order.to_bytes(), plan
        self._fresh = iter(range(1, len(plan.targets) + 1))
        self._again: deque[int] = deque()
        self._out: dict[Future[bytes], int] = {}
        self._begun: dict[int, _Named] = {}
        self._losses: Counter[int] = Counter()
        self._verdicts = self._failures = 0
        self._empty: float | None = None

    def on(self, opened: Opened) -> _Events:
        """Go on with an executor: to the end, or until it takes no more. Raises EnvCraftError."""
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
                        yield self._give_up(number, f"no verdict came back from the executor {self._name}: {trouble}")
                    else:
                        self._verdicts += 1
                        named = self._begun.pop(number)
                        yield number, SubjectFinished(msgspec.structs.replace(report, path=named.path))
                self._count(self._verdicts > before, trouble or broken)
            for number in list(self._out.values()):
                yield from self._lose(number, broken)
        finally:
            for future in self._out:
                future.cancel()
            self._out.clear()

    def _send(self, opened: Opened) -> Generator[tuple[int, Event], None, str]:
        """Have as many tasks out as can run, and some; give why the executor takes none, if so."""
        try:
            slots = opened.slots()
        except Exception as error:
            # Engines have errors of their own for being gone.
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
        """Raises EnvCraftError where there have been none for too long."""
        if slots:
            self._empty = None
            return
        self._empty = self._empty or time.monotonic()
        if time.monotonic() - self._empty > _EMPTY:
            raise EnvCraftError(
                f"the executor {self._name} has had no worker for {_EMPTY:.0f} s: start some, and run this again"
            )

    def _begin(self, number: int, named: _Named) -> _Events:
        """Tell of an environment's turn, the first time."""
        if number not in self._begun:
            self._begun[number] = named
            yield number, SubjectStarted(named.path, number, len(self._plan.targets))

    def _lose(self, number: int, why: str) -> _Events:
        """Send a task again, unless it was lost too often."""
        self._losses[number] += 1
        if self._losses[number] < _LOSSES:
            self._again.append(number)
        else:
            yield self._give_up(number, f"the executor {self._name} lost it {_LOSSES} times: {why}")

    def _give_up(self, number: int, reason: str) -> tuple[int, Event]:
        named = self._begun.pop(number)
        return number, SubjectFinished(not_judged(self._plan, named.path, named.env_class, named.sha256, reason))

    def _count(self, verdict: bool, trouble: str) -> None:
        """Raises EnvCraftError where there has been nothing but trouble for too long."""
        if verdict:
            self._failures = 0
        elif trouble:
            self._failures += 1
        if self._failures >= _FAILURES:
            raise EnvCraftError(
                f"the executor {self._name} failed {_FAILURES} times and gave no verdict in between, the last time by "
                f"{trouble}; what was judged is kept"
            )


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
