"""Audits on an executor: lost tasks are sent again, no event comes twice, and a worker with other rules refuses."""

from __future__ import annotations

import contextlib
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any, cast

import msgspec
import pytest

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.corpus import dispatch, tasks
from envcraft.corpus.dispatch import stream
from envcraft.corpus.executors import ExecutorPlugin, Opened
from envcraft.errors import EnvCraftError, TargetLost
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.selection import checks_named, driver_named
from envcraft.judging.settings import settings_of
from envcraft.model.events import SubjectFinished, SubjectStarted
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport, Verdict

from .conftest import SETTINGS, Invoke

SLOTS = 3
#: The result of a task: its verdict, or its loss in one of the ways that executors report.
Fate = Callable[[Future[bytes], Callable[[], bytes]], None]


def verdict(future: Future[bytes], run: Callable[[], bytes]) -> None:
    try:
        future.set_result(run())
    except Exception as error:
        future.set_exception(error)


def cancelled(future: Future[bytes], run: Callable[[], bytes]) -> None:
    future.cancel()
    future.set_running_or_notify_cancel()


def killed(future: Future[bytes], run: Callable[[], bytes]) -> None:
    future.set_exception(RuntimeError("the scheduler gave it up"))


def never(future: Future[bytes], run: Callable[[], bytes]) -> None:
    """Out for good."""


class Scripted(Executor):
    """Decides the result of a task by its path and the number of its submissions."""

    def __init__(self, engine: Engine) -> None:
        self.engine, self.broken = engine, False
        self.held: list[Future[bytes]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        path = msgspec.msgpack.decode(args[0], type=tasks.Task).path
        self.engine.came[path] += 1
        if self.broken:
            raise BrokenExecutor("a worker was killed")
        future: Future[bytes] = Future()
        self.engine.out.append(future)
        self.engine.most = max(self.engine.most, sum(not out.done() for out in self.engine.out))
        if self.engine.breaks(path, self.engine.came[path]):
            self.broken = True
            for lost in [*self.held, future]:
                lost.set_exception(BrokenExecutor("a worker was killed"))
        elif (fate := self.engine.fate(path, self.engine.came[path])) is never:
            self.held.append(future)
        else:
            fate(future, lambda: fn(*args))
        return future


class Engine(ExecutorPlugin):
    name = "scripted"

    def __init__(self) -> None:
        self.came: Counter[str] = Counter()
        self.out: list[Future[bytes]] = []
        self.most = self.opened = 0
        self.slots = SLOTS
        self.fate: Callable[[str, int], Fate] = lambda path, time: verdict
        self.breaks: Callable[[str, int], bool] = lambda path, time: False

    @contextlib.contextmanager
    def open(self, workers: int | None, scheduler: str | None) -> Iterator[Opened]:
        self.opened += 1
        yield Opened(Scripted(self), lambda: self.slots)


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Engine:
    def judge(task: bytes) -> bytes:
        told = msgspec.msgpack.decode(task, type=tasks.Task)
        return msgspec.json.encode(SubjectReport(told.path, "A", "0" * 64, Verdict.PASS, "process", 0.1, 7, []))

    monkeypatch.setattr(tasks, "judge", judge)
    return Engine()


class Nowhere:
    name, isolation = "process", "process"


def events(engine: Engine, count: int) -> Iterator[tuple[int, Any]]:
    plan = Plan(
        [Target(f"e{number}", b"x") for number in range(count)], GYMNASIUM, cast(Any, Nowhere()), [], BUDGETS["quick"]
    )
    return stream(engine, None, None, tasks.Order(SETTINGS, GYMNASIUM, []), plan)


def reports(engine: Engine, count: int) -> dict[str, SubjectReport]:
    """The reports by path. Each subject starts once and finishes once, in this order."""
    started: dict[int, str] = {}
    found: dict[str, SubjectReport] = {}
    for number, event in events(engine, count):
        if isinstance(event, SubjectStarted):
            assert number not in started
            assert (event.number, event.total) == (number, count)
            started[number] = event.path
        else:
            assert isinstance(event, SubjectFinished)
            assert event.report.path == started[number]
            assert event.report.path not in found
            found[event.report.path] = event.report
    assert set(found) == {f"e{number}" for number in range(count)}
    return found


def test_an_executor_without_workers_is_not_waited_for_for_ever(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatch, "_LOOK", 0.02)
    monkeypatch.setattr(dispatch, "_EMPTY", 0.1)
    engine.fate = lambda path, time: never
    engine.slots = 0
    with pytest.raises(EnvCraftError, match="scripted has had no worker for 0 s: start workers"):
        reports(engine, 3)


def test_only_a_few_tasks_are_out_at_a_time(engine: Engine) -> None:
    held = 0
    for _, event in events(engine, 50):
        held += 1 if isinstance(event, SubjectStarted) else -1
        assert held <= 2 * SLOTS
    assert held == 0
    assert (engine.opened, set(engine.came.values())) == (1, {1})


def test_lost_tasks_are_resubmitted_and_count_once(engine: Engine) -> None:
    dice = random.Random(1)
    fates = {f"e{number}": dice.choice([verdict, verdict, cancelled]) for number in range(60)}
    engine.fate = lambda path, time: fates[path] if time == 1 else verdict
    # A pool that breaks loses its tasks.
    engine.breaks = lambda path, time: path in ("e7", "e31", "e59") and time == 1
    found = reports(engine, 60)
    assert {report.verdict for report in found.values()} == {Verdict.PASS}
    assert engine.opened == 4
    assert {path for path, time in engine.came.items() if time > 1} >= {
        *(path for path in fates if fates[path] is cancelled),
        "e7",
        "e31",
        "e59",
    }


def test_tasks_of_a_broken_pool_move_to_the_next(engine: Engine) -> None:
    engine.fate = lambda path, time: never if path in ("e1", "e2") and time == 1 else verdict
    engine.breaks = lambda path, time: path == "e3" and time == 1
    found = reports(engine, 9)
    assert {report.verdict for report in found.values()} == {Verdict.PASS}
    assert engine.came["e1"] == engine.came["e2"] == engine.came["e3"] == 2
    assert engine.came["e0"] == 1


@pytest.mark.parametrize(("fate", "times"), [(cancelled, 3), (killed, 1)])
def test_task_without_result_is_an_error_and_others_continue(engine: Engine, fate: Fate, times: int) -> None:
    engine.fate = lambda path, time: fate if path == "e4" else verdict
    found = reports(engine, 12)
    assert found.pop("e4").verdict is Verdict.ERROR
    assert {report.verdict for report in found.values()} == {Verdict.PASS}
    assert engine.came["e4"] == times


def test_an_executor_that_gives_nothing_ends_the_audit(engine: Engine) -> None:
    engine.breaks = lambda path, time: True
    with pytest.raises(EnvCraftError, match=r"scripted failed 5 times in a row without a verdict.*a worker was killed"):
        reports(engine, 100)
    assert engine.opened == 5
    engine.breaks, engine.fate = (lambda path, time: False), (lambda path, time: killed)
    with pytest.raises(EnvCraftError, match="the scheduler gave it up; the verdicts so far are kept"):
        reports(engine, 100)


def test_close_cancels_submitted_tasks(engine: Engine) -> None:
    engine.fate = lambda path, time: verdict if path == "e0" else never
    running = events(engine, 50)
    assert next(event for _, event in running if isinstance(event, SubjectFinished)).report.path == "e0"
    cast(Any, running).close()
    assert [future.cancelled() for future in engine.out] == [False, *[True] * (len(engine.out) - 1)]
    assert len(engine.out) > SLOTS


def test_a_source_that_is_gone_is_an_error_and_the_rest_goes_on(engine: Engine) -> None:
    class Gone(list[Target]):
        def __getitem__(self, at: Any) -> Any:
            if at == 1:
                raise TargetLost("e1", None, "1" * 64, "the source is gone")
            return super().__getitem__(at)

    targets = Gone(Target(f"e{number}", b"x") for number in range(3))
    plan = Plan(targets, GYMNASIUM, cast(Any, Nowhere()), [], BUDGETS["quick"])
    told = stream(engine, None, None, tasks.Order(SETTINGS, GYMNASIUM, []), plan)
    found = {event.report.path: event.report for _, event in told if isinstance(event, SubjectFinished)}
    assert [found[path].verdict.value for path in ("e0", "e1", "e2")] == ["pass", "error", "pass"]
    assert found["e1"].source_sha256 == "1" * 64
    assert "the source is gone" in found["e1"].reason


def order(**changes: Any) -> bytes:
    checks = checks_named(["source", "sandbox"])
    # Its rewards have infinite bounds, which JSON cannot represent.
    settings = settings_of(GYMNASIUM, checks, driver_named("process"), BUDGETS["quick"], 3)
    settings = msgspec.structs.replace(settings, **changes)
    return tasks.Order(settings, GYMNASIUM, [check.name for check in checks]).to_bytes()


def test_an_order_is_the_plan_again() -> None:
    plan = tasks._plan(order())
    assert plan.contract == GYMNASIUM
    assert [check.name for check in plan.checks] == ["source", "sandbox"]
    assert (plan.driver.name, plan.budget, plan.seed) == ("process", BUDGETS["quick"], 3)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rules": "0.1.0+other"}, r"rules 0\.1\.0\+\w+, not 0\.1\.0\+other"),
        ({"image": "python 2"}, "image or libraries python 3.*, not python 2"),
        ({"contract_sha256": "0" * 64}, "a contract whose digest is"),
        ({"budget": "endless"}, "there is no budget endless"),
        ({"driver": "proces"}, "did you mean process"),
    ],
)
def test_a_worker_that_would_judge_otherwise_refuses(changes: dict[str, str], words: str) -> None:
    task = tasks.encode(order(**changes), Target("a.py", b"x = 1\n"))
    with pytest.raises(EnvCraftError, match=f"the worker on .* cannot judge as this process does: .*{words}") as caught:
        tasks.judge(task)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scheduler", "tcp://10.0.0.1:8786"), "needs an executor that has a scheduler"),
        (("--executor", "dusk"), "there is no executor 'dusk'; did you mean dask?"),
        (("--executor", "dask"), "pip install 'envcraft-rl[dask]'"),
    ],
)
def test_usage_errors_are_one_line(
    invoke: Invoke, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], words: str
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    invoke("corpus", "init", "corpus")
    with open("a.py", "w") as stream:
        stream.write("import gymnasium\nclass A(gymnasium.Env):\n    pass\n")
    invoke("corpus", "add", "corpus", "a.py")
    result = invoke("audit", "corpus", "--sandbox", "process", *options)
    assert result.exit_code == 2, result.output
    assert words in result.stderr
