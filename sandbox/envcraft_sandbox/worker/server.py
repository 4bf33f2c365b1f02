"""The fork server: import the libraries once, then fork a child for each job.

The host sends requests as JSON lines on the control socket and reads the replies there
(:mod:`envcraft_protocol.jobs`).

When a job ends, the server kills every process that it started, in any session, and removes its files. Only then
does it report the end, so the next job starts alone. A series of jobs is one job to the fork server.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.util
import json
import os
import platform
import random
import select
import signal
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy
from envcraft_protocol.jobs import Exceeded, Found, JobLimits, Reply, Request

from . import child, confine, watchdog
from .folder import JobFolder

#: Names of threads whose library handles forks: that of jemalloc, which pandas starts with PyArrow.
_FORKABLE_THREADS = ("jemalloc",)
#: What a library imports when it is first used: each job would import it.
_LATER = {"pygame": ("importlib.readers", "importlib.resources.readers")}


def serve(control: socket.socket, folder: str, read: list[str]) -> None:
    """Serve jobs on `control` until the host closes it. Jobs write below `folder` and may read the paths in `read`."""
    import gymnasium

    server = Server(control, JobFolder(folder), confine.prepare(folder, read))
    # Jobs must not trace or read the memory of the process that runs the next one.
    confine.set_dumpable(False)
    confine.adopt_orphans()
    gc.freeze()
    gc.enable()
    layers, missing = confine.layers()
    (layers if watchdog.available() else missing).append("watchdog of memory, threads and files")
    server.send(
        {
            "ready": {
                "python": platform.python_version(),
                "numpy": numpy.__version__,
                "gymnasium": gymnasium.__version__,
                "hash_seed": os.environ.get("PYTHONHASHSEED", "random"),
                "layers": [*layers, "own folder for each job"],
                "missing": missing,
            }
        }
    )
    server.run()


@dataclass
class _Job:
    number: int
    limits: JobLimits
    over: Exceeded | None = None


class Server:
    """The running jobs by process id."""

    def __init__(self, control: socket.socket, folder: JobFolder, shown: int | None) -> None:
        self._control = control
        self._folder = folder
        self._shown = shown
        self._jobs: dict[int, _Job] = {}
        self._wake, self._waker = os.pipe()
        os.set_blocking(self._waker, False)
        signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def send(self, message: Reply) -> None:
        self._control.sendall(json.dumps(message).encode() + b"\n")

    def run(self) -> None:
        received = b""
        descriptors: list[int] = []
        while True:
            patience = watchdog.INTERVAL if self._jobs else None
            readable, _, _ = select.select([self._control.fileno(), self._wake], [], [], patience)
            if self._wake in readable:
                os.read(self._wake, 4096)
                self._reap()
            else:
                self._watch()
            if self._control.fileno() not in readable:
                continue
            data, fds, _, _ = socket.recv_fds(self._control, 1 << 20, 16)
            if not data:
                for pid in self._jobs:
                    _kill_session(pid)
                _kill_leftovers()
                self._folder.empty()
                return
            descriptors += fds
            received += data
            while b"\n" in received:
                line, _, received = received.partition(b"\n")
                self._answer(json.loads(line), descriptors)

    def _answer(self, message: Request, descriptors: list[int]) -> None:
        if message["op"] == "preload":
            self.send({"preloaded": _preload(message["modules"])})
        elif message["op"] == "find":
            self.send(_find(message["modules"]))
        elif message["op"] == "kill":
            for pid, job in self._jobs.items():
                if job.number == message["id"]:
                    _kill_session(pid)
        elif message["op"] == "dump":
            for pid, job in self._jobs.items():
                if job.number == message["id"]:
                    _kill(os.kill, pid, child.DUMP)
        elif message["op"] == "job":
            self._fork(_Job(message["id"], message["limits"]), descriptors.pop(0), descriptors.pop(0))

    def _fork(self, job: _Job, data_fd: int, output_fd: int) -> None:
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            for number in (signal.SIGCHLD, signal.SIGINT):
                signal.signal(number, signal.SIG_DFL)
            os.close(self._wake)
            os.close(self._waker)
            self._control.close()
            child.main(data_fd, output_fd, job.limits, self._folder.path, self._shown)
        os.close(data_fd)
        os.close(output_fd)
        self._jobs[pid] = job

    def _watch(self) -> None:
        for pid, job in self._jobs.items():
            job.over = job.over or watchdog.exceeded(pid, job.limits, self._folder)
            if job.over:
                _kill_session(pid)

    def _reap(self) -> None:
        while True:
            try:
                pid, status, used = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            job = self._jobs.pop(pid, None)
            if job is None:
                continue
            _kill(os.killpg, pid)
            if not self._jobs:
                _kill_leftovers()
                self._folder.empty()
            cpu = used.ru_utime + used.ru_stime
            self.send({"exit": job.number, "status": status, "cpu": cpu, "over": job.over})


def _kill_session(pid: int) -> None:
    # The group does not exist before the child's setsid().
    for kill in (os.killpg, os.kill):
        _kill(kill, pid)


def _kill_leftovers() -> None:
    """Kill and reap every process that outlived its job. Orphans are children of this process."""
    while True:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG)
            if pid:
                continue
            if os.getpid() == 1:
                # One call for the whole container is faster than any process can fork.
                _kill(os.kill, -1)
            else:
                for orphan in _children():
                    _kill(os.kill, orphan)
            os.waitpid(-1, 0)
        except OSError:
            return


def _children() -> list[int]:
    """The children of this process. Raises OSError if the kernel does not list them."""
    with open(f"/proc/self/task/{os.getpid()}/children") as listed:
        return [int(pid) for pid in listed.read().split()]


def _kill(kill: Callable[[int, int], None], target: int, number: int = signal.SIGKILL) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        kill(target, number)


def _preload(modules: list[str]) -> list[str]:
    """Import modules, and return those that could be imported; none if one has started a thread: a process with threads
    must not be forked.
    """
    loaded = []
    # Random numbers that a library draws at import must not differ between workers.
    random.seed(0)
    numpy.random.seed(0)
    for name in modules:
        # The job reports a library that fails to import, with its own traceback.
        with contextlib.suppress(Exception):
            importlib.import_module(name)
            loaded.append(name)
            for later in _LATER.get(name, ()):
                importlib.import_module(later)
    gc.freeze()
    return [] if _threads() > 1 else loaded


def _threads() -> int:
    """The number of threads of this process, without those that are known to expect a fork; 1 if it is unknown."""
    folder, count = "/proc/self/task", 0
    try:
        for number in os.listdir(folder):
            with open(f"{folder}/{number}/comm") as name:
                count += not name.read().startswith(_FORKABLE_THREADS)
    except OSError:
        return 1
    return count


def _find(modules: list[str]) -> Found:
    missing = [name for name in modules if name not in sys.builtin_module_names and not _importable(name)]
    known: list[str] = []
    if missing:
        # Slow to import, and rarely needed.
        import importlib.metadata

        known = sorted({*sys.stdlib_module_names, *importlib.metadata.packages_distributions()})
    return {"missing": missing, "known": known}


def _importable(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError, AttributeError):
        return False
