"""The fork server: preload the libraries once, then fork a child for each job.

The host speaks JSON lines on the control socket::

    {"op": "preload", "modules": [...]}      -> {"preloaded": [...]}
    {"op": "find", "modules": [...]}         -> {"missing": [...], "known": [...]}
    {"op": "job", "id": 7, "limits": {...}}  + two descriptors: the job's data socket and the pipe for its output
    {"op": "kill", "id": 7}
                                             -> {"exit": 7, "status": <wait status>}

When a job ends, everything that it started is killed, whatever session it made for itself, before the host hears of the
end: the next job starts alone.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import select
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import child, confine


def serve(control: socket.socket) -> None:
    """Serve jobs on `control` until the host closes it."""
    import gymnasium
    import numpy

    wake, waker = os.pipe()
    os.set_blocking(waker, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Jobs must not trace or read the memory of the process that runs the next one.
    confine.set_dumpable(False)
    confine.adopt_orphans()
    gc.collect()
    gc.freeze()

    def send(message: dict[str, Any]) -> None:
        control.sendall(json.dumps(message).encode() + b"\n")

    send(
        {
            "ready": {
                "python": platform.python_version(),
                "numpy": numpy.__version__,
                "gymnasium": gymnasium.__version__,
                "hash_seed": os.environ.get("PYTHONHASHSEED", "random"),
                "layers": child.available_layers(),
            }
        }
    )
    children: dict[int, int] = {}
    received = b""
    descriptors: list[int] = []
    while True:
        readable, _, _ = select.select([control.fileno(), wake], [], [])
        if wake in readable:
            os.read(wake, 4096)
            for pid, status in _reap():
                job = children.pop(pid, None)
                if job is not None:
                    _kill(os.killpg, pid)
                    if not children:
                        _kill_leftovers()
                    send({"exit": job, "status": status})
        if control.fileno() not in readable:
            continue
        data, fds, _, _ = socket.recv_fds(control, 1 << 20, 16)
        if not data:
            for pid in children:
                _kill_session(pid)
            _kill_leftovers()
            return
        descriptors += fds
        received += data
        while b"\n" in received:
            line, _, received = received.partition(b"\n")
            message = json.loads(line)
            if message["op"] == "preload":
                send({"preloaded": _preload(message["modules"])})
            elif message["op"] == "find":
                send(_find(message["modules"]))
            elif message["op"] == "kill":
                for pid, job in list(children.items()):
                    if job == message["id"]:
                        _kill_session(pid)
            elif message["op"] == "job":
                data_fd, output_fd = descriptors.pop(0), descriptors.pop(0)
                pid = os.fork()
                if pid == 0:
                    signal.set_wakeup_fd(-1)
                    for number in (signal.SIGCHLD, signal.SIGINT):
                        signal.signal(number, signal.SIG_DFL)
                    os.close(wake)
                    os.close(waker)
                    control.close()
                    child.main(data_fd, output_fd, message["limits"])
                os.close(data_fd)
                os.close(output_fd)
                children[pid] = message["id"]


def _reap() -> list[tuple[int, int]]:
    ended: list[tuple[int, int]] = []
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return ended
        if pid == 0:
            return ended
        ended.append((pid, status))


def _kill_session(pid: int) -> None:
    # The group does not exist before the child's setsid().
    for kill in (os.killpg, os.kill):
        _kill(kill, pid)


def _kill_leftovers() -> None:
    """Kill and reap every process that outlived its job; orphans have become this process's children."""
    while True:
        try:
            pid, _ = os.waitpid(-1, os.WNOHANG)
            if pid:
                continue
            if os.getpid() == 1:
                # Everything else in the container at once: faster than any of it can fork.
                _kill(os.kill, -1)
            else:
                for orphan in _children():
                    _kill(os.kill, orphan)
            os.waitpid(-1, 0)
        except OSError:
            return


def _children() -> list[int]:
    """Raises OSError where the kernel does not list them."""
    return [int(pid) for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()]


def _kill(kill: Callable[[int, int], None], target: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        kill(target, signal.SIGKILL)


def _preload(modules: list[str]) -> list[str]:
    loaded = []
    for name in modules:
        # An installed library that fails to import is the job's finding to make, with its own traceback.
        with contextlib.suppress(Exception):
            importlib.import_module(name)
            loaded.append(name)
    gc.freeze()
    return loaded


def _find(modules: list[str]) -> dict[str, Any]:
    missing = [name for name in modules if name not in sys.builtin_module_names and not _importable(name)]
    known: list[str] = []
    if missing:
        known = sorted({*sys.stdlib_module_names, *importlib.metadata.packages_distributions()})
    return {"missing": missing, "known": known}


def _importable(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except (ImportError, ValueError, AttributeError):
        return False
