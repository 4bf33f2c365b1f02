"""The zygote: import the libraries once, then fork a fork server for each request.

It runs no untrusted code and reads nothing that comes from it. The host sends requests as JSON lines on the control
socket, one at a time, and reads the replies there (:mod:`envcraft_protocol.jobs`).

A fork server then runs :mod:`envcraft_sandbox.worker.server`. It shares nothing writable with the zygote or with other
fork servers: its memory is a copy, the zygote's descriptors are closed, and it has its own namespaces if the driver
uses namespaces.
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import socket
from functools import partial
from typing import NoReturn

from envcraft_protocol.jobs import ForkRequest, ZygoteReply

from . import confine, namespaces, seccomp
from .server import serve


def run(control: socket.socket, read: list[str], size: int | None) -> None:
    """Serve requests on `control` until the host closes it.

    Args:
        control: connected stream socket.
        read: paths that jobs may read.
        size: bytes of each fork server's file system; None: no namespaces of their own.
    """
    import gymnasium  # noqa: F401 (the fork servers need it)

    if seccomp.available():
        seccomp.prepare()
    # A job that could read the zygote could read all its fork servers.
    confine.set_dumpable(False)
    gc.freeze()
    Zygote(control, read, size).run()


class Zygote:
    """Forks fork servers and reaps them."""

    def __init__(self, control: socket.socket, read: list[str], size: int | None) -> None:
        self._control = control
        self._read = read
        self._size = size
        self._wake, self._waker = os.pipe()
        os.set_blocking(self._waker, False)
        signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    def run(self) -> None:
        self._send({"ready": {}})
        received = b""
        descriptors: list[int] = []
        while True:
            readable, _, _ = select.select([self._control.fileno(), self._wake], [], [])
            if self._wake in readable:
                os.read(self._wake, 4096)
                _reap()
            if self._control.fileno() not in readable:
                continue
            data, fds, _, _ = socket.recv_fds(self._control, 1 << 16, 4)
            if not data:
                return
            descriptors += fds
            received += data
            while b"\n" in received:
                line, _, received = received.partition(b"\n")
                request: ForkRequest = json.loads(line)
                self._answer(request["folder"], descriptors.pop(0))

    def _answer(self, folder: str, theirs: int) -> None:
        reading, writing = os.pipe()
        try:
            pid = os.fork()
        except OSError as error:
            for descriptor in (reading, writing, theirs):
                os.close(descriptor)
            self._send({"refused": str(error)})
            return
        if pid == 0:
            os.close(reading)
            self._become(folder, theirs, writing)
        os.close(writing)
        os.close(theirs)
        with open(reading) as stream:
            # The stream ends when the fork server is complete or has failed.
            words = stream.read().splitlines()
        if self._size is not None:
            os.waitpid(pid, 0)
        server, wrong = "", "it died"
        for line in words:
            key, _, value = line.partition(" ")
            server, wrong = (value, wrong) if key == "forked" else (server, value)
        if not server or len(words) > 1:
            self._send({"refused": wrong})
            return
        # Nobody else has its id: it is reaped above, and not before.
        try:
            pidfd = os.pidfd_open(int(server))
        except OSError as error:
            self._send({"refused": str(error)})
            return
        self._send({"forked": int(server)}, [pidfd])
        os.close(pidfd)

    def _become(self, folder: str, theirs: int, writing: int) -> NoReturn:
        """Run as a fork server, and never return."""
        code = 1
        try:
            signal.set_wakeup_fd(-1)
            for number in (signal.SIGCHLD, signal.SIGINT):
                signal.signal(number, signal.SIG_DFL)
            os.close(self._wake)
            os.close(self._waker)
            self._control.close()
            null = os.open(os.devnull, os.O_WRONLY)
            # The host reads the zygote's standard error only at its end.
            os.dup2(null, 2)
            os.close(null)
            forked = partial(_report, writing, "forked")
            if self._size is None:
                forked(os.getpid())
            else:
                namespaces.enter(folder, self._size, forked)
            os.setsid()
            os.environ["HOME"] = os.environ["TMPDIR"] = folder
            os.close(writing)
            writing = -1
            serve(socket.socket(fileno=theirs), folder, self._read)
            code = 0
        except BaseException as error:
            if writing >= 0:
                _report(writing, "refused", " ".join(str(error).split()))
        finally:
            os._exit(code)

    def _send(self, message: ZygoteReply, descriptors: list[int] | None = None) -> None:
        data = json.dumps(message).encode() + b"\n"
        socket.send_fds(self._control, [data], descriptors or [])


def _report(writing: int, key: str, value: int | str) -> None:
    os.write(writing, f"{key} {value}\n".encode())


def _reap() -> None:
    """Reap fork servers that have ended, and processes that the zygote inherited from them."""
    while True:
        try:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                return
        except ChildProcessError:
            return
