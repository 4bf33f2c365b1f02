"""Nothing of a job, or of a killed host, remains."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from envcraft_sandbox.zygote import ZygoteDriver

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Driver, Limits, Worker

#: Gives the process the name TOKEN, as /proc shows it on the host too.
_NAME_ITSELF = """
    import ctypes
    ctypes.CDLL(None).prctl(15, b"TOKEN", 0, 0, 0)
"""

Environment = Callable[..., str]


class TestNothingRemains:
    def test_a_job_starts_no_process(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os, subprocess, sys
            answers = []
            for start in (
                os.fork,
                lambda: os.posix_spawn(sys.executable, ["python"], {}),
                lambda: os.execv(sys.executable, ["python"]),
                lambda: subprocess.run([sys.executable, "-c", "pass"]),
            ):
                try:
                    started = start()
                    if started == 0:
                        os._exit(0)
                    answers.append("started")
                except OSError as error:
                    answers.append(type(error).__name__)
            print(json.dumps(answers))
            """
        )
        assert play(worker, source).facts == [
            "BlockingIOError",
            "BlockingIOError",
            "PermissionError",
            "FileNotFoundError",
        ]

    def test_what_a_job_wrote_ends_with_it(self, worker: Worker, environment: Environment, play: Any) -> None:
        write = """
            import json, os, tempfile
            before = os.listdir(".")
            os.makedirs("a/" * 500)
            for number in range(3):
                os.mkdir(f"a/closed{number}", 0)
            open("a/file", "w").write("x")
            os.symlink("/", "a/link")
            same = [os.path.samefile(".", path) for path in (tempfile.gettempdir(), os.environ["HOME"])]
            print(json.dumps([before, *same]))
            """
        for _ in range(2):
            assert play(worker, environment(top=write)).facts == [[], True, True]

    def test_close_ends_the_worker_and_its_job(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any, token: str
    ) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        patient = msgspec.structs.replace(limits, call=60.0)
        source = environment(step=_NAME_ITSELF.replace("TOKEN", token) + "\n    while True: pass")

        def run() -> None:
            with pytest.raises((WorkerLost, OSError, ValueError)):
                play(worker, source, limits=patient)

        thread = threading.Thread(target=run)
        thread.start()
        (job,) = _wait_for(token)
        server = _parent(job)
        assert _alive(server)
        worker.close()
        worker.close()
        thread.join(timeout=240)
        assert not thread.is_alive()
        assert _gone(job)
        assert _gone(server)
        with pytest.raises(WorkerLost):
            play(worker, environment())

    @pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM], ids=lambda how: how.name)
    def test_the_worker_ends_with_its_host(
        self, driver: Driver, environment: Environment, token: str, how: signal.Signals, tmp_path: Path
    ) -> None:
        source = tmp_path / "tiny.py"
        source.write_text(environment(step=_NAME_ITSELF.replace("TOKEN", token) + "\n    while True: pass"))
        launched, how_launched = (driver._driver, "zygotes") if isinstance(driver, ZygoteDriver) else (driver, "")
        named = [type(launched).__module__, type(launched).__name__, how_launched]
        host = subprocess.Popen(
            [sys.executable, "-c", _HOST, *named, str(source)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            stderr=subprocess.DEVNULL,
        )
        (job,) = _wait_for(token)
        server = _parent(job)
        host.send_signal(how)
        host.wait(timeout=240)
        assert _gone(job)
        assert _gone(server)


#: A program that runs one job without end.
_HOST = """
import importlib, signal, sys
from envcraft.model.rollout import Rollout
from envcraft.judging.driver import Limits
from envcraft.judging.trace_builder import TraceBuilder

signal.signal(signal.SIGINT, signal.default_int_handler)
limits = Limits(call=60.0)
driver = getattr(importlib.import_module(sys.argv[1]), sys.argv[2])()
worker = (driver.shared_layout() if sys.argv[3] else driver).launch(hash_seed=0, limits=limits)
target = {"kind": "source", "source": open(sys.argv[4]).read(), "filename": "tiny.py"}
job = {"kind": "rollout", "target": target, "contract": {}, "seed": 0, "actions": [[0, 0, 0]]}
worker.run(job, TraceBuilder(Rollout(0, [[0, 0, 0]]), None, None), limits)
"""


def _processes(token: str) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "comm").read_text().strip() == token:
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def _wait_for(token: str) -> list[int]:
    deadline = time.monotonic() + 60
    while not (found := _processes(token)) and time.monotonic() < deadline:
        time.sleep(0.02)
    return found


def _parent(pid: int) -> int:
    (line,) = [line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("PPid:")]
    return int(line.split()[1])


def _alive(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def _gone(pid: int) -> bool:
    deadline = time.monotonic() + 60
    while _alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not _alive(pid)
