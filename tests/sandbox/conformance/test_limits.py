"""Jobs that want too much."""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import Any

import msgspec

from envcraft.judging.driver import Limits, Worker
from envcraft.model.job import ExitReason

Environment = Callable[..., str]


class TestLimits:
    def test_memory(self, worker: Worker, environment: Environment, play: Any, limits: Limits) -> None:
        patient = msgspec.structs.replace(limits, call=10.0)
        ran = play(worker, environment(step="kept = []\nwhile True: kept.append(bytearray(1 << 24))"), limits=patient)
        assert ran.end.reason is ExitReason.DIED or (ran.trace.fault is not None and ran.trace.fault.memory)

    def test_memory_that_is_shared_counts_too(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        source = environment(
            step="""
            import mmap, time
            kept = []
            while True:
                kept.append(mmap.mmap(-1, 1 << 24))
                kept[-1].write(bytes(1 << 24))
                time.sleep(0.001)
            """
        )
        ran = play(worker, source, limits=msgspec.structs.replace(limits, call=10.0))
        assert ran.end.reason is ExitReason.MEMORY
        assert ran.end.detail == "more than 512 MiB of memory"

    def test_threads(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            step="""
            import threading, time
            while True:
                threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
            """
        )
        ran = play(worker, source)
        assert ran.end.reason is ExitReason.PROCESSES or "can't start new thread" in ran.trace.fault.message

    def test_files_in_all(self, worker: Worker, environment: Environment, play: Any, limits: Limits) -> None:
        source = environment(
            step="""
            import time
            number = 0
            while True:
                with open(f"{number}", "wb") as file:
                    file.write(bytes(1 << 20))
                time.sleep(0.002)
                number += 1
            """
        )
        ran = play(worker, source, limits=msgspec.structs.replace(limits, call=10.0, disk=40 * 1024**2))
        # A file system of the sandbox's own may be full before.
        assert ran.end.reason is ExitReason.DISK or ran.trace.fault.errno == errno.ENOSPC

    def test_file_size(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os, tempfile
            with tempfile.TemporaryFile() as file:
                try:
                    for _ in range(64):
                        file.write(bytes(1 << 16))
                        file.flush()
                except OSError:
                    pass
                print(json.dumps(os.fstat(file.fileno()).st_size))
                file.truncate(0)
            """
        )
        assert play(worker, source).facts == 1024**2

    def test_descriptors(self, worker: Worker, environment: Environment, play: Any, limits: Limits) -> None:
        source = environment(
            top="""
            import json, os
            opened = []
            try:
                while len(opened) < 4096:
                    opened.append(os.open(os.devnull, os.O_RDONLY))
            except OSError:
                pass
            print(json.dumps(opened[-1]))
            for each in opened:
                os.close(each)
            """
        )
        assert play(worker, source).facts == limits.descriptors - 1

    def test_a_job_starts_with_four_descriptors(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            opened = []
            for number in range(1024):
                try:
                    os.fstat(number)
                except OSError:
                    continue
                opened.append(number)
            print(json.dumps(opened))
            """
        )
        assert play(worker, source).facts == [0, 1, 2, 3]
