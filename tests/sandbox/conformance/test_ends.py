"""Jobs that hang, and jobs that die."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from envcraft.judging.driver import Limits, Worker
from envcraft.model.job import ExitReason

Environment = Callable[..., str]


class TestDeadlines:
    @pytest.mark.parametrize("phase", ["import", "reset", "step"])
    def test_a_hang_is_a_timeout_in_its_phase(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits, phase: str
    ) -> None:
        source = environment(**{"top" if phase == "import" else phase: "while True: pass"})
        ran = play(worker, source)
        deadline = limits.loading if phase == "import" else limits.call
        assert ran.end.reason is ExitReason.TIMEOUT
        assert ran.end.phase == phase
        assert deadline <= ran.end.seconds < deadline + 10
        assert ran.end.stack == (
            source.splitlines().index("while True: pass".rjust(16 if phase == "import" else 24)) + 1,
        )

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
        assert play(worker, source).end.reason is ExitReason.TIMEOUT

    def test_slow_steps_end_with_the_whole_job(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        short = msgspec.structs.replace(limits, job=1.5)
        ran = play(worker, environment(step="import time; time.sleep(0.4)"), limits=short)
        assert ran.end.reason is ExitReason.TIMEOUT
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
        assert ran.end.reason is ExitReason.DIED
        assert ran.end.phase == ("import" if phase == "top" else "step")
        assert (ran.end.signal, ran.end.exit_code) == (signal_number, exit_code)
        assert bool(ran.end.stack) == (signal_number in (signal.SIGSEGV, signal.SIGABRT))

    def test_a_job_without_descriptors_is_ended(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(step="import os; os.closerange(0, 256)\nwhile True: pass"))
        assert ran.end.reason is ExitReason.DIED
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
        assert play(worker, source).end.reason is ExitReason.DONE
