"""One process of a vector: ``python -m envcraft.using.vector_worker COMMANDS ANSWERS MEMORY EVEN ODD``, descriptors.

A command is one byte, some with a payload; the answer is one byte, with a payload where there is more to say than the
shared arrays hold. Payloads are msgpack after their length, and nothing is unpickled. The process ends when nobody
holds the other end of COMMANDS.

That all are to step is said to all of them at once, by an event that they share: were each told by itself, the first
that is woken would take the core from who has yet to tell the others. Two events, EVEN and ODD, take turns, so that
one is taken back while nobody waits for it.
"""

from __future__ import annotations

import itertools
import mmap
import os
import select
import signal
import struct
import sys
import time
import traceback
from collections.abc import Sequence
from typing import Any, Literal

import msgspec

from envcraft.errors import EnvCraftError, EnvironmentFailed, UsageError
from envcraft.using import infos
from envcraft.using.group import Arrays, Crash, Group, Layout, Member
from envcraft.using.slices import take_short_turns
from envcraft.using.weighing import weigh

LENGTH = struct.Struct("<I")
#: Commands: those with a payload are WEIGH, START, ATTACH and RESET. STEP comes by an event, and not as a byte.
WEIGH, START, ATTACH, RESET, STEP, RENDER, CLOSE = b"w", b"i", b"a", b"r", b"s", b"f", b"c"
#: Answers: done; done, and there is more to say; an environment failed.
DONE, MORE, FAILED = b".", b"+", b"!"
_MAX_TRACEBACK = 8000
#: So long a worker looks for its next command before it sleeps; one that was kept from its core for longer than the
#: second of these does not look for so many commands.
_LOOK_SECONDS, _KEPT_SECONDS, _REST = 1e-4, 5e-4, 1_000


class Weigh(msgspec.Struct):
    """What is to be weighed, and where Python looks for modules."""

    members: list[Member]
    path: list[str]


class Start(msgspec.Struct):
    """What a worker is started with: its number, its environments, and where Python looks for modules."""

    number: int
    members: list[Member]
    path: list[str]


class Attach(msgspec.Struct):
    layout: Layout
    same_step: bool


class Reset(msgspec.Struct):
    seeds: list[int | None]
    options: dict[Any, Any] | None


class Failure(msgspec.Struct):
    """An environment that failed; `kind` is that of an error of EnvCraft's own, whose words need nothing added."""

    index: int
    phase: str
    error: str
    traceback: str
    kind: Literal["usage", "failed", "other"] | None


def frame(payload: bytes) -> bytes:
    """A payload as it is sent."""
    return LENGTH.pack(len(payload)) + payload


def read(descriptor: int, size: int) -> bytes:
    """Exactly so many bytes. Raises EOFError."""
    data = b""
    while len(data) < size:
        part = os.read(descriptor, size - len(data))
        if not part:
            raise EOFError
        data += part
    return data


def write(descriptor: int, data: bytes) -> None:
    """All of it. Raises BrokenPipeError."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def serve(commands: int, answers: int, memory: int, turns: Sequence[int]) -> None:
    """Do what is asked until CLOSE, or until the other end is gone."""
    group: Group | None = None
    listening = _Listening(commands, turns)
    try:
        while (command := listening.next()) != CLOSE:
            try:
                if command == WEIGH:
                    asked = msgspec.msgpack.decode(_payload(commands), type=Weigh)
                    sys.path[:] = asked.path
                    answer = MORE + frame(msgspec.msgpack.encode([weigh(member) for member in asked.members]))
                elif command == START:
                    start = msgspec.msgpack.decode(_payload(commands), type=Start)
                    sys.path[:] = start.path
                    group = Group(start.members, start.number)
                    answer = MORE + frame(msgspec.msgpack.encode(group.spaces()))
                else:
                    assert group is not None
                    answer = _answer(command, commands, memory, group)
            except Crash as crash:
                answer = FAILED + frame(msgspec.msgpack.encode(_failure(crash)))
            write(answers, answer)
    except (EOFError, BrokenPipeError):
        pass
    finally:
        if group is not None:
            group.close()


class _Listening:
    """Waits for commands. Mostly the next one comes soon: looking for it costs less than being put to sleep and woken
    up, which on virtual machines takes as long as a game's step.

    Who else wants the core may have it in between. Where that is other work than the vector's own, it keeps the core
    for milliseconds, which sleeping does not: then there is no looking for a while.
    """

    def __init__(self, commands: int, turns: Sequence[int]) -> None:
        self._commands = commands
        self._rest = 0
        self._polls = itertools.cycle([_poll(commands, turn) for turn in turns])
        self._poll = next(self._polls)

    def next(self) -> bytes:
        """The next command. Raises EOFError."""
        ready: list[tuple[int, int]] = []
        if self._rest:
            self._rest -= 1
        else:
            ready = self._look()
        ready = ready or self._poll.poll()
        if any(descriptor == self._commands for descriptor, _ in ready):
            return read(self._commands, 1)
        self._poll = next(self._polls)
        return STEP

    def _look(self) -> list[tuple[int, int]]:
        now = time.perf_counter()
        deadline = now + _LOOK_SECONDS
        ready: list[tuple[int, int]] = []
        while now < deadline and not (ready := self._poll.poll(0)):
            os.sched_yield()
            now, before = time.perf_counter(), now
            if now - before > _KEPT_SECONDS:
                self._rest = _REST
        return ready


def _poll(*descriptors: int) -> select.poll:
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    return poll


def _answer(command: bytes, commands: int, memory: int, group: Group) -> bytes:
    if command == STEP:
        told: Any = group.step()
    elif command == RESET:
        reset = msgspec.msgpack.decode(_payload(commands), type=Reset)
        told = group.reset(reset.seeds, reset.options)
    elif command == RENDER:
        told = group.render()
    else:
        attach = msgspec.msgpack.decode(_payload(commands), type=Attach)
        group.attach(Arrays(attach.layout, mmap.mmap(memory, attach.layout.size)), attach.same_step)
        told = None
    return MORE + frame(infos.encode(told)) if told else DONE


def _payload(descriptor: int) -> bytes:
    (size,) = LENGTH.unpack(read(descriptor, LENGTH.size))
    return read(descriptor, size)


def _failure(crash: Crash) -> Failure:
    error = crash.error
    lines = "".join(traceback.format_exception(error))[-_MAX_TRACEBACK:]
    if not isinstance(error, EnvCraftError):
        return Failure(crash.index, crash.phase, crash.words[:2000], lines, None)
    own = isinstance(error, UsageError), isinstance(error, EnvironmentFailed)
    return Failure(crash.index, crash.phase, str(error), "", "usage" if own[0] else "failed" if own[1] else "other")


def main() -> None:
    # Ctrl-C goes to the whole terminal: the vector closes its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    take_short_turns()
    commands, answers, memory, *turns = map(int, sys.argv[1:])
    serve(commands, answers, memory, turns)
    sys.stdout.flush()
    sys.stderr.flush()
    # Threads that an environment has left must not keep the process.
    os._exit(0)


if __name__ == "__main__":
    main()
