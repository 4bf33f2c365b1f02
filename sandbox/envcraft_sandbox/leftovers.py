"""What this process keeps outside itself, in one folder, so that a later process can remove it if this one is killed.

Each process that uses sandboxes has its own folder below ``TMPDIR/envcraft-UID`` and holds a lock on it while it lives.
A folder whose lock is free has no owner any more. :func:`sweep` then waits for the processes that its owner started,
which end when their host hangs up and hold a second lock until then. After that it removes the containers named in the
folder, and the folder.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import SandboxUnavailable

from . import engine
from .engine import EngineError

#: How long a sweep waits for the processes and containers that a dead process left behind.
_END_SECONDS = 10.0
_LIFELINE = "lifeline"
#: In the record of a container: the engine has started it.
_STARTED = "started"
#: The engine creates a container within this time, or not at all.
_CREATE_SECONDS = 5.0
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

_lock = threading.Lock()


class _Own:
    """This process's folder. It is created before any worker, so that its finalizer runs after those of the workers."""

    def __init__(self) -> None:
        self.process = os.getpid()
        self.path, self.children = _make()
        weakref.finalize(self, _leave, self.process, self.path)


_own: _Own | None = None


def folder() -> Path:
    """This process's own folder, closed to other users and removed at exit. Raises SandboxUnavailable."""
    return _get().path


def job_folder() -> Path:
    """A new path for the jobs of a worker without a file system of its own. Raises SandboxUnavailable."""
    return folder() / f"job-{os.urandom(8).hex()}"


def lifeline() -> int:
    """A descriptor that every program of this process inherits; the sweep waits until the last copy is closed.

    Raises SandboxUnavailable.
    """
    return _get().children


def containers() -> Path:
    """The folder of this process's container records. A record is a folder with the container's name, which exists
    from before the container is created until after it is removed.

    Raises SandboxUnavailable, OSError.
    """
    path = folder() / "containers"
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def mark_started(record: Path) -> None:
    """Note in the folder of a container that the engine has started it. Raises OSError."""
    (record / _STARTED).touch()


def sweep() -> None:
    """Remove what dead processes have left behind; leave to the next sweep what cannot be removed now.

    The sweep does nothing and takes no time if there is nothing to remove.
    """
    with contextlib.suppress(OSError, SandboxUnavailable):
        for path in _abandoned():
            with contextlib.suppress(OSError, EngineError):
                if _end(path):
                    remove(path)


def remove(path: Path) -> None:
    """Remove a folder with untrusted contents, such as deep trees and closed folders. Raises OSError.

    The subfolders of a subfolder move up before the subfolder is removed, so depth needs neither recursion nor
    descriptors.
    """
    try:
        top = os.open(path, _FOLDER)
    except FileNotFoundError:
        return
    try:
        while folders := _clear(top):
            for name in folders:
                inner = _enter(name, top)
                try:
                    for below in _clear(inner):
                        # A folder that is not writable cannot be moved.
                        os.close(_enter(below, inner))
                        os.rename(below, os.urandom(16).hex(), src_dir_fd=inner, dst_dir_fd=top)
                finally:
                    os.close(inner)
                os.rmdir(name, dir_fd=top)
    finally:
        os.close(top)
    os.rmdir(path)


def _clear(folder: int) -> list[str]:
    """Remove the files of a folder; return its subfolders."""
    found = []
    for name in os.listdir(folder):
        if stat.S_ISDIR(os.lstat(name, dir_fd=folder).st_mode):
            found.append(name)
        else:
            os.unlink(name, dir_fd=folder)
    return found


def _enter(name: str, parent: int) -> int:
    """Open a subfolder even if its mode closes it to its owner. Never follow a link."""
    held = os.open(name, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=parent)
    try:
        os.chmod(f"/proc/self/fd/{held}", 0o700)
        return os.open(f"/proc/self/fd/{held}", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    finally:
        os.close(held)


def _get() -> _Own:
    global _own
    with _lock:
        # A fork shares the locks of its parent but must not remove its parent's files.
        if _own is None or _own.process != os.getpid():
            try:
                _own = _Own()
            except OSError as error:
                reason = f"no temporary folder can be created ({error}); set TMPDIR to a writable folder"
                raise SandboxUnavailable(reason) from None
        return _own


def _base() -> Path:
    """The folder of all processes of this user. Raises SandboxUnavailable if other users can enter it."""
    base = Path(tempfile.gettempdir(), f"envcraft-{os.geteuid()}")
    base.mkdir(mode=0o700, exist_ok=True)
    status = base.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise SandboxUnavailable(f"other users can enter {base}; remove it, or set TMPDIR to another folder")
    return base


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    descriptor = os.open(path, _FOLDER)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _make() -> tuple[Path, int]:
    """Create a folder and its lifeline. The descriptors stay open: the locks hold until their processes end."""
    base = _base()
    # No sweep may see the new folder before it is locked.
    with _locked(base):
        path = Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=base))
        fcntl.flock(os.open(path, _FOLDER), fcntl.LOCK_EX)
    children = os.open(path / _LIFELINE, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    fcntl.flock(children, fcntl.LOCK_EX)
    return path, children


def _leave(process: int, path: Path) -> None:
    # The next sweep removes a container that did not end.
    if process == os.getpid() and not _entries(path / "containers"):
        with contextlib.suppress(OSError):
            remove(path)


def _abandoned() -> Iterator[Path]:
    """The folders whose processes have ended, each locked while the caller examines it."""
    if not Path(tempfile.gettempdir(), f"envcraft-{os.geteuid()}").exists():
        return
    base = _base()
    with contextlib.ExitStack() as held:
        found = []
        with _locked(base):
            for path in _entries(base):
                with contextlib.suppress(OSError):
                    descriptor = os.open(path, _FOLDER)
                    held.callback(os.close, descriptor)
                    if _is_free(descriptor):
                        found.append(path)
        yield from found


def _entries(path: Path) -> list[Path]:
    try:
        return list(path.iterdir())
    except FileNotFoundError:
        return []


def _is_free(descriptor: int) -> bool:
    """Take a lock if no process holds it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _end(path: Path) -> bool:
    """End what a process that is gone has started; False where that takes too long. Raises OSError, EngineError.

    The engine goes on creating a container whose owner was killed, and does not know its name at first. An unknown
    container is gone only if it was started, or if its owner requested it some seconds ago.
    """
    containers = _entries(path / "containers")
    deadline = time.monotonic() + _END_SECONDS
    descriptor = os.open(path / _LIFELINE, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        while time.monotonic() < deadline:
            free = _is_free(descriptor)
            containers = [each for each in containers if not _is_removed(each)]
            if free and not containers:
                return True
            time.sleep(0.02)
    finally:
        os.close(descriptor)
    return False


def _is_removed(record: Path) -> bool:
    """Remove a container by its record; False while the engine creates or removes it. Raises EngineError."""
    connection = engine.client()
    try:
        with engine.errors():
            connection.remove_container(record.name, force=True)
    except engine.ConflictError:
        return False
    except engine.NotFoundError:
        return (record / _STARTED).exists() or time.time() - record.stat().st_mtime > _CREATE_SECONDS
    return True
