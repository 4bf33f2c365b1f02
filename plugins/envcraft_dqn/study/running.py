"""Doing the tasks of a study on an executor: each once, in an order that its dependencies allow, whatever is killed.

A result is one file of JSON, which is there whole or not at all; what has one is not done again. Only this process
writes them. A training that was interrupted goes on from its own checkpoint.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from pathlib import Path

import msgspec

from envcraft.errors import EnvCraftError
from envcraft.executors import ExecutorPlugin, Opened
from envcraft_dqn.study import work
from envcraft_dqn.study.protocol import Task

#: A task that is lost with its worker so often is given up.
_LOSSES = 3

Tell = Callable[[work.Result, int, int], None]


def run(
    tasks: Sequence[Task],
    order: Callable[[Task], work.Order],
    folder: Path,
    plugin: ExecutorPlugin,
    workers: int | None = None,
    scheduler: str | None = None,
    tell: Tell = lambda result, done, total: None,
) -> dict[str, work.Result]:
    """Do all `tasks`, and give their results by name; `tell` is told each that comes, and how many there are.

    Raises EnvCraftError where one fails; the results of the others are kept.
    """
    found = {task.name: result for task in tasks if (result := read(folder, task)) is not None}
    for result in found.values():
        # Its process may have been killed before it came to this.
        _let_go(folder, result.task)
    losses: Counter[str] = Counter()
    while len(found) < len(tasks):
        with plugin.open(workers, scheduler) as opened:
            _spread(tasks, order, folder, opened, found, losses, tell)
    return found


def _spread(
    tasks: Sequence[Task],
    order: Callable[[Task], work.Order],
    folder: Path,
    opened: Opened,
    found: dict[str, work.Result],
    losses: Counter[str],
    tell: Tell,
) -> None:
    """Go on with an executor: to the end, or until it takes no more."""
    out: dict[Future[bytes], Task] = {}
    try:
        while len(found) < len(tasks):
            running = {task.name for task in out.values()}
            ready = [
                task
                for task in tasks
                if task.name not in found and task.name not in running and found.keys() >= set(task.after)
            ]
            for task in ready[: max(opened.slots(), 1) - len(out)]:
                out[opened.executor.submit(work.perform, msgspec.msgpack.encode(order(task)))] = task
            finished, _ = wait(out, return_when=FIRST_COMPLETED)
            for future in finished:
                task = out.pop(future)
                try:
                    data = future.result()
                except (CancelledError, BrokenExecutor) as error:
                    _lose(task, losses)
                    if isinstance(error, BrokenExecutor):
                        raise
                    continue
                _write(folder, task, data)
                found[task.name] = msgspec.json.decode(data, type=work.Result)
                tell(found[task.name], len(found), len(tasks))
    except BrokenExecutor:
        for task in out.values():
            _lose(task, losses)
    finally:
        for future in out:
            future.cancel()


def _lose(task: Task, losses: Counter[str]) -> None:
    losses[task.name] += 1
    if losses[task.name] >= _LOSSES:
        raise EnvCraftError(
            f"{task.name} was lost {_LOSSES} times with the process that did it: is there memory enough?"
        )


def place(folder: Path, task: Task) -> Path:
    """The file of a task's result."""
    return folder / "results" / f"{task.name}.json"


def read(folder: Path, task: Task) -> work.Result | None:
    """A task's result; None where there is none. Raises EnvCraftError where it is none of this task."""
    file = place(folder, task)
    if not file.is_file():
        return None
    try:
        result = msgspec.json.decode(file.read_bytes(), type=work.Result)
    except msgspec.DecodeError as error:
        raise EnvCraftError(f"{file} cannot be read ({error}); remove it, and the task is done again") from None
    if result.task != task:
        raise EnvCraftError(f"{file} is the result of another task; choose another --output")
    return result


def _write(folder: Path, task: Task, data: bytes) -> None:
    """Keep a result, there whole or not at all."""
    file = place(folder, task)
    file.parent.mkdir(parents=True, exist_ok=True)
    new = file.with_suffix(".new")
    with open(new, "wb") as stream:
        stream.write(msgspec.json.format(data, indent=1) + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(new, file)
    _let_go(folder, task)


def _let_go(folder: Path, task: Task) -> None:
    """Remove what only an interrupted training needs."""
    shutil.rmtree(folder / "runs" / task.name / "checkpoint", ignore_errors=True)
