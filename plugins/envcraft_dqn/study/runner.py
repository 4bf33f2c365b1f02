"""Run the tasks of a study on an executor.

Tasks run once, in an order that satisfies their dependencies. The result of a task is a JSON file, which is written
atomically and only by this process. A task with a result does not run again, and an interrupted training resumes from
its checkpoint. A study therefore survives the loss of any process.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from pathlib import Path

import msgspec

from envcraft.corpus.executors import ExecutorPlugin, Opened
from envcraft.errors import EnvCraftError
from envcraft_dqn.files import write_atomically
from envcraft_dqn.study.protocol import Task
from envcraft_dqn.study.worker import TaskRequest, TaskResult, run_task

#: The number of times that a task may be lost with its worker process.
_MAX_LOSSES = 3

#: Receives a result, the number of completed tasks and the number of tasks.
OnResult = Callable[[TaskResult, int, int], None]


def run(
    tasks: Sequence[Task],
    request: Callable[[Task], TaskRequest],
    folder: Path,
    plugin: ExecutorPlugin,
    workers: int | None = None,
    scheduler: str | None = None,
    on_result: OnResult = lambda result, done, total: None,
) -> dict[str, TaskResult]:
    """Run all tasks without results.

    Args:
        tasks: The tasks, each after its dependencies.
        request: Makes the request for a task.
        folder: The folder of the study.
        plugin: The executor.
        workers: The number of workers, or None for the default of the executor.
        scheduler: The address of a cluster, for the executor.
        on_result: Called for each new result.

    Returns:
        The results by the names of the tasks.

    Raises:
        EnvCraftError: A task fails. Results of other tasks are kept.
    """
    results = {task.name: result for task in tasks if (result := read(folder, task)) is not None}
    for result in results.values():
        # The process may have been killed between the result and the removal of the checkpoint.
        _remove_checkpoint(folder, result.task)
    losses: Counter[str] = Counter()
    while len(results) < len(tasks):
        with plugin.open(workers, scheduler) as opened:
            _run_on(opened, tasks, request, folder, results, losses, on_result)
    return results


def _run_on(
    opened: Opened,
    tasks: Sequence[Task],
    request: Callable[[Task], TaskRequest],
    folder: Path,
    results: dict[str, TaskResult],
    losses: Counter[str],
    on_result: OnResult,
) -> None:
    """Run tasks until all are done or the executor breaks."""
    pending: dict[Future[bytes], Task] = {}
    try:
        while len(results) < len(tasks):
            running = {task.name for task in pending.values()}
            ready = [
                task
                for task in tasks
                if task.name not in results and task.name not in running and results.keys() >= set(task.after)
            ]
            for task in ready[: max(opened.slots(), 1) - len(pending)]:
                pending[opened.executor.submit(run_task, msgspec.msgpack.encode(request(task)))] = task
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                task = pending.pop(future)
                try:
                    data = future.result()
                except (CancelledError, BrokenExecutor) as error:
                    _count_loss(task, losses)
                    if isinstance(error, BrokenExecutor):
                        raise
                    continue
                _write(folder, task, data)
                results[task.name] = msgspec.json.decode(data, type=TaskResult)
                on_result(results[task.name], len(results), len(tasks))
    except BrokenExecutor:
        for task in pending.values():
            _count_loss(task, losses)
    finally:
        for future in pending:
            future.cancel()


def _count_loss(task: Task, losses: Counter[str]) -> None:
    losses[task.name] += 1
    if losses[task.name] >= _MAX_LOSSES:
        raise EnvCraftError(
            f"the worker process of {task.name} died {_MAX_LOSSES} times; it may have run out of memory"
        )


def result_file(folder: Path, task: Task) -> Path:
    """The file of the result of a task."""
    return folder / "results" / f"{task.name}.json"


def read(folder: Path, task: Task) -> TaskResult | None:
    """The result of a task, or None. Raises EnvCraftError if the file belongs to another task or cannot be read."""
    file = result_file(folder, task)
    if not file.is_file():
        return None
    try:
        result = msgspec.json.decode(file.read_bytes(), type=TaskResult)
    except msgspec.DecodeError as error:
        raise EnvCraftError(f"{file} cannot be read ({error}); remove it to run the task again") from None
    if result.task != task:
        raise EnvCraftError(f"{file} is the result of another task; choose another --output")
    return result


def _write(folder: Path, task: Task, data: bytes) -> None:
    write_atomically(result_file(folder, task), msgspec.json.format(data, indent=1) + b"\n", sync=True)
    _remove_checkpoint(folder, task)


def _remove_checkpoint(folder: Path, task: Task) -> None:
    """Remove the checkpoint of a finished training."""
    shutil.rmtree(folder / "runs" / task.name / "checkpoint", ignore_errors=True)
