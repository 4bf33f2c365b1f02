"""Many workers for the price of one start: fork servers that are forked from a zygote.

A zygote (:mod:`envcraft_sandbox.worker.zygote`) is started as a worker is, imports the libraries, and never runs a job.
There is one for each hash seed, which is fixed when an interpreter starts. Workers that come from the same one are as
far from each other as any two, but for one thing: their modules lie at the same addresses, so no difference between
them can show that something depends on addresses.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import Availability, Driver, Limits, Worker

from . import launch, leftovers
from .client import ForkServerWorker, hang_up

_START_SECONDS = 60.0
_END_SECONDS = 2.0
#: So many times something may go wrong before workers are launched one by one.
_PATIENCE = 3


class Refused(Exception):
    """A zygote cannot fork here, and says why."""


class Started(NamedTuple):
    """A zygote's process and the control socket's end of this one."""

    process: subprocess.Popen[bytes]
    control: socket.socket


class ForkedWorker(ForkServerWorker):
    """A fork server that is a zygote's child. `folder` is removed when it ends."""

    def __init__(self, pidfd: int, control: socket.socket, limits: Limits, folder: Path | None) -> None:
        """Wait until it is ready. Raises WorkerLost, and has ended it then."""
        self._pidfd = pidfd
        self._folder = folder
        self._closing = threading.Lock()
        try:
            super().__init__(control, limits)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        super().close()
        # Whoever serves a job and whoever ends the subject may both get here.
        with self._closing:
            if self._pidfd < 0:
                return
            if not _has_ended(self._pidfd, _END_SECONDS):
                with contextlib.suppress(ProcessLookupError):
                    signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
                _has_ended(self._pidfd, None)
            os.close(self._pidfd)
            self._pidfd = -1
            if self._folder is not None:
                leftovers.remove(self._folder)


class Zygote:
    """The host's end of one, which starts at once."""

    def __init__(self, start: Callable[[], Started]) -> None:
        """`start` raises SandboxUnavailable; so does then :meth:`fork`."""
        self._start = start
        self._started: Started | None = None
        self._failure: SandboxUnavailable | None = None
        self._born, self._over = threading.Event(), threading.Event()
        self._ready = False
        self._received = b""
        self._lock = threading.Lock()
        # Some sandboxes end with the thread that started them, and this is nobody's but the zygote's.
        threading.Thread(target=self._live, name="envcraft-zygote", daemon=True).start()

    def fork(self, folder: str, limits: Limits, remove: Path | None = None) -> ForkedWorker:
        """Give a new worker, whose jobs write below `folder`; `remove` is removed when it ends.

        Raises Refused, SandboxUnavailable where the zygote did not start or is gone, WorkerLost where the worker is.
        """
        ours, theirs = socket.socketpair()
        try:
            with self._lock, theirs:
                pidfd = self._ask(folder, theirs)
        except BaseException:
            ours.close()
            raise
        return ForkedWorker(pidfd, ours, limits, remove)

    def close(self) -> None:
        """End it. Workers that it forked have been closed before, or end with it."""
        self._born.wait()
        if self._started is not None:
            process, control = self._started
            hang_up(control)
            try:
                process.wait(_END_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stderr:
                process.stderr.close()
        self._over.set()

    def _live(self) -> None:
        try:
            self._started = self._start()
        except SandboxUnavailable as error:
            self._failure = error
        finally:
            self._born.set()
        self._over.wait()

    def _ask(self, folder: str, theirs: socket.socket) -> int:
        self._born.wait()
        if self._started is None:
            raise self._failure or SandboxUnavailable("the zygote did not start")
        process, control = self._started
        deadline = time.monotonic() + _START_SECONDS
        try:
            if not self._ready:
                self._answer(control, deadline)
                self._ready = True
            socket.send_fds(control, [json.dumps({"folder": folder}).encode() + b"\n"], [theirs.fileno()])
            words, descriptors = self._answer(control, deadline)
        except (OSError, ValueError) as error:
            said = ""
            # Whoever closes it meanwhile has closed this, too.
            with contextlib.suppress(ValueError):
                said = launch.last_words(process)
            raise SandboxUnavailable(f"the zygote is gone: {said or error}") from None
        if "refused" in words:
            raise Refused(words["refused"])
        return descriptors[0]

    def _answer(self, control: socket.socket, deadline: float) -> tuple[dict[str, str], list[int]]:
        """The next line and what came with it. Raises OSError, ValueError."""
        descriptors: list[int] = []
        while b"\n" not in self._received:
            if not select.select([control], [], [], max(deadline - time.monotonic(), 0))[0]:
                raise OSError(f"no answer within {_START_SECONDS:.0f} s")
            data, found, _, _ = socket.recv_fds(control, 1 << 16, 1)
            descriptors += found
            if not data:
                raise OSError("it hung up")
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return json.loads(line), descriptors


class Nursery(Driver):
    """A driver whose workers are forked, and launched as ever where they cannot be.

    Attributes:
        refusal: why no worker is forked any more, or nothing.
    """

    def __init__(self, driver: Driver, start: Callable[[int], Started], folder: str | None = None) -> None:
        """`start` starts a zygote with a hash seed. Jobs write below `folder`; by default each worker's has its own."""
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self.refusal = ""
        self._driver = driver
        self._start = start
        self._folder = folder
        self._zygotes: dict[int, Zygote] = {}
        #: Those that are gone, or silent: their workers may still live.
        self._left: list[Zygote] = []
        self._mishaps = 0
        self._closed = False
        self._lock = threading.Lock()

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.begin(hash_seed=hash_seed, limits=limits)()

    def begin(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        self._zygote(hash_seed)
        return lambda: self._fork(hash_seed, limits) or self._driver.launch(hash_seed=hash_seed, limits=limits)

    def nursery(self) -> Driver:
        return self

    def close(self) -> None:
        with self._lock:
            self._closed = True
            zygotes = [*self._zygotes.values(), *self._left]
            self._zygotes.clear()
            self._left.clear()
        for zygote in zygotes:
            zygote.close()

    def _fork(self, hash_seed: int, limits: Limits) -> Worker | None:
        """None where none can be forked."""
        while (zygote := self._zygote(hash_seed)) is not None:
            own = None if self._folder else leftovers.job_folder()
            try:
                return zygote.fork(self._folder or str(own), limits, own)
            except Refused as refused:
                self.refusal = str(refused)
            except SandboxUnavailable as error:
                self._leave(hash_seed, zygote, str(error))
            except WorkerLost as error:
                with self._lock:
                    self._note(str(error))
        return None

    def _zygote(self, hash_seed: int) -> Zygote | None:
        """That with a hash seed, started if there is none. Raises SandboxUnavailable once this is closed."""
        with self._lock:
            if self._closed:
                raise SandboxUnavailable(f"the {self.name} sandbox was closed")
            if self.refusal:
                return None
            if hash_seed not in self._zygotes:
                self._zygotes[hash_seed] = Zygote(lambda: self._start(hash_seed))
            return self._zygotes[hash_seed]

    def _leave(self, hash_seed: int, zygote: Zygote, why: str) -> None:
        """Start another one for the next worker. However many threads wait for this one, it fails once."""
        with self._lock:
            if self._zygotes.get(hash_seed) is zygote:
                self._left.append(self._zygotes.pop(hash_seed))
                self._note(why)

    def _note(self, mishap: str) -> None:
        self._mishaps += 1
        if self._mishaps >= _PATIENCE:
            self.refusal = mishap


def _has_ended(pidfd: int, seconds: float | None) -> bool:
    """Whether a process ends within so many seconds."""
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(None if seconds is None else seconds * 1000))
