"""How long a step of each environment takes, so that the shares of a vector's processes take as long as each other.

An environment is weighed in a process that is forked for that alone: nothing that it leaves behind is there when it is
used.
"""

from __future__ import annotations

import heapq
import os
import select
import signal
import statistics
import struct
import time
from collections.abc import Mapping, Sequence
from typing import NoReturn

from envcraft.using.group import Member

#: Steps that are played, and seconds that all of it may take.
_STEPS, _PATIENCE = 64, 2.0
_SECONDS = struct.Struct("<d")
#: With more different environments than this in a process, chance makes the shares even, and weighing takes long.
_MOST = 16


def worth_weighing(members: Sequence[Member], workers: int) -> list[Member]:
    """One of each that is to be weighed: none where there is nothing to be shared out, or nothing to be gained."""
    each = list({member.path: member for member in members}.values())
    sandboxed = any(member.sandbox is not None for member in members)
    return [] if sandboxed or workers < 2 or not 1 < len(each) <= _MOST * workers else each


def shares(members: Sequence[Member], workers: int, weights: Mapping[str, float]) -> list[list[Member]]:
    """The environments of each process: the heaviest first, each to the process that has least so far (Graham 1969).

    `weights` are seconds by path. What has none, since it could not be played, counts as the median of the others.
    """
    usual = statistics.median(weights.values()) if weights else 1.0
    first: dict[str, int] = {}
    for member in members:
        first.setdefault(member.path, member.index)
    found: list[list[Member]] = [[] for _ in range(workers)]
    least = [(0.0, 0, number) for number in range(workers)]
    for member in sorted(
        members, key=lambda member: (-weights.get(member.path, usual), first[member.path], member.index)
    ):
        load, count, number = least[0]
        found[number].append(member)
        heapq.heapreplace(least, (load + weights.get(member.path, usual), count + 1, number))
    return found


def weigh(member: Member) -> float | None:
    """Seconds of one step under random actions; None where that does not come out."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        _tell(member, write)
    os.close(write)
    try:
        ready, _, _ = select.select([read], [], [], _PATIENCE)
        data = os.read(read, _SECONDS.size) if ready else b""
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(read)
    return _SECONDS.unpack(data)[0] if len(data) == _SECONDS.size else None


def _tell(member: Member, write: int) -> NoReturn:
    """The forked process: what goes wrong, or is printed, does so again where somebody listens."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os.write(write, _SECONDS.pack(_seconds(member)))
    finally:
        os._exit(0)


def _seconds(member: Member) -> float:
    """The mean by the processor's clock or the median by the wall's, whichever is more: some environments sleep, and
    other work may hold up a step. Raises whatever the environment raises.
    """
    env = member.open()
    env.action_space.seed(0)
    env.reset(seed=0)
    walls, spent = [], 0.0
    for _ in range(_STEPS):
        action = env.action_space.sample()
        wall, used = time.perf_counter(), time.thread_time()
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
        spent += time.thread_time() - used
        walls.append(time.perf_counter() - wall)
    return max(spent / _STEPS, statistics.median(walls))
