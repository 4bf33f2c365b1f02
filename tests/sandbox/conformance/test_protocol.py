"""Jobs that ask for their actions, and jobs that forge messages."""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from envcraft_protocol.wire import BLOCK, HEADER, STEP, VALUE, Kind

from envcraft.judging.driver import Limits, Stop, Worker
from envcraft.model.job import ExitReason
from envcraft.model.trace import Ending, diverge

Environment = Callable[..., str]


class Chooser:
    """A player who thinks for `seconds` over each action, and leaves after `steps`."""

    def __init__(self, seconds: float = 0.0, steps: int = 100) -> None:
        self._read, self._write = os.pipe()
        self._seconds = seconds
        self._steps = steps
        self._timer: threading.Timer | None = None
        self.count = 0

    def action_requested(self) -> None:
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
        assert played.end.reason is ExitReason.DONE
        assert played.trace.ending is Ending.TRUNCATED
        assert played.trace.actions == [[number % 5, 0, 1] for number in range(8)]
        assert diverge(played.trace, play(worker, environment()).trace) is None

    def test_the_players_time_is_not_the_jobs(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any, limits: Limits
    ) -> None:
        patient = msgspec.structs.replace(limits, call=0.5, job=1.5)
        ran = play(worker, environment(), player=chooser(0.7, 3), limits=patient)
        assert (ran.end.reason, ran.trace.steps) == (ExitReason.STOPPED, 3)
        assert ran.end.seconds < 1.5

    def test_a_step_that_hangs_is_ended(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        ran = play(worker, environment(step="while self.steps == 3: pass"), player=chooser())
        assert (ran.end.reason, ran.end.phase, ran.trace.steps) == (ExitReason.TIMEOUT, "step", 2)

    def test_leaving_ends_the_job(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        ran = play(worker, environment(), player=chooser(0, 2))
        assert (ran.end.reason, ran.trace.ending, len(ran.trace.actions)) == (ExitReason.STOPPED, Ending.CUT, 2)

    def test_an_exit_while_it_waits(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        ran = play(worker, environment(reset=later("os._exit(3)")), player=chooser(5.0))
        assert (ran.end.reason, ran.end.exit_code, ran.trace.steps) == (ExitReason.DIED, 3, 0)

    def test_a_flood_while_it_waits(self, worker: Worker, environment: Environment, play: Any, chooser: Any) -> None:
        flood = "[print('x' * 9999) for _ in iter(int, 1)]"
        ran = play(worker, environment(reset=later(flood)), player=chooser(5.0))
        assert (ran.end.reason, ran.trace.steps) == (ExitReason.FLOOD, 0)

    @pytest.mark.parametrize("kind", [Kind.STEPS, Kind.ASK, Kind.ACTION, Kind.TICK, Kind.END])
    def test_messages_while_it_waits_are_forged(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any, kind: Kind
    ) -> None:
        write = f"os.write(3, {_message(kind, b'{}')!r})"
        ran = play(worker, environment(reset=later(write)), player=chooser(5.0))
        assert ran.end.reason is ExitReason.FORGED
        assert (ran.trace.steps, ran.trace.actions) == (0, [])

    def test_it_gets_no_more_actions_than_there_are(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        ask = f"""
            import os
            while True:
                os.write(3, {_message(Kind.ASK, b"")!r})
                os.read(3, 99)
        """
        ran = play(worker, environment(reset=ask), player=chooser())
        assert (ran.end.reason, ran.end.detail) == (ExitReason.FORGED, "an action that was not requested")

    def test_only_a_played_job_asks(self, worker: Worker, environment: Environment, play: Any) -> None:
        ran = play(worker, environment(top="import os", step=f"os.write(3, {_message(Kind.ASK, b'')!r})"))
        assert ran.end.reason is ExitReason.FORGED

    def test_it_does_not_choose_for_the_player(
        self, worker: Worker, environment: Environment, play: Any, chooser: Any
    ) -> None:
        write = f"os.write(3, {_message(Kind.ACTION, b'[0, 0, 0]')!r})"
        ran = play(worker, environment(top="import os", step=write), player=chooser())
        assert ran.end.reason is ExitReason.FORGED
        assert ran.trace.chosen == [[0, 0, 1]]


def _message(kind: int, payload: bytes) -> bytes:
    return HEADER.pack(kind, len(payload)) + payload


class TestForgery:
    @pytest.mark.parametrize(
        "forged",
        [
            b"\xff" * 64,
            _message(99, b""),
            HEADER.pack(Kind.STEPS, 2**31),
            _message(Kind.STEPS, b"short"),
            _message(Kind.STEPS, BLOCK.pack(1, 0) + STEP.pack(0, 0, 0, 0, 0.0, 0, 999, 0, 0)),
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
        assert ran.end.reason is ExitReason.FORGED

    def test_it_is_noticed_before_the_reset(self, worker: Worker, environment: Environment, play: Any) -> None:
        layout = _message(Kind.LAYOUT, b'{"k": "float"}')
        forged = layout + _message(Kind.RENDER, VALUE.pack(0, 0) + struct.pack("<d", 1.0))
        ran = play(worker, environment(top=f"import os; os.write(3, {forged!r})"))
        assert ran.end.reason is ExitReason.FORGED

    def test_more_steps_than_actions_are_not_believed(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        layout = _message(Kind.LAYOUT, b'{"k": "float"}')
        step = _message(Kind.STEPS, BLOCK.pack(1, 0) + STEP.pack(0, 0, 0, 4, 1.0, 0, 1, 8, 0) + bytes(8))
        ran = play(worker, environment(step=f"import os; os.write(3, {layout!r} + {step!r} * 1000)"))
        assert ran.end.reason is ExitReason.FORGED

    def test_a_forged_goodbye_keeps_nobody_waiting(self, worker: Worker, environment: Environment, play: Any) -> None:
        goodbye = _message(Kind.END, b"{}")
        ran = play(worker, environment(step=f"import os; os.write(3, {goodbye!r})\nwhile True: pass"))
        assert ran.end.reason is ExitReason.FORGED
        assert ran.end.seconds < 3
        assert not ran.trace.ended

    def test_a_goodbye_after_the_episode_keeps_nobody_waiting(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        goodbye = _message(Kind.END, b"{}")
        source = environment(top=f"import os\ndef last(self):\n    os.write(3, {goodbye!r})\n    while True: pass")
        ran = play(worker, source + "    close = last\n")
        assert ran.end.reason is ExitReason.DONE
        assert ran.end.seconds < 3
        assert ran.trace.ended
