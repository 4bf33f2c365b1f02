"""What every driver starts: the worker's command line and its scrubbed environment."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import numpy

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import Limits

from .client import ForkServerWorker

#: The folder that holds this package, which is all that the worker imports besides the installed libraries.
PACKAGE_ROOT = Path(__file__).resolve().parent.parent


def environment(hash_seed: int, home: str = "/tmp") -> dict[str, str]:
    """The only environment variables that a worker sees. One thread for each numerical library: results and limits
    must not depend on the machine's cores."""
    return {
        "PATH": "/usr/bin:/bin",
        "HOME": home,
        "LANG": "C.UTF-8",
        "PYTHONHASHSEED": str(hash_seed),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONSAFEPATH": "1",
        "PYTHONUNBUFFERED": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "SDL_VIDEODRIVER": "dummy",
        "SDL_AUDIODRIVER": "dummy",
        "PYGAME_HIDE_SUPPORT_PROMPT": "1",
    }


def command(*arguments: str, python: str = sys.executable) -> list[str]:
    """The worker's command line."""
    return [python, "-B", "-s", "-P", "-m", "envcraft_sandbox.worker", *arguments]


def module_paths() -> list[str]:
    """Where the worker of this interpreter finds its modules: the package's own folder and that of the libraries."""
    libraries = str(Path(numpy.__file__).resolve().parent.parent)
    return list(dict.fromkeys([str(PACKAGE_ROOT), libraries]))


class ChildWorker(ForkServerWorker):
    """A fork server that is this process's child."""

    def __init__(self, process: subprocess.Popen[bytes], control: socket.socket, limits: Limits) -> None:
        self._process = process
        super().__init__(control, limits)

    def close(self) -> None:
        super().close()
        if self._process.poll() is None:
            try:
                self._process.wait(timeout=2)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._process.stderr:
            self._process.stderr.close()


def start(argv: list[str], variables: dict[str, str], limits: Limits, name: str) -> ChildWorker:
    """Start `argv` with ``--fd N`` appended, N being the control socket. Raises SandboxUnavailable."""
    ours, theirs = socket.socketpair()
    try:
        process = subprocess.Popen(
            [*argv, "--fd", str(theirs.fileno())],
            env=variables,
            cwd="/",
            pass_fds=[theirs.fileno()],
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
    try:
        return ChildWorker(process, ours, limits)
    except WorkerLost as error:
        ours.close()
        raise SandboxUnavailable(f"the {name} sandbox did not start: {last_words(process) or error}") from None


def last_words(process: subprocess.Popen[bytes]) -> str:
    """End a process that should have ended by itself, and give the last line that it wrote on its standard error."""
    try:
        _, said = process.communicate(timeout=2)
    except subprocess.TimeoutExpired:
        process.kill()
        _, said = process.communicate()
    lines = said.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""
