"""The host's end of a vector's worker processes: starting and telling them, and what it means if one is gone."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import mmap
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import Any

import msgspec

from envcraft.errors import EnvCraftError, EnvironmentFailed, UsageError
from envcraft.using import infos
from envcraft.using.group import Arrays, Crash, Group, Info, Layout, Member
from envcraft.using.vector_worker import (
    ATTACH,
    CLOSE,
    DONE,
    FAILED,
    LENGTH,
    RENDER,
    RESET,
    START,
    WEIGH,
    Attach,
    Failure,
    Reset,
    Start,
    Weigh,
    frame,
    write,
)
from envcraft.using.weighing import shares, worth_weighing

_CHUNK = 1 << 16
_HEAD = 1 + LENGTH.size
_GOODBYE_SECONDS = 5.0
_KINDS = {"usage": UsageError, "failed": EnvironmentFailed, "other": EnvCraftError}
#: One thread for each numerical library, as in the sandbox: the cores are the workers'. And no window, nor sound.
_VARIABLES = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "SDL_VIDEODRIVER": "dummy",
    "SDL_AUDIODRIVER": "dummy",
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}


class Processes:
    """Worker processes with several environments each. Calls raise EnvironmentFailed, and close everything then."""

    def __init__(self, members: Sequence[Member], workers: int) -> None:
        """Start so many, and share the environments out. Raises EnvironmentFailed, UsageError."""
        self._names = {member.index: member.name for member in members}
        self.groups = workers
        self._shares = [sorted(self._names)] * workers
        self._memory = os.memfd_create("envcraft-vector", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        self._turns = [os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK) for _ in range(2)]
        self._arrays: Arrays | None = None
        self._workers: list[_Worker] = []
        try:
            for _ in range(workers):
                self._workers.append(_Worker([self._memory, *self._turns]))
            path = [os.path.abspath(entry) for entry in sys.path]
            found = shares(members, workers, self._weights(worth_weighing(members, workers), path))
            self._shares = [[member.index for member in share] for share in found]
            self._order = [index for share in self._shares for index in share]
            told = self._all([START + frame(_plain(Start(number, share, path))) for number, share in enumerate(found)])
        except BaseException:
            self.close()
            raise
        self.spaces = self._in_order(told)

    def _weights(self, members: Sequence[Member], path: list[str]) -> dict[str, float]:
        """Seconds of a step by path, each measured by one of the processes; none of what cannot be played."""
        if not members:
            return {}
        dealt = [list(members[number :: self.groups]) for number in range(self.groups)]
        told = self._all([WEIGH + frame(_plain(Weigh(part, path))) for part in dealt])
        weighed = zip(itertools.chain.from_iterable(dealt), itertools.chain.from_iterable(told), strict=True)
        return {member.path: seconds for member, seconds in weighed if seconds is not None}

    def attach(self, layout: Layout, same_step: bool) -> Arrays:
        """Share the arrays."""
        os.ftruncate(self._memory, layout.size)
        # A file that shrinks would end whoever reads it.
        fcntl.fcntl(self._memory, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        self._arrays = Arrays(layout, mmap.mmap(self._memory, layout.size))
        self._all([ATTACH + frame(_plain(Attach(layout, same_step)))] * len(self._workers))
        return self._arrays

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None) -> list[Info]:
        """Reset the environments whose bit is set. Raises UsageError where the options are no plain data."""
        try:
            payloads = [_plain(Reset([seeds[index] for index in share], options)) for share in self._shares]
        except (TypeError, OverflowError) as error:
            raise UsageError(f"options for reset() must be plain data: {error}") from None
        return self._told(self._all([RESET + frame(payload) for payload in payloads]))

    def step(self) -> list[Info]:
        with self._closing():
            turn, last = self._turns
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(last)
            self._turns = [last, turn]
            os.eventfd_write(turn, 1)
            return self._told(self._answers())

    def render(self) -> list[Any]:
        return self._in_order(self._all([RENDER] * len(self._workers)))

    def close(self) -> None:
        """End the processes. May be called twice."""
        for worker in self._workers:
            worker.hang_up()
        for worker in self._workers:
            worker.join()
        self._workers.clear()
        if self._memory >= 0:
            for descriptor in (self._memory, *self._turns):
                os.close(descriptor)
            self._memory = -1

    def _told(self, answers: Sequence[Any]) -> list[Info]:
        """In the order of the environments, that of an episode's end before that of the next one's beginning."""
        told = [(index, final, info) for answer in answers for index, final, info in answer]
        return sorted(told, key=itemgetter(0))

    def _in_order(self, told: Sequence[Sequence[Any]]) -> list[Any]:
        """What each worker says of each of its environments, in the order of the environments."""
        values = zip(self._order, itertools.chain.from_iterable(told), strict=True)
        return [value for _, value in sorted(values, key=itemgetter(0))]

    def _all(self, messages: Sequence[bytes]) -> list[Any]:
        """Send each worker its message, and give what each answers."""
        with self._closing():
            for worker, message in zip(self._workers, messages, strict=True):
                worker.send(message)
            return self._answers()

    def _answers(self) -> list[Any]:
        """What each worker answers. Of what an environment cannot be asked the others still answer, so that the next
        call gets its own answers.
        """
        told, wrong = [], None
        for number in range(len(self._workers)):
            try:
                told.append(self._receive(number))
            except UsageError as error:
                wrong = error
        if wrong is not None:
            raise wrong
        return told

    @contextlib.contextmanager
    def _closing(self) -> Iterator[None]:
        """An answer that is waited for and does not come, as on Ctrl-C, would be taken for that of the next call: after
        any error everything is closed, but for wrong use, after which all have answered.
        """
        try:
            yield
        except UsageError:
            raise
        except BaseException:
            self.close()
            raise

    def _receive(self, number: int) -> Any:
        """What a worker answers. Raises EnvironmentFailed, UsageError."""
        try:
            kind, payload = self._workers[number].receive()
        except EOFError:
            raise self._lost(number) from None
        if kind == FAILED:
            failure = msgspec.msgpack.decode(payload, type=Failure)
            if failure.kind is not None:
                raise _KINDS[failure.kind](failure.error)
            raise failed(self._names[failure.index], failure.index, failure.phase, failure.error, failure.traceback)
        return [] if kind == DONE else infos.decode(payload)

    def _lost(self, number: int) -> EnvironmentFailed:
        """A process is gone: which environment was being called is in the shared arrays."""
        status = self._workers[number].status()
        how = f"signal {-status}" if status < 0 else f"exit status {status}"
        index = int(self._arrays.current[number]) if self._arrays is not None else -1
        if index in self._names:
            return EnvironmentFailed(f"environment {index} ({self._names[index]}) ended its process ({how})")
        names = ", ".join(self._names[index] for index in self._shares[number])
        return EnvironmentFailed(f"the process of the environments {names} has ended ({how})")


class InProcess:
    """The same for environments in this process."""

    groups = 1

    def __init__(self, members: Sequence[Member]) -> None:
        """Make them. Raises EnvironmentFailed, UsageError."""
        self._names = {member.index: member.name for member in members}
        with self._told():
            self._group = Group(members)
        self.spaces = self._group.spaces()

    def attach(self, layout: Layout, same_step: bool) -> Arrays:
        arrays = Arrays(layout)
        self._group.attach(arrays, same_step)
        return arrays

    def reset(self, seeds: Sequence[int | None], options: dict[str, Any] | None) -> list[Info]:
        with self._told():
            return self._group.reset(seeds, options)

    def step(self) -> list[Info]:
        with self._told():
            return self._group.step()

    def render(self) -> list[Any]:
        with self._told():
            return self._group.render()

    def close(self) -> None:
        self._group.close()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except Crash as crash:
            if isinstance(crash.error, EnvCraftError):
                raise crash.error from None
            raise failed(self._names[crash.index], crash.index, crash.phase, crash.words, "") from crash.error


def failed(name: str, index: int, phase: str, error: str, traceback: str) -> EnvironmentFailed:
    """An environment raised in a call, or while it was made."""
    where = f"raised in {phase}" if phase else "could not be made"
    words = EnvironmentFailed(f"environment {index} ({name}) {where}: {error}")
    if traceback:
        words.add_note(f"In its process:\n{traceback.rstrip()}")
    return words


class _Worker:
    """One process and the two pipes to it."""

    def __init__(self, shared: Sequence[int]) -> None:
        theirs, self._commands = os.pipe()
        self._answers, answers = os.pipe()
        # This process may be able to import what another one would not find.
        path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
        try:
            self._process = subprocess.Popen(  # noqa: S603 (our own program, from a list of words)
                [sys.executable, "-m", "envcraft.using.vector_worker", *map(str, (theirs, answers, *shared))],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs, answers, *shared],
                env={**_VARIABLES, **os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1"},
            )
        except BaseException:
            os.close(self._commands)
            os.close(self._answers)
            raise
        finally:
            os.close(theirs)
            os.close(answers)

    def send(self, message: bytes) -> None:
        # That it is gone shows where it is listened to.
        with contextlib.suppress(BrokenPipeError):
            write(self._commands, message)

    def receive(self) -> tuple[bytes, bytes]:
        """The kind of an answer and its payload. Raises EOFError where the process is gone."""
        data = self._read()
        if data == DONE:
            return DONE, b""
        while len(data) < _HEAD:
            data += self._read()
        parts, missing = [data], _HEAD + LENGTH.unpack_from(data, 1)[0] - len(data)
        while missing > 0:
            parts.append(self._read())
            missing -= len(parts[-1])
        data = b"".join(parts)
        return data[:1], data[_HEAD:]

    def _read(self) -> bytes:
        data = os.read(self._answers, _CHUNK)
        if not data:
            raise EOFError
        return data

    def status(self) -> int:
        """How it ended: what a process has closed its pipe for that goes on is ended."""
        try:
            return self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def hang_up(self) -> None:
        """Ask it to end, and listen no longer, so that it does not wait for somebody to."""
        if self._commands >= 0:
            self.send(CLOSE)
            os.close(self._commands)
            os.close(self._answers)
            self._commands = -1

    def join(self) -> None:
        """Wait until it has ended; end it where that takes long."""
        try:
            self._process.wait(timeout=_GOODBYE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _plain(value: Any) -> bytes:
    """Raises UsageError."""
    try:
        return msgspec.msgpack.encode(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(
            f"environments of other processes take plain data (numbers, text, lists, dictionaries): {error}"
        ) from None
