"""One job in one forked child: drop privileges, read the job, run it, exit. Jobs of a series follow one another in the
same child as long as each leaves it unchanged.

From here on the untrusted code can only write to its data socket and its output pipe.
"""

from __future__ import annotations

import contextlib
import errno
import faulthandler
import json
import os
import random
import signal
import socket
import subprocess
import sys
import traceback
from typing import Any, NoReturn

import numpy as np
from envcraft_protocol.jobs import Conditions, End, Job, JobLimits
from envcraft_protocol.wire import HEADER, MAX_MESSAGE, Kind

from . import confine, rollout, search, torch_generator
from .channel import Channel
from .clock import Clock
from .frames import Frames
from .resources import Resources
from .series import Traces
from .subject import Fault, Subject

#: The signal at which a job writes its stack to its output. A process that does not handle it ignores it.
DUMP = signal.SIGURG
# Bound before any untrusted module can replace them.
_seed, _seed_numpy = random.seed, np.random.seed


def main(data_fd: int, output_fd: int, limits: JobLimits, folder: str, shown: int | None) -> NoReturn:
    """Run the job that waits on `data_fd`; never return, and never unwind into the server's stack.

    `shown` is the result of :func:`envcraft_sandbox.worker.confine.prepare`.
    """
    code = 0
    try:
        os.setsid()
        shown = _keep_only(data_fd, output_fd, shown)
        os.chdir(folder)
        # Both write to the output even while a call of native code does not return, or has crashed.
        faulthandler.register(DUMP, file=2, all_threads=False)
        faulthandler.enable(file=2, all_threads=False)
        sock = socket.socket(fileno=3)
        job = _receive(sock)
        recorded = job.get("conditions", {}).get("recorded")
        # Opens a file that is out of reach afterwards.
        resources = Resources(folder, limits["descriptors"]) if recorded else None
        confine.enter(limits, shown)
        traces = Traces(folder) if job.get("series") else None
        channel = Channel(sock, every_step=bool(job.get("every_step")), shown=Frames(job))
        while _run(job, channel, traces, resources) and sock.recv(1, socket.MSG_PEEK):
            # A job that fails after other jobs runs again alone, and then reports each phase.
            job = _receive(sock)
            channel = Channel(sock, phases=False, shown=Frames(job))
    except BaseException:
        # Not the job's own exception: the host sees a dead process, and the traceback in the captured output.
        traceback.print_exc()
        code = 70
    finally:
        os._exit(code)


def _keep_only(data_fd: int, output_fd: int, shown: int | None) -> int | None:
    """Keep descriptors 0 (empty), 1 and 2 (the output pipe), 3 (the data socket) and, if `shown` is given, 4.

    Close all others; return the number of the last one or None.
    """
    kept = [data_fd, output_fd] if shown is None else [data_fd, output_fd, shown]
    while min(kept) <= 4:
        kept = [os.dup(number) for number in kept]
    data, output = kept[:2]
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.dup2(data, 3, inheritable=False)
    if shown is not None:
        os.dup2(kept[2], 4, inheritable=False)
    os.closerange(4 if shown is None else 5, os.sysconf("SC_OPEN_MAX"))
    sys.stdout = open(1, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    return None if shown is None else 4


def _receive(sock: socket.socket) -> Job:
    with sock.makefile("rb") as stream:
        _, length = HEADER.unpack(stream.read(HEADER.size))
        if length > MAX_MESSAGE:
            raise ValueError(f"a job of {length} bytes")
        job: Job = json.loads(stream.read(length))
        return job


def _without_programs(*_: Any, **__: Any) -> NoReturn:
    """Replaces the function that starts programs: it answers that the program is not installed, which libraries expect.
    pygame, for instance, calls ``fc-list`` for fonts and continues without it.
    """
    raise FileNotFoundError(errno.ENOENT, "no program can be started here")


#: Objects that shift the addresses of everything allocated later.
_kept: list[Any] = []


def _fragments(seed: int | None) -> list[Any]:
    """Objects of many sizes with gaps between them, so new objects get other addresses than in another process."""
    if seed is None:
        return []
    rng = random.Random(seed)
    made: list[Any] = [bytearray(2 * half + 1) for half in rng.randbytes(6_000)]
    made += [object() for _ in range(rng.randrange(1_000))]
    return [item for item in made if rng.random() < 0.6]


def _run(job: Job, channel: Channel, traces: Traces | None, resources: Resources | None) -> bool:
    """Run a job; return whether the process may run another one, if there are `traces` to remove."""
    conditions: Conditions = job.get("conditions", {})
    reusable = traces is not None and bool(job.get("series"))
    subprocess._fork_exec = _without_programs  # type: ignore[attr-defined]
    subprocess._USE_POSIX_SPAWN = False  # type: ignore[misc]
    # By default the episode's seed: with a fixed state, code that draws from it would have one level for all seeds.
    state = conditions.get("global_seed", job.get("seed", 0)) % 2**32
    _seed(state)
    _seed_numpy(state)
    torch_generator.seed(state)
    _kept.extend(_fragments(conditions.get("heap")))
    Clock.install(conditions.get("clock"), str(job["target"].get("source", "")))
    subject = Subject(job, channel)
    try:
        if job["kind"] == "describe":
            subject.describe()
        elif job["kind"] == "rollout":
            rollout.run(subject, job, resources)
        else:
            search.run(subject, job)
    except Fault as fault:
        reusable = False
        channel.send_json(Kind.FAULT, fault.report)
    reached = subject.target.reached
    del subject
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    if traces is not None and reusable:
        # The previous call is not responsible for failures of the cleanup.
        channel.phase("close")
        reusable = traces.remove()
    end: End = {"steps": channel.steps}
    if reached:
        end["reached"] = reached.decode("ascii", "replace")
    if reusable:
        end["reusable"] = True
    elif job.get("count_waits"):
        end["waits"], end["busy"] = channel.waits, int(channel.busy * 1e6)
    channel.send_json(Kind.END, end, flush=True)
    return reusable
