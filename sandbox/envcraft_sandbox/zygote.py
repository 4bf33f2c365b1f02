"""Fork servers forked from a zygote, so that many workers cost little more than one start.

A zygote (:mod:`envcraft_sandbox.worker.zygote`) starts like a worker, imports the libraries, and never runs a job.
There is one per hash seed, because an interpreter fixes its hash seed when it starts. Workers of one zygote are as
isolated from each other as any two workers, with one exception: their modules have the same addresses, so no
difference between them can show a dependence on addresses.
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
from envcraft.judging.driver import Availability, Driver, Limits, Worker

from . import launch, leftovers
from .client import ForkServerWorker, hang_up

_START_SECONDS = 60.0
_END_SECONDS = 2.0
#: After this many failures the driver launches its workers one by one.
_PATIENCE = 3


class Refused(Exception):
    """A zygote cannot fork on this machine, for the reason given."""


class Started(NamedTuple):
    """A zygote's process, and this process's end of its control socket."""

    process: subprocess.Popen[bytes]
    control: socket.socket


class ForkedWorker(ForkServerWorker):
    """A fork server that is a zygote's child. Its `folder` is removed when it ends."""

    def __init__(self, pidfd: int, control: socket.socket, limits: Limits, folder: Path | None) -> None:
        """Wait until it is ready. Raises WorkerLost after it has ended the fork server."""
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
        # The thread of a job and the thread that ends the subject may both close the worker.
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
    """The host's end of a zygote, which starts at once."""

    def __init__(self, start: Callable[[], Started]) -> None:
        """Call `start` in a thread. If it raises SandboxUnavailable, so does :meth:`fork`."""
        self._start = start
        self._started: Started | None = None
        self._failure: SandboxUnavailable | None = None
        self._born, self._over = threading.Event(), threading.Event()
        self._ready = False
        self._received = b""
        self._lock = threading.Lock()
        # Some sandboxes end with the thread that started them, so the zygote has a thread of its own.
        threading.Thread(target=self._live, name="envcraft-zygote", daemon=True).start()

    def fork(self, folder: str, limits: Limits, remove: Path | None = None) -> ForkedWorker:
        """Return a new worker.

        Args:
            folder: the folder that its jobs write to.
            limits: limits of its jobs.
            remove: a folder to remove when the worker ends.

        Raises:
            Refused: the zygote cannot fork here.
            SandboxUnavailable: the zygote did not start or has ended.
            WorkerLost: the new worker has ended.
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
        """End the zygote. Its workers are closed already, or end with it."""
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
            stderr = ""
            # Another thread may have closed the process's standard error.
            with contextlib.suppress(ValueError):
                stderr = launch.last_words(process)
            raise SandboxUnavailable(f"the zygote has ended: {stderr or error}") from None
        if "refused" in words:
            raise Refused(words["refused"])
        return descriptors[0]

    def _answer(self, control: socket.socket, deadline: float) -> tuple[dict[str, str], list[int]]:
        """The next line, and the descriptors that came with it. Raises OSError, ValueError."""
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


class ZygoteDriver(Driver):
    """A driver that forks its workers, and launches them where the kernel does not allow that.

    Attributes:
        refusal: the reason why it forks no more workers, or an empty string.
    """

    def __init__(self, driver: Driver, start: Callable[[int], Started], folder: str | None = None) -> None:
        """Wrap `driver`.

        Args:
            driver: launches the workers that cannot be forked.
            start: starts a zygote with a hash seed.
            folder: the folder that jobs write to; by default each worker has its own.
        """
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self.refusal = ""
        self._driver = driver
        self._start = start
        self._folder = folder
        self._zygotes: dict[int, Zygote] = {}
        #: Zygotes that ended or do not answer. Their workers may still run.
        self._left: list[Zygote] = []
        self._mishaps = 0
        self._closed = False
        self._lock = threading.Lock()

    def probe(self) -> Availability:
        return self._driver.availability

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.start(hash_seed=hash_seed, limits=limits)()

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        self._zygote(hash_seed)
        return lambda: self._fork(hash_seed, limits) or self._driver.launch(hash_seed=hash_seed, limits=limits)

    def shared_layout(self) -> Driver:
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
        """Fork a worker; None if no zygote can."""
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
        """The zygote with a hash seed, started if there is none. Raises SandboxUnavailable once this is closed."""
        with self._lock:
            if self._closed:
                raise SandboxUnavailable(f"the {self.name} sandbox was closed")
            if self.refusal:
                return None
            if hash_seed not in self._zygotes:
                self._zygotes[hash_seed] = Zygote(lambda: self._start(hash_seed))
            return self._zygotes[hash_seed]

    def _leave(self, hash_seed: int, zygote: Zygote, why: str) -> None:
        """Replace a zygote for the next worker. However many threads wait for it, it counts as one failure."""
        with self._lock:
            if self._zygotes.get(hash_seed) is zygote:
                self._left.append(self._zygotes.pop(hash_seed))
                self._note(why)

    def _note(self, mishap: str) -> None:
        self._mishaps += 1
        if self._mishaps >= _PATIENCE:
            self.refusal = mishap


def _has_ended(pidfd: int, seconds: float | None) -> bool:
    """Wait up to `seconds` for a process to end."""
    poll = select.poll()
    poll.register(pidfd, select.POLLIN)
    return bool(poll.poll(None if seconds is None else seconds * 1000))
