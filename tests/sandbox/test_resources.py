"""What the worker measures between episodes is exact where the machine allows it."""

from __future__ import annotations

import gc
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest
from envcraft_protocol.wire import RESOURCES
from envcraft_sandbox.worker.resources import Lines, Resources

from envcraft.model.trace import Resources as Used


@pytest.fixture
def resources(tmp_path: Path) -> Iterator[Resources]:
    # The garbage of other tests must not be collected between two measurements, and their objects take long to visit.
    gc.collect()
    gc.freeze()
    yield Resources(str(tmp_path), 256)
    gc.unfreeze()


def used(resources: Resources) -> Used:
    return Used(*RESOURCES.unpack(resources.measure(0)))


def test_measuring_leaves_nothing_behind(resources: Resources) -> None:
    first, *_, last = [used(resources) for _ in range(20)]
    assert last.held - first.held < 10_000
    assert last.blocks - first.blocks < 100
    assert (last.threads, last.descriptors, last.files) == (first.threads, first.descriptors, 0)


def test_what_is_kept_is_counted_and_garbage_is_not(resources: Resources) -> None:
    class Node:
        def __init__(self) -> None:
            self.itself = self
            self.data = bytearray(1 << 20)

    before = used(resources)
    kept = [bytearray(1 << 20) for _ in range(4)]
    small = [(number, str(number)) for number in range(1_000)]
    for _ in range(8):
        Node()
    after = used(resources)
    assert len(kept) == 4
    assert len(small) == 1_000
    assert 4 << 20 <= after.held - before.held < 5 << 20
    assert 2_000 <= after.blocks - before.blocks < 4_000


def test_threads_files_and_queues_are_counted(tmp_path: Path) -> None:
    # In a process of its own: garbage and threads of other tests may close files at any time.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        before, after = pool.submit(around_a_thread_a_file_and_a_queue, tmp_path).result()
    assert (after.threads - before.threads, after.descriptors - before.descriptors) == (1, 1)
    assert (after.files, after.written) == (1, 50)
    assert after.queued - before.queued == 7


def around_a_thread_a_file_and_a_queue(folder: Path) -> tuple[Used, Used]:
    """What is measured before and while they are open."""
    resources = Resources(str(folder), 256)
    before = used(resources)
    release = threading.Event()
    thread = threading.Thread(target=release.wait)
    thread.start()
    queue = deque(range(7), maxlen=9)
    (folder / "inner").mkdir()
    (folder / "inner" / "log").write_bytes(bytes(50))
    descriptor = os.open(folder / "inner" / "log", os.O_RDONLY)
    after = used(resources)
    assert queue
    release.set()
    thread.join()
    os.close(descriptor)
    return before, after


def test_lines_are_those_that_run() -> None:
    def loop(times: int) -> None:
        for _ in range(times):
            pass

    counts = []
    for times in (10, 10, 30):
        lines = Lines()
        with lines:
            loop(times)
        counts.append(lines.count)
    assert counts[0] == counts[1]
    assert counts[2] - counts[0] == 40
