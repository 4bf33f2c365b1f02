"""The host's end of a fork server: send it jobs, enforce their deadlines, and end jobs that do not end."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import threading
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
from envcraft_protocol.jobs import Job, Request
from envcraft_protocol.wire import HEADER, MAX_MESSAGE, Kind

from envcraft.errors import EnvCraftError, MalformedValue, WorkerLost
from envcraft.judging.driver import Limits, Player, Recorder, Stop, Worker
from envcraft.model.job import ExitReason, JobResult

from .reader import Forged, Reader
from .stack import Stack

_CHUNK, _PIECE = 1 << 20, 1 << 16
_SERVER_SECONDS = 60.0
_GOODBYE_SECONDS = 1.0
#: Patience with a job that is to write its stack, with its next lines, and with one that floods its output.
_STACK_SECONDS = 0.5
_STACK_PAUSE = 0.05
_FLOOD_PAUSE = 0.05
_LOADING = ("start", "import", "construct", "policy")
#: Number of jobs of a series that one process runs.
_SERIES = 64


class Ended(NamedTuple):
    """The end of a job's process: wait status, seconds of processor time, the limit for which it was ended."""

    status: int
    cpu: float
    over: ExitReason | None


@dataclass
class _Process:
    """A job's process as the host sees it.

    Attributes:
        number: its number at the fork server.
        data: its data socket.
        output: the pipe for its output.
        done: number of jobs it has completed.
    """

    number: int
    data: socket.socket
    output: int
    done: int = 0

    def close(self) -> None:
        self.data.close()
        if self.output >= 0:
            os.close(self.output)
            self.output = -1


class ForkServerWorker(Worker):
    """A worker reached over a connected stream socket. Drivers add how it starts and ends."""

    def __init__(self, control: socket.socket, limits: Limits) -> None:
        """Wait until the fork server on `control` reports that it is ready. Raises WorkerLost."""
        self._control = control
        self._received = b""
        self._jobs = 0
        self._limits = limits
        self._waits: _Process | None = None
        self._closed = False
        self._taking = threading.Lock()
        self.about = self._reply("ready")["ready"]

    def preload(self, modules: list[str]) -> list[str]:
        self._send({"op": "preload", "modules": modules})
        loaded: list[str] = self._reply("preloaded")["preloaded"]
        return loaded

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        self._send({"op": "find", "modules": modules})
        answer = self._reply("missing")
        return answer["missing"], answer["known"]

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        process = self._take()
        if process is not None and (job.get("new_process") or not job.get("series")):
            self._dismiss(process)
            process = None
        if process is None:
            process = self._start(limits)
        series = bool(job.get("series")) and process.done + 1 < _SERIES
        job = {**job, "series": series}
        try:
            process.data.settimeout(limits.loading)
            payload = json.dumps(job).encode()
            if len(payload) > MAX_MESSAGE:
                words = f"a job has {len(payload)} bytes, and a worker accepts {MAX_MESSAGE}"
                raise EnvCraftError(f"{words}: the source or the actions of an episode are too long; make them smaller")
            # The exit status explains why a child died before it read the job.
            with contextlib.suppress(OSError):
                process.data.sendall(HEADER.pack(0, len(payload)) + payload)
            process.data.setblocking(False)
            watch = _Watch(self, process, recorder, limits, player, series, job)
            end = watch.run()
            process.done += 1
            if watch.reusable:
                with self._taking:
                    if not self._closed:
                        self._waits, process = process, None
            return end
        finally:
            if process is not None:
                process.close()

    def close(self) -> None:
        hang_up(self._control)
        with self._taking:
            self._closed = True
        process = self._take()
        if process is not None:
            process.close()

    def _take(self) -> _Process | None:
        """Take the process that waits for another job, if there is one. No other thread gets it."""
        with self._taking:
            process, self._waits = self._waits, None
        return process

    def _start(self, limits: Limits) -> _Process:
        """Let the fork server fork a process for a job."""
        self._jobs += 1
        ours, theirs = socket.socketpair()
        output, output_end = os.pipe()
        process = _Process(self._jobs, ours, output)
        try:
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                ours.setsockopt(socket.SOL_SOCKET, option, _CHUNK)
                theirs.setsockopt(socket.SOL_SOCKET, option, _CHUNK)
            message: Request = {"op": "job", "id": process.number, "limits": msgspec.to_builtins(limits)}
            self._send(message, [theirs.fileno(), output_end])
        except BaseException:
            process.close()
            raise
        finally:
            theirs.close()
            os.close(output_end)
        return process

    def _dismiss(self, process: _Process) -> None:
        """End a process that waits for another job. Raises WorkerLost."""
        process.close()
        if self.ended(process.number, _GOODBYE_SECONDS) is None:
            self.kill(process.number)
            self.ended(process.number)

    def kill(self, number: int) -> None:
        """Request the end of a job's processes."""
        self._send({"op": "kill", "id": number})

    def dump(self, number: int) -> None:
        """Request that a job writes its stack to its output."""
        self._send({"op": "dump", "id": number})

    def ended(self, number: int, patience: float = _SERVER_SECONDS) -> Ended | None:
        """Wait for the end of a job's process; None if it still runs after `patience` seconds. Raises WorkerLost."""
        deadline = time.monotonic() + patience
        while True:
            answer = self._answer("exit", deadline)
            if answer is None:
                return None
            if answer["exit"] == number:
                return Ended(answer["status"], answer["cpu"], ExitReason(answer["over"]) if answer["over"] else None)

    def _send(self, message: Request, descriptors: list[int] | None = None) -> None:
        data = json.dumps(message).encode() + b"\n"
        try:
            if descriptors:
                sent = socket.send_fds(self._control, [data], descriptors)
                data = data[sent:]
            self._control.sendall(data)
        except OSError as error:
            raise WorkerLost(f"the worker is gone ({error.strerror}); run again, or see `envcraft doctor`") from None

    def _reply(self, key: str) -> dict[str, Any]:
        answer = self._answer(key, time.monotonic() + _SERVER_SECONDS)
        if answer is None:
            raise WorkerLost(f"the worker was silent for {_SERVER_SECONDS:.0f} s; run again, or see `envcraft doctor`")
        return answer

    def _answer(self, key: str, deadline: float) -> dict[str, Any] | None:
        """The next answer that has `key`; None if there is none before the deadline. Raises WorkerLost."""
        while True:
            line, found, rest = self._received.partition(b"\n")
            if found:
                self._received = rest
                answer = _decode(line)
                if key in answer:
                    return answer
                continue
            remaining = max(deadline - time.monotonic(), 0)
            if not select.select([self._control], [], [], remaining)[0]:
                return None
            try:
                data = self._control.recv(1 << 16)
            except OSError:
                data = b""
            if not data or len(self._received) > MAX_MESSAGE:
                raise WorkerLost("the worker closed the connection; run again, or see `envcraft doctor`")
            self._received += data


def hang_up(control: socket.socket) -> None:
    """Close a control socket for all processes that have a copy of it."""
    with contextlib.suppress(OSError):
        control.shutdown(socket.SHUT_RDWR)
    control.close()


def _decode(line: bytes) -> dict[str, Any]:
    try:
        answer = json.loads(line)
    except ValueError:
        answer = None
    if not isinstance(answer, dict):
        raise WorkerLost("the worker broke its protocol; run again, or see `envcraft doctor`")
    return answer


class _Watch:
    """Watches one running job."""

    def __init__(
        self,
        worker: ForkServerWorker,
        process: _Process,
        recorder: Recorder,
        limits: Limits,
        player: Player | None,
        series: bool,
        job: Job,
    ) -> None:
        self._worker = worker
        self._number = process.number
        self._data = process.data
        self._output = process.output
        self._before = process.done
        self._series = series
        #: Whether the process waits for another job now.
        self.reusable = False
        self._limits = limits
        self._recorder = recorder
        self._player = player
        self._reader = Reader(recorder, played=player is not None, marks=len(job.get("marks", ())))
        self._stack = Stack(job["target"])
        self._started = time.monotonic()
        #: When the job began to wait for the player, and actions that the player has sent already.
        self._waiting: float | None = None
        self._given: list[Any] = []
        self._head = bytearray()
        #: Whether the output is that of the job, not its stack.
        self._own = True
        self._printed = 0

    def run(self) -> JobResult:
        try:
            how, detail = self._listen()
        except BaseException:
            self._worker.kill(self._number)
            raise
        self._resume()
        if how is ExitReason.DONE and self._series and self._reader.reusable:
            self.reusable = True
            self._drain()
            os.set_blocking(self._output, True)
            return self._end(how)
        if how in (ExitReason.TIMEOUT, ExitReason.FLOOD):
            self._dump(_FLOOD_PAUSE if how is ExitReason.FLOOD else 0.0)
        died = how is ExitReason.DIED
        # A job that reported its end or closed its channel may still run.
        patience = _GOODBYE_SECONDS if how in (ExitReason.DONE, ExitReason.DIED) else 0
        ended = self._worker.ended(self._number, patience)
        if ended is None:
            self._worker.kill(self._number)
            ended = self._worker.ended(self._number)
            if died:
                died, detail = False, "it closed its channel and continued to run"
        if ended is None:
            raise WorkerLost("the worker does not end its job; run again, or see `envcraft doctor`")
        if ended.over is not None and how is not ExitReason.DONE:
            how, died, detail = ended.over, False, self._limit(ended.over)
        self._drain()
        status = ended.status
        if died and os.WIFSIGNALED(status):
            self._head = bytearray(self._stack.take(bytes(self._head)))
        return msgspec.structs.replace(
            self._end(how),
            signal=os.WTERMSIG(status) if died and os.WIFSIGNALED(status) else None,
            exit_code=os.WEXITSTATUS(status) if died and os.WIFEXITED(status) else None,
            detail=detail or (_signal_name(status) if died else ""),
            cpu=ended.cpu,
        )

    def _end(self, how: ExitReason) -> JobResult:
        """The end of a job, as far as it is known without that of its process."""
        return JobResult(
            reason=how,
            phase=self._reader.phase,
            seconds=time.monotonic() - self._started,
            output=self._head.decode("utf-8", "replace"),
            output_bytes=self._printed,
            before=self._before,
            steps=self._reader.steps,
            waits=self._reader.waits,
            busy=self._reader.busy / 1e6,
            reached=self._reader.reached,
            stack=self._stack.lines,
        )

    def _limit(self, how: ExitReason) -> str:
        limits = self._limits
        return {
            ExitReason.MEMORY: f"more than {limits.memory // 1024**2} MiB of memory",
            ExitReason.PROCESSES: f"more than {limits.processes} threads",
            ExitReason.DISK: f"more than {limits.disk // 1024**2} MiB of files",
        }[how]

    def _listen(self) -> tuple[ExitReason, str]:
        """Read the job's messages until it ends; return the reason and a detail."""
        poll = select.poll()
        poll.register(self._data, select.POLLIN)
        poll.register(self._output, select.POLLIN)
        if self._player is not None:
            poll.register(self._player.fileno(), select.POLLIN)
        chunk = bytearray(_CHUNK)
        view = memoryview(chunk)
        heard = time.monotonic()
        while True:
            now = time.monotonic()
            patience = self._limits.loading if self._reader.phase in _LOADING else self._limits.call
            left = min(heard + patience, self._started + self._limits.job) - now
            if self._waiting is not None:
                left = 1.0
            if left <= 0:
                whole = now - self._started >= self._limits.job
                limit = self._limits.job if whole else patience
                return ExitReason.TIMEOUT, f"{'the whole job' if whole else 'no answer'} within {limit:g} s"
            for descriptor, _ in poll.poll(min(left, 1.0) * 1000):
                if descriptor == self._output:
                    if not self._take_output():
                        poll.unregister(self._output)
                    if self._printed > self._limits.output_total:
                        return ExitReason.FLOOD, f"more than {self._limits.output_total} bytes of output"
                    continue
                if self._player is not None and descriptor == self._player.fileno():
                    try:
                        self._given.append(self._player.take())
                    except Stop:
                        return ExitReason.STOPPED, ""
                    continue
                try:
                    size = self._data.recv_into(chunk)
                except BlockingIOError:
                    continue
                except OSError:
                    size = 0
                if not size:
                    return ExitReason.DIED, ""
                heard = time.monotonic()
                try:
                    self._reader.feed(view[:size])
                except Forged as error:
                    return ExitReason.FORGED, str(error)
                except Stop:
                    return ExitReason.STOPPED, ""
                if self._reader.ended:
                    return ExitReason.DONE, ""
                if self._player is not None and self._reader.awaits_action and self._waiting is None:
                    self._waiting = heard
                    self._player.action_requested()
            if self._waiting is not None and self._given:
                try:
                    self._answer(self._given.pop(0))
                except Stop:
                    return ExitReason.STOPPED, ""
                except BlockingIOError:
                    return ExitReason.FORGED, "it requests actions and does not read them"
                except MalformedValue as error:
                    return ExitReason.FORGED, str(error)
                heard = time.monotonic()

    def _answer(self, action: Any) -> None:
        """Send the action that the job waits for.

        Raises:
            Stop: the recorder refuses the action.
            MalformedValue: the job has already had all its actions.
            BlockingIOError: the job does not read the action.
        """
        self._recorder.action(action)
        payload = json.dumps(action).encode()
        self._resume()
        self._reader.awaits_action = False
        try:
            self._data.sendall(HEADER.pack(Kind.ACTION, len(payload)) + payload)
        except BlockingIOError:
            raise
        except OSError:
            # The exit status explains why the job died.
            pass

    def _resume(self) -> None:
        """Count the job's time again."""
        if self._waiting is not None:
            self._started += time.monotonic() - self._waiting
            self._waiting = None

    def _take_output(self) -> bool:
        data = os.read(self._output, _PIECE)
        self._printed += len(data)
        room = self._limits.output - len(self._head)
        if room > 0 and self._own:
            self._head += data[:room]
        return bool(data)

    def _dump(self, pause: float) -> None:
        """Ask the job for its stack, which follows its output, and wait a moment for it.

        Args:
            pause: nobody reads the output for so many seconds before the request and after it. A job that floods it
                then waits in the call that prints, and its stack shows that call.
        """
        self._drain()
        self._own = False
        time.sleep(pause)
        self._worker.dump(self._number)
        time.sleep(pause)
        received, deadline = b"", time.monotonic() + _STACK_SECONDS
        begun = False
        with contextlib.suppress(BlockingIOError):
            while len(received) < _CHUNK and (left := deadline - time.monotonic()) > 0:
                # The end of a stack is not marked.
                if not select.select([self._output], [], [], min(left, _STACK_PAUSE) if begun else left)[0]:
                    break
                data = os.read(self._output, _PIECE)
                if not data:
                    break
                # A job that floods its output goes on until the signal reaches it.
                received = (received if begun else received[-_PIECE:]) + data
                begun = self._stack.begins(received)
        self._stack.take(received)

    def _drain(self) -> None:
        """Take the rest of the output. Never wait: a process that outlives the job may hold the pipe open."""
        os.set_blocking(self._output, False)
        try:
            while self._printed <= self._limits.output_total and self._take_output():
                pass
        except BlockingIOError:
            pass


def _signal_name(status: int) -> str:
    if os.WIFSIGNALED(status):
        return signal.Signals(os.WTERMSIG(status)).name
    return f"exit status {os.WEXITSTATUS(status)}"
