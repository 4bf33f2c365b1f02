"""What this process keeps outside itself, below one folder, so that a later one can clear up if this one is killed.

Each process that uses sandboxes has its own folder below ``TMPDIR/envcraft-UID``, and holds a lock on it for as long as
it lives. A folder whose lock is free belongs to nobody any more. :func:`sweep` then waits for the processes that its
owner started, which end by themselves when their host hangs up and hold a second lock until then, removes the
containers that are named in the folder, and at last the folder.
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

from .engine import EngineError, docker

#: How long the processes and containers that somebody left behind are waited for.
_END_SECONDS = 10.0
_LIFELINE = "lifeline"
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC

_lock = threading.Lock()


class _Own:
    """A process's folder. It is made before any worker, so that finalizers clear it up after every worker."""

    def __init__(self) -> None:
        self.process = os.getpid()
        self.path, self.children = _make()
        weakref.finalize(self, _leave, self.process, self.path)


_own: _Own | None = None


def folder() -> Path:
    """This process's own folder, which nobody else can enter; removed at exit. Raises SandboxUnavailable."""
    return _get().path


def job_folder() -> Path:
    """Where a worker's jobs may write, if it has no file system of its own: a path that nobody has yet. Raises
    SandboxUnavailable.
    """
    return folder() / f"job-{os.urandom(8).hex()}"


def lifeline() -> int:
    """A descriptor for every program that this process starts to inherit: its end is waited for.

    Raises SandboxUnavailable.
    """
    return _get().children


def containers() -> Path:
    """Where each container of this process has a folder of its name, made before it and removed after it.

    Raises SandboxUnavailable, OSError.
    """
    path = folder() / "containers"
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def sweep() -> None:
    """Remove what processes that are gone have left behind; what cannot be removed now is left to the next time.

    Runs no command and takes no time where there is nothing.
    """
    with contextlib.suppress(OSError, SandboxUnavailable):
        for path in _abandoned():
            with contextlib.suppress(OSError, EngineError):
                if _end(path):
                    remove(path)


def remove(path: Path) -> None:
    """Remove a folder, whatever untrusted code has put into it: deep trees, closed folders. Raises OSError.

    A subfolder's own subfolders are moved up before it is removed, so that depth costs neither recursion nor
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
                        # One that may not be written to cannot be moved.
                        os.close(_enter(below, inner))
                        os.rename(below, os.urandom(16).hex(), src_dir_fd=inner, dst_dir_fd=top)
                finally:
                    os.close(inner)
                os.rmdir(name, dir_fd=top)
    finally:
        os.close(top)
    os.rmdir(path)


def _clear(folder: int) -> list[str]:
    """Remove the files of a folder and give its subfolders."""
    found = []
    for name in os.listdir(folder):
        if stat.S_ISDIR(os.lstat(name, dir_fd=folder).st_mode):
            found.append(name)
        else:
            os.unlink(name, dir_fd=folder)
    return found


def _enter(name: str, parent: int) -> int:
    """Open a subfolder even if it is closed to its owner, and never what a link names."""
    held = os.open(name, os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=parent)
    try:
        os.chmod(f"/proc/self/fd/{held}", 0o700)
        return os.open(f"/proc/self/fd/{held}", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    finally:
        os.close(held)


def _get() -> _Own:
    global _own
    with _lock:
        # A fork shares the locks of its parent, but must not clear up after it.
        if _own is None or _own.process != os.getpid():
            try:
                _own = _Own()
            except OSError as error:
                reason = f"there is no room for temporary files ({error}); set TMPDIR to a folder that can be written"
                raise SandboxUnavailable(reason) from None
        return _own


def _base() -> Path:
    """The folder of all of this user's processes. Raises SandboxUnavailable where it is somebody else's."""
    base = Path(tempfile.gettempdir(), f"envcraft-{os.geteuid()}")
    base.mkdir(mode=0o700, exist_ok=True)
    status = base.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise SandboxUnavailable(f"{base} is not a folder of this user's alone; remove it, or set TMPDIR to another")
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
    """A folder and its lifeline. The descriptors are never closed: the locks hold until their processes end."""
    base = _base()
    # Nobody may find the new folder before its lock is held.
    with _locked(base):
        path = Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=base))
        fcntl.flock(os.open(path, _FOLDER), fcntl.LOCK_EX)
    children = os.open(path / _LIFELINE, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    fcntl.flock(children, fcntl.LOCK_EX)
    return path, children


def _leave(process: int, path: Path) -> None:
    # A container that did not end is for the next sweep.
    if process == os.getpid() and not _entries(path / "containers"):
        with contextlib.suppress(OSError):
            remove(path)


def _abandoned() -> Iterator[Path]:
    """The folders whose processes are gone, each locked while it is looked at."""
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
    """Take a lock if nobody has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _end(path: Path) -> bool:
    """End what a process that is gone has started; False where that takes too long. Raises OSError, EngineError.

    A container that is still being created cannot be removed yet. Its ``docker run`` ends when the container has been
    removed or was never made: so containers are looked at once more when no process is left.
    """
    containers = _entries(path / "containers")
    deadline = time.monotonic() + _END_SECONDS
    descriptor = os.open(path / _LIFELINE, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        while time.monotonic() < deadline:
            free = _is_free(descriptor)
            removed = [_is_removed(container.name) for container in containers]
            if free and all(removed):
                return True
            time.sleep(0.02)
    finally:
        os.close(descriptor)
    return False


def _is_removed(container: str) -> bool:
    """Remove a container; False while the engine is at it. Raises EngineError."""
    try:
        docker("rm", "--force", container)
    except EngineError as error:
        if "already in progress" in error.reason:
            return False
        if "no such container" not in error.reason.lower():
            raise
    return True
