"""One suite for every driver: whatever a job does costs that job its end, and nothing else."""

from __future__ import annotations

import errno
import os
import secrets
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import msgspec
import pytest
from envcraft_sandbox.bubblewrap import BubblewrapDriver
from envcraft_sandbox.docker import DockerDriver
from envcraft_sandbox.process import ProcessDriver
from envcraft_sandbox.wire import HEADER, Kind

from envcraft.errors import WorkerLost
from envcraft.sandbox import Driver, How, Isolation, Limits, Stop, Worker
from envcraft.trace import Ending, diverge

#: ``ENVCRAFT_CONFORMANCE_DRIVER=package.module:Class`` asks another driver in place of the built-in ones.
NAMED = os.environ.get("ENVCRAFT_CONFORMANCE_DRIVER")
DRIVERS = (
    [pytest.param(resolve_name(NAMED), id=NAMED)]
    if NAMED
    else [
        pytest.param(DockerDriver, marks=pytest.mark.docker, id="docker"),
        pytest.param(BubblewrapDriver, marks=pytest.mark.bubblewrap, id="bubblewrap"),
        pytest.param(ProcessDriver, id="process"),
    ]
)

#: Gives the process the name TOKEN, as /proc shows it on the host too.
_NAME_ITSELF = """
    import ctypes
    ctypes.CDLL(None).prctl(15, b"TOKEN", 0, 0, 0)
"""

Environment = Callable[..., str]


@pytest.fixture(scope="module", params=DRIVERS)
def driver(request: pytest.FixtureRequest) -> Iterator[Driver]:
    made: Driver = request.param()
    available = made.probe()
    if not available.works:
        (pytest.fail if NAMED else pytest.skip)(f"{available.reason}; {available.fix}")
    yield made
    made.close()


@pytest.fixture(scope="module")
def isolating(driver: Driver) -> Driver:
    """The driver where it has namespaces."""
    if driver.isolation is Isolation.PROCESS:
        pytest.skip("isolation by process shares the machine's files, network and processes")
    return driver


@pytest.fixture(scope="module")
def worker(driver: Driver, limits: Limits) -> Iterator[Worker]:
    """One worker for the whole suite: it must outlive all that the jobs do."""
    made = driver.launch(hash_seed=0, limits=limits)
    yield made
    made.close()


@pytest.fixture
def token() -> str:
    return "ec" + secrets.token_hex(6)


@pytest.fixture(autouse=True)
def _serves_the_next_job(request: pytest.FixtureRequest, environment: Environment, play: Any) -> Iterator[None]:
    """After every test, the shared worker runs an ordinary job as if nothing had been."""
    yield
    if "worker" in request.fixturenames:
        ran = play(request.getfixturevalue("worker"), environment())
        assert ran.end.how is How.DONE
        assert ran.trace.steps == 8
        assert ran.end.output == ""


class TestOrdinaryJobs:
    def test_a_rollout_gives_its_whole_trace(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment())
        assert ran.end.how is How.DONE
        assert ran.trace.ending is Ending.TRUNCATED
        assert len(ran.trace.observations) == 9
        assert ran.trace.rewards == [0.0, 1.0, 2.0, 3.0, 4.0, 0.0, 1.0, 2.0]
        assert ran.trace.info() == {"steps": 8}
        assert ran.trace.problems == []

    def test_the_seed_alone_decides_the_trace(self, worker: Worker, environment: Environment, play: Any) -> None:
        first, again, other = (play(worker, environment(), seed=seed).trace for seed in (3, 3, 4))
        assert first.observations == again.observations
        assert first.observations != other.observations

    def test_a_description_names_the_class(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(), kind="describe")
        assert ran.description["class"] == "Tiny"
        assert ran.description["action_space"]["nvec"] == [5, 2, 2]

    def test_an_exception_is_a_fault(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(step="if self.steps == 3: raise SystemExit('enough')"))
        assert ran.end.how is How.DONE
        assert ran.trace.steps == 2
        assert (ran.trace.fault.type, ran.trace.fault.step) == ("SystemExit", 3)

    def test_modules_are_found_and_preloaded(self, worker: Worker) -> None:
        missing, known = worker.find(["numpy", "math", "nunpy"])
        assert missing == ["nunpy"]
        assert "numpy" in known
        assert worker.preload(["gymnasium.spaces", "nunpy"]) == ["gymnasium.spaces"]

    def test_many_jobs_leave_no_descriptor_open(self, worker: Worker, environment: Environment, play: Any) -> None:
        before = len(os.listdir("/proc/self/fd"))
        for seed in range(20):
            assert play(worker, environment(), seed=seed).trace.steps == 8
        assert len(os.listdir("/proc/self/fd")) == before


class Chooser:
    """A player who thinks for `seconds` over each action, and leaves after `steps`."""

    def __init__(self, seconds: float = 0.0, steps: int = 100) -> None:
        self._read, self._write = os.pipe()
        self._seconds = seconds
        self._steps = steps
        self._timer: threading.Timer | None = None
        self.count = 0

    def asked(self) -> None:
        self._timer = threading.Timer(self._seconds, os.write, (self._write, b"."))
        self._timer.start()

    def fileno(self) -> int:
        return self._read

    def take(self) -> list[int]:
        os.read(self._read, 1)
        if self.count == self._steps:
            raise Stop
        self.count += 1
        return [(self.count - 1) % 5, 0, 1]

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()
        os.close(self._read)
        os.close(self._write)


@pytest.fixture
def chooser() -> Iterator[Callable[..., Chooser]]:
    made: list[Chooser] = []

    def make(*arguments: Any) -> Chooser:
        made.append(Chooser(*arguments))
        return made[-1]

    yield make
    for player in made:
        player.close()


def later(statement: str) -> str:
    """Lines for reset() that run a statement a moment after the job has asked for its first action."""
    return f"""
        import os, threading
        threading.Timer(0.3, lambda: {statement}).start()
    """


class TestPlayedJobs:
    def test_the_trace_is_that_of_the_same_actions_from_a_list(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        played = play(worker, environment(), player=chooser())
        assert played.end.how is How.DONE
        assert played.trace.ending is Ending.TRUNCATED
        assert played.trace.actions == [[number % 5, 0, 1] for number in range(8)]
        assert diverge(played.trace, play(worker, environment()).trace) is None

    def test_the_players_time_is_not_the_jobs(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any, limits: Limits
    ) -> None:
        patient = msgspec.structs.replace(limits, call=0.5, job=1.5)
        ran = play(worker, environment(), player=chooser(0.7, 3), limits=patient)
        assert (ran.end.how, ran.trace.steps) == (How.STOPPED, 3)
        assert ran.end.seconds < 1.5

    def test_a_step_that_hangs_is_ended(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        ran = play(worker, environment(step="while self.steps == 3: pass"), player=chooser())
        assert (ran.end.how, ran.end.phase, ran.trace.steps) == (How.TIMEOUT, "step", 2)

    def test_leaving_ends_the_job(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        ran = play(worker, environment(), player=chooser(0, 2))
        assert (ran.end.how, ran.trace.ending, len(ran.trace.actions)) == (How.STOPPED, Ending.CUT, 2)

    def test_an_exit_while_it_waits(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        ran = play(worker, environment(reset=later("os._exit(3)")), player=chooser(5.0))
        assert (ran.end.how, ran.end.exit_code, ran.trace.steps) == (How.DIED, 3, 0)

    def test_a_flood_while_it_waits(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        flood = "[print('x' * 9999) for _ in iter(int, 1)]"
        ran = play(worker, environment(reset=later(flood)), player=chooser(5.0))
        assert (ran.end.how, ran.trace.steps) == (How.FLOOD, 0)

    @pytest.mark.parametrize("kind", [Kind.STEP, Kind.ASK, Kind.ACTION, Kind.TICK, Kind.END])
    def test_messages_while_it_waits_are_forged(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any, kind: Kind
    ) -> None:
        write = f"os.write(3, {_message(kind, b'{}')!r})"
        ran = play(worker, environment(reset=later(write)), player=chooser(5.0))
        assert ran.end.how is How.FORGED
        assert (ran.trace.steps, ran.trace.actions) == (0, [])

    def test_only_a_played_job_asks(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(top="import os", step=f"os.write(3, {_message(Kind.ASK, b'')!r})"))
        assert ran.end.how is How.FORGED

    def test_it_does_not_choose_for_the_player(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        write = f"os.write(3, {_message(Kind.ACTION, b'[0, 0, 0]')!r})"
        ran = play(worker, environment(top="import os", step=write), player=chooser())
        assert ran.end.how is How.FORGED
        assert ran.trace.chosen == [[0, 0, 1]]


class TestOutput:
    def test_it_is_captured_up_to_the_limit(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        ran = play(worker, environment(step="print('x' * 999)"))
        assert ran.end.how is How.DONE
        assert ran.end.output_bytes == 8000
        assert len(ran.end.output) == limits.output

    def test_it_is_never_parsed(self, worker: Worker, environment: Environment, play: Any) -> None:
        message = HEADER.pack(Kind.END, 2) + b"{}"
        ran = play(worker, environment(step=f"import os; os.write(1, {message!r}); os.write(2, {message!r})"))
        assert ran.trace.steps == 8
        assert ran.end.output.count("{}") == 16

    def test_what_was_not_flushed_is_not_lost(self, worker: Worker, environment: Environment, play: Any) -> None:
        assert play(worker, environment(step="print('.', end='')")).end.output == "." * 8

    @pytest.mark.parametrize(
        "lines", ["while True: print('x' * 100)", "import os\nwhile True: os.write(2, b'x' * 4096)"]
    )
    def test_a_flood_ends_the_job(self, worker: Worker, environment: Environment, play: Any, lines: str) -> None:
        ran = play(worker, environment(step=lines))
        assert ran.end.how is How.FLOOD
        assert ran.end.phase == "step"


class TestDeadlines:
    @pytest.mark.parametrize("phase", ["import", "reset", "step"])
    def test_a_hang_is_a_timeout_in_its_phase(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits, phase: str
    ) -> None:
        source = environment(**{"top" if phase == "import" else phase: "while True: pass"})
        ran = play(worker, source)
        deadline = limits.loading if phase == "import" else limits.call
        assert ran.end.how is How.TIMEOUT
        assert ran.end.phase == phase
        assert deadline <= ran.end.seconds < deadline + 1

    def test_a_hang_that_refuses_signals_ends_too(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            step="""
            import signal, time
            signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 65))
            while True:
                try:
                    time.sleep(1)
                except BaseException:
                    pass
            """
        )
        assert play(worker, source).end.how is How.TIMEOUT

    def test_slow_steps_end_with_the_whole_job(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        short = msgspec.structs.replace(limits, job=1.5)
        ran = play(worker, environment(step="import time; time.sleep(0.4)"), limits=short)
        assert ran.end.how is How.TIMEOUT
        assert "whole job" in ran.end.detail
        assert 1 <= ran.trace.steps <= 4


class TestDeaths:
    @pytest.mark.parametrize(
        ("lines", "signal_number", "exit_code"),
        [
            ("import os; os._exit(7)", None, 7),
            ("import os; os._exit(0)", None, 0),
            ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", signal.SIGKILL, None),
            ("import ctypes; ctypes.string_at(0)", signal.SIGSEGV, None),
            ("import os; os.abort()", signal.SIGABRT, None),
        ],
        ids=["exit", "exit with 0", "SIGKILL", "SIGSEGV", "SIGABRT"],
    )
    @pytest.mark.parametrize("phase", ["top", "step"])
    def test_the_end_tells_how(
        self,
        worker: Worker,
        environment: Environment,
        play: Any,
        phase: str,
        lines: str,
        signal_number: int | None,
        exit_code: int | None,
    ) -> None:
        ran = play(worker, environment(**{phase: lines}))
        assert ran.end.how is How.DIED
        assert ran.end.phase == ("import" if phase == "top" else "step")
        assert (ran.end.signal, ran.end.exit_code) == (signal_number, exit_code)

    def test_a_job_without_descriptors_is_ended(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(step="import os; os.closerange(0, 256)\nwhile True: pass"))
        assert ran.end.how is How.DIED
        assert ran.end.seconds < 3

    def test_the_fork_server_outlives_its_job(self, worker: Worker, environment: Environment, play: Any) -> None:
        # The guard is for the machine that runs this test, should the sandbox be none.
        source = environment(
            step="""
            import os, signal
            try:
                os.kill(os.getppid(), 0)
                guarded = os.getppid() != 1
            except PermissionError:
                guarded = False
            for number in () if guarded else signal.valid_signals() - {signal.SIGCHLD}:
                for target in (os.getppid(), 1, -1, 0):
                    try:
                        os.kill(target, number)
                    except OSError:
                        pass
            """
        )
        assert play(worker, source).end.how is How.DONE


class TestLimits:
    def test_memory(self, worker: Worker, environment: Environment, play: Any, limits: Limits) -> None:
        patient = msgspec.structs.replace(limits, call=10.0)
        ran = play(worker, environment(step="kept = []\nwhile True: kept.append(bytearray(1 << 24))"), limits=patient)
        assert ran.end.how is How.DIED or (ran.trace.fault is not None and ran.trace.fault.memory)

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
        assert ran.end.how is How.MEMORY
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
        assert ran.end.how is How.PROCESSES or "can't start new thread" in ran.trace.fault.message

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
        assert ran.end.how is How.DISK or ran.trace.fault.errno == errno.ENOSPC

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


def _message(kind: int, payload: bytes) -> bytes:
    return HEADER.pack(kind, len(payload)) + payload


class TestForgery:
    @pytest.mark.parametrize(
        "forged",
        [
            b"\xff" * 64,
            _message(99, b""),
            HEADER.pack(Kind.STEP, 2**31),
            _message(Kind.STEP, b"short"),
            _message(Kind.STEP, struct.pack("<BBBBdIHII", 0, 0, 0, 0, 0.0, 0, 999, 0, 0)),
            _message(Kind.LAYOUT, b"{}"),
            _message(Kind.LAYOUT, b'{"k": "array", "dtype": "O", "shape": [1]}'),
            _message(Kind.LAYOUT, b'{"k": "array", "dtype": "u1", "shape": [-1]}'),
            _message(Kind.LAYOUT, b'{"k": "array", "dtype": 7, "shape": "x"}'),
            _message(Kind.LAYOUT, b"[" * 100_000),
            _message(Kind.PHASE, b"\xff"),
            _message(Kind.FAULT, b"[]"),
        ],
        ids=[
            "noise", "kind", "length", "short step", "unknown layout", "empty layout", "objects", "negative shape",
            "wrong types", "deep", "no text", "no object",
        ],
    )  # fmt: skip
    def test_it_is_noticed(self, worker: Worker, environment: Environment, play: Any, forged: bytes) -> None:
        ran = play(
            worker, environment(step=f"import os; os.write(3, {forged[:70_000]!r}); os.write(3, {forged[70_000:]!r})")
        )
        assert ran.end.how is How.FORGED

    @pytest.mark.parametrize("kind", [Kind.RENDER, Kind.REREAD], ids=lambda kind: kind.name)
    def test_it_is_noticed_before_the_reset(
        self, worker: Worker, environment: Environment, play: Any, kind: Kind
    ) -> None:
        layout = _message(Kind.LAYOUT, b'{"k": "float"}')
        forged = layout + _message(kind, struct.pack("<Hd", 0, 1.0))
        ran = play(worker, environment(top=f"import os; os.write(3, {forged!r})"))
        assert ran.end.how is How.FORGED

    def test_more_steps_than_actions_are_not_believed(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        layout = _message(Kind.LAYOUT, b'{"k": "float"}')
        step = _message(Kind.STEP, struct.pack("<BBBBdIHII", 0, 0, 0, 4, 1.0, 0, 1, 8, 0) + bytes(8))
        ran = play(worker, environment(step=f"import os; os.write(3, {layout!r} + {step!r} * 1000)"))
        assert ran.end.how is How.FORGED

    def test_a_forged_goodbye_keeps_nobody_waiting(self, worker: Worker, environment: Environment, play: Any) -> None:
        goodbye = _message(Kind.END, b"{}")
        ran = play(worker, environment(step=f"import os; os.write(3, {goodbye!r})\nwhile True: pass"))
        assert ran.end.how is How.FORGED
        assert ran.end.seconds < 3
        assert not ran.trace.ended

    def test_a_goodbye_after_the_episode_keeps_nobody_waiting(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        goodbye = _message(Kind.END, b"{}")
        source = environment(top=f"import os\ndef last(self):\n    os.write(3, {goodbye!r})\n    while True: pass")
        ran = play(worker, source + "    close = last\n")
        assert ran.end.how is How.DONE
        assert ran.end.seconds < 3
        assert ran.trace.ended


class TestConditions:
    def test_the_environment_variables_are_scrubbed(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("ENVCRAFT_SECRET", "canary")
        source = environment(top="import json, os; print(json.dumps(dict(os.environ)))")
        worker = driver.launch(hash_seed=0, limits=limits)
        try:
            found = play(worker, source).facts
        finally:
            worker.close()
        assert "canary" not in found.values()
        assert os.environ["PATH"] not in found.values() or driver.name == "docker"
        proxies = {name for name in found if name.lower().endswith("_proxy")}
        assert {found[name] for name in proxies} <= {""}
        assert found.keys() - proxies <= {
            "PATH", "HOME", "TMPDIR", "LANG", "LC_CTYPE", "PWD", "HOSTNAME", "OPENBLAS_NUM_THREADS",
            "OMP_NUM_THREADS", "MKL_NUM_THREADS", "SDL_VIDEODRIVER", "SDL_AUDIODRIVER", "PYGAME_HIDE_SUPPORT_PROMPT",
            "PYTHONPATH", "PYTHONHASHSEED", "PYTHONDONTWRITEBYTECODE", "PYTHONNOUSERSITE",
            "PYTHONSAFEPATH", "PYTHONUNBUFFERED",
        }  # fmt: skip

    def test_the_hash_seed_is_honoured(
        self, driver: Driver, limits: Limits, environment: Environment, play: Any
    ) -> None:
        hashes = []
        for seed in (5, 5, 6):
            worker = driver.launch(hash_seed=seed, limits=limits)
            try:
                assert worker.about["hash_seed"] == str(seed)
                hashes.append(play(worker, environment(top="print(hash('a'))")).facts)
            finally:
                worker.close()
        assert hashes[0] == hashes[1] != hashes[2]

    def test_workers_are_independent(
        self, driver: Driver, limits: Limits, worker: Worker, environment: Environment, play: Any
    ) -> None:
        other = driver.launch(hash_seed=0, limits=limits)
        hung: list[Any] = []
        thread = threading.Thread(target=lambda: hung.append(play(other, environment(step="while True: pass"))))
        thread.start()
        assert play(worker, environment()).trace.steps == 8
        thread.join()
        assert hung[0].end.how is How.TIMEOUT
        other.close()
        assert play(worker, environment()).trace.steps == 8


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
        thread.join(timeout=10)
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
        host = subprocess.Popen(
            [sys.executable, "-c", _HOST, type(driver).__module__, type(driver).__name__, str(source)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            stderr=subprocess.DEVNULL,
        )
        (job,) = _wait_for(token)
        server = _parent(job)
        host.send_signal(how)
        host.wait(timeout=10)
        assert _gone(job)
        assert _gone(server)


#: A program that runs one job without end.
_HOST = """
import importlib, signal, sys
from envcraft.rollout import Rollout
from envcraft.sandbox import Limits
from envcraft.trace import Recording

signal.signal(signal.SIGINT, signal.default_int_handler)
limits = Limits(call=60.0)
worker = getattr(importlib.import_module(sys.argv[1]), sys.argv[2])().launch(hash_seed=0, limits=limits)
target = {"kind": "source", "source": open(sys.argv[3]).read(), "filename": "tiny.py"}
job = {"kind": "rollout", "target": target, "contract": {}, "seed": 0, "actions": [[0, 0, 0]]}
worker.run(job, Recording(Rollout(0, [[0, 0, 0]]), None, None), limits)
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
    deadline = time.monotonic() + 15
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
    deadline = time.monotonic() + 5
    while _alive(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not _alive(pid)


class TestIsolation:
    """What a job cannot reach. The kernel's own layers hold in every driver, where it has them."""

    def test_no_network_is_reached(
        self, worker: Worker, environment: Environment, play: Any, token: str, tmp_path: Path
    ) -> None:
        path = str(tmp_path / "socket")
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as abstract,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as named,
        ):
            abstract.bind(f"\0{token}")
            named.bind(path)
            for each in (server, abstract, named):
                each.setblocking(False)
            addresses = [server.getsockname(), ("192.0.2.1", 80), f"\0{token}", path]
            source = environment(
                top=f"""
                import json, socket
                reached = []
                for address in {addresses!r}:
                    family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
                    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                        try:
                            with socket.socket(family, kind) as client:
                                client.settimeout(0.5)
                                client.connect(address)
                            reached.append(address)
                        except OSError:
                            pass
                    # A socket that needs no address of its own may still send to one.
                    for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM):
                        try:
                            end.sendto(b"hello", address)
                            reached.append(address)
                        except (OSError, TypeError):
                            pass
                print(json.dumps(reached))
                """
            )
            assert play(worker, source).facts == []
            for each in (abstract, named):
                with pytest.raises(BlockingIOError):
                    each.recv(16)
            with pytest.raises(BlockingIOError):
                server.accept()

    def test_files_of_the_host_cannot_be_read(
        self, worker: Worker, environment: Environment, play: Any, tmp_path: Path
    ) -> None:
        secret = tmp_path / "secret"
        secret.write_text("canary")
        tmp_path.chmod(0o755)
        paths = [
            str(secret),
            "/etc/shadow",
            "/etc/passwd",
            "/var/run/docker.sock",
            "/run/docker.sock",
            "/proc/1/environ",
        ]
        paths += [str(path) for path in Path.home().iterdir() if path.is_file()]
        source = environment(
            top=f"""
            import json, os
            readable = []
            for path in {paths!r}:
                try:
                    os.close(os.open(path, os.O_RDONLY))
                    readable.append(path)
                except OSError:
                    pass
            print(json.dumps(readable))
            """
        )
        assert play(worker, source).facts == []

    def test_only_the_own_folder_is_writable(
        self, worker: Worker, environment: Environment, play: Any, tmp_path: Path
    ) -> None:
        source = environment(
            top=f"""
            import json, os, sys
            import numpy
            written = []
            folders = ["/", "/usr", "/etc", "/var", "/run", "/run/envcraft", "/opt", "/opt/envcraft", "/home", "/root"]
            folders += ["/proc", "/proc/sys/kernel", "/sys", "/tmp", "/var/tmp", "/dev/shm", "/dev/mqueue"]
            folders += [{str(tmp_path)!r}, sys.prefix, *sys.path, os.path.dirname(numpy.__file__)]
            for folder in [*folders, "."]:
                for attempt in (
                    lambda: open(os.path.join(folder, "envcraft-test"), "x").close(),
                    lambda: os.mkdir(os.path.join(folder, "envcraft-folder")),
                    lambda: os.chmod(folder, 0o755),
                    lambda: os.utime(folder),
                ):
                    try:
                        attempt()
                        written.append(folder)
                    except OSError:
                        pass
            print(json.dumps(written))
            """
        )
        assert play(worker, source).facts == [".", "."]

    def test_tmp_is_bounded(self, isolating: Driver, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            size = os.statvfs(".")
            print(json.dumps(size.f_blocks * size.f_frsize))
            """
        )
        assert play(worker, source).facts == 64 * 1024**2

    def test_the_job_has_no_privileges(
        self, driver: Driver, worker: Worker, environment: Environment, play: Any
    ) -> None:
        source = environment(
            top="""
            import ctypes, json, os, struct
            libc = ctypes.CDLL(None, use_errno=True)
            held = ctypes.create_string_buffer(24)
            libc.capget(struct.pack("<Ii", 0x20080522, 0), held)
            print(json.dumps({
                "ids": [os.getuid(), os.geteuid(), os.getgid(), *os.getgroups()],
                "capabilities": list(struct.unpack("<6I", held)),
                "no new privileges": libc.prctl(39, 0, 0, 0, 0),
                "mount": libc.mount(b"none", b"/tmp", b"tmpfs", 0, None),
                "user namespace": libc.unshare(0x10000000),
                "chroot": libc.chroot(b"/tmp"),
                "setuid": libc.setuid(12345),
                "ptrace": libc.ptrace(16, os.getppid(), 0, 0),
                "io_uring": libc.syscall(425, 1, ctypes.create_string_buffer(120)),
                "memfd": libc.syscall(319, b"x", 0),
                "limits of another": libc.prlimit(os.getppid(), 7, ctypes.create_string_buffer(16), None),
            }))
            """
        )
        found = play(worker, source).facts
        ids = set(found.pop("ids"))
        assert ids == {65534} or driver.isolation is Isolation.PROCESS
        assert set(found.pop("capabilities")) == {0}
        assert found.pop("no new privileges") == 1
        assert set(found.values()) == {-1}

    def test_other_processes_cannot_be_seen(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            opened = []
            for who in ("self", "1", str(os.getppid()), str(os.getpid())):
                own = who in ("self", str(os.getpid()))
                for name in ("", "mem", "environ", "maps", "cmdline", "root/tmp", *(() if own else ("fd/0", "cwd/."))):
                    try:
                        os.close(os.open(f"/proc/{who}/{name}", os.O_RDONLY))
                        opened.append(name)
                    except OSError:
                        pass
            print(json.dumps(opened))
            """
        )
        assert play(worker, source).facts == []
