"""The worker's command line and its minimal environment, which every driver starts."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.driver import Limits
from envcraft.judging.installed import Installed

from . import leftovers
from .client import ForkServerWorker

#: The folder that jobs write to where the worker has its own file system; also the worker's default.
JOB_FOLDER = "/tmp/job"

#: The folder of this package and of `envcraft_protocol`. The worker imports these two and libraries, nothing else.
PACKAGE_ROOT = Path(__file__).resolve().parent.parent


def environment(hash_seed: int, folder: str = JOB_FOLDER) -> dict[str, str]:
    """The only environment variables that a worker sees.

    Each numerical library uses one thread, so results and limits do not depend on the number of cores. glibc keeps
    freed memory from the first step on: by default it adapts during the first episode of a process, and each job is one
    (mallopt(3), M_MMAP_THRESHOLD).
    """
    return {
        **_graphics(),
        "PATH": "/usr/bin:/bin",
        "HOME": folder,
        "TMPDIR": folder,
        "LANG": "C.UTF-8",
        "PYTHONHASHSEED": str(hash_seed),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONSAFEPATH": "1",
        "PYTHONUNBUFFERED": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
        "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
        "SDL_VIDEODRIVER": "dummy",
        "SDL_AUDIODRIVER": "dummy",
        "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    }


def _graphics() -> dict[str, str]:
    """The path of the package glfw's library: the package would start programs to find it, and a job cannot."""
    found = importlib.util.find_spec("glfw")
    library = Path(found.origin).parent / "x11" / "libglfw.so" if found is not None and found.origin else None
    return {"PYGLFW_LIBRARY": str(library)} if library is not None and library.is_file() else {}


def command(folder: str = JOB_FOLDER, read: Iterable[str] = ()) -> list[str]:
    """The worker's command line without its connection to the host. Jobs may read `read` besides what they import."""
    argv = [sys.executable, "-B", "-s", "-P", "-m", "envcraft_sandbox.worker", "--folder", folder]
    return argv + [word for path in read for word in ("--read", path)]


def module_paths(found: Installed = Installed()) -> list[str]:  # noqa: B008 (it is immutable)
    """The folders where the worker finds its modules: this package's, that of the libraries, and others in use."""
    libraries = []
    for name in ("numpy", "xxhash", "PIL"):
        # Not imported: the worker starts while the host imports NumPy.
        spec = importlib.util.find_spec(name)
        assert spec is not None
        assert spec.origin is not None
        libraries.append(str(Path(spec.origin).resolve().parent.parent))
    return list(dict.fromkeys([str(PACKAGE_ROOT), *libraries, *found.paths]))


class ChildWorker(ForkServerWorker):
    """A fork server that is a child of this process. Its `folder` is removed when it ends."""

    def __init__(
        self, process: subprocess.Popen[bytes], control: socket.socket, limits: Limits, folder: Path | None = None
    ) -> None:
        self._process = process
        self._folder = folder
        self._closing = threading.Lock()
        super().__init__(control, limits)

    def close(self) -> None:
        super().close()
        # The thread of a job and the thread that ends the subject may both close the worker.
        with self._closing:
            if self._process.poll() is None:
                try:
                    self._process.wait(timeout=2)
                except subprocess.TimeoutExpired:
                    self._process.kill()
                    self._process.wait()
            if self._process.stderr:
                self._process.stderr.close()
            if self._folder is not None:
                leftovers.remove(self._folder)


def start(
    argv: list[str], variables: dict[str, str], limits: Limits, name: str, folder: Path | None = None
) -> Callable[[], ChildWorker]:
    """Start `argv` with ``--fd N`` appended, where N is the control socket.

    Returns:
        A function that waits until the worker is ready.

    Raises:
        SandboxUnavailable: the program does not start. The returned function raises it, too.
    """
    process, ours = spawn(argv, variables, name)

    def wait() -> ChildWorker:
        try:
            return ChildWorker(process, ours, limits, folder)
        except WorkerLost as error:
            # Read these first: a worker that is only late would report the closed socket.
            words = last_words(process)
            ours.close()
            raise SandboxUnavailable(f"the {name} sandbox did not start: {words or error}") from None

    return wait


def spawn(argv: list[str], variables: dict[str, str], name: str) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start `argv` with ``--fd N`` appended; return the process and the other end of that socket.

    Raises SandboxUnavailable.
    """
    ours, theirs = socket.socketpair()
    try:
        process = subprocess.Popen(
            [*argv, "--fd", str(theirs.fileno())],
            env=variables,
            cwd="/",
            pass_fds=[theirs.fileno(), leftovers.lifeline()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
    except OSError as error:
        ours.close()
        theirs.close()
        raise SandboxUnavailable(f"the {name} sandbox did not start: {error}") from None
    theirs.close()
    return process, ours


def last_words(process: subprocess.Popen[bytes]) -> str:
    """End a process that should have ended by itself; return the last line of its standard error."""
    try:
        _, stderr = process.communicate(timeout=2)
    except subprocess.TimeoutExpired:
        process.kill()
        _, stderr = process.communicate()
    lines = stderr.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""
