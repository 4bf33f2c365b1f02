"""The Docker engine, reached by its command line: no SDK, and no shell."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from typing import IO, Any

from envcraft.errors import SandboxUnavailable

_INSTALL = "install Docker (on Debian and Ubuntu the package docker.io)"
_START = "start the Docker engine (`systemctl start docker`)"
_ALLOW = "let this user use the engine (`usermod -aG docker USER`, then log in again)"


class EngineError(SandboxUnavailable):
    """The engine is missing or refused; `fix` is what to do about it."""

    def __init__(self, reason: str, fix: str = "see `envcraft doctor`") -> None:
        super().__init__(f"{reason}; {fix}")
        self.reason = reason
        self.fix = fix


def docker(*arguments: str, timeout: float = 30.0) -> str:
    """Run ``docker`` and give what it printed. Raises EngineError."""
    try:
        done = subprocess.run(
            ["docker", *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=timeout,
            check=False,
        )
    except FileNotFoundError:
        raise EngineError("the command docker is not installed", _INSTALL) from None
    except OSError as error:
        raise EngineError(f"the command docker does not run: {error.strerror}", _INSTALL) from None
    except subprocess.TimeoutExpired:
        raise EngineError(f"docker {arguments[0]} did not answer within {timeout:g} s", _START) from None
    if done.returncode:
        raise _refusal(done.stderr)
    return done.stdout.decode(errors="replace").strip()


def docker_aloud(*arguments: str, say: Callable[[str], None], feed: Callable[[IO[bytes]], None] | None = None) -> None:
    """Run a ``docker`` command that takes long: `say` gets its output line by line, `feed` writes to its input.

    Raises EngineError with its last words.
    """
    try:
        process = subprocess.Popen(
            ["docker", *arguments],
            stdin=subprocess.PIPE if feed else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
    except OSError as error:
        raise EngineError(f"the command docker does not run: {error.strerror}", _INSTALL) from None
    with process:
        if feed and process.stdin:
            try:
                feed(process.stdin)
                process.stdin.close()
            except BrokenPipeError:
                # It refused the input; why, its output tells.
                pass
            except BaseException:
                process.kill()
                raise
        last = b""
        for line in process.stdout or ():
            if line.strip():
                last = line
                say(line.decode(errors="replace").rstrip())
    if process.returncode:
        raise _refusal(last)


def info() -> dict[str, Any]:
    """What the engine says of itself. Raises EngineError when there is none, or it is not this machine's."""
    try:
        told: dict[str, Any] = json.loads(docker("info", "--format", "{{json .}}", timeout=10.0))
    except ValueError:
        raise EngineError("docker info gives no JSON", "use the command docker of Docker 20.10 or later") from None
    # Some versions of the command report an absent engine in its answer, and succeed.
    if told.get("ServerErrors"):
        raise _refusal(str(told["ServerErrors"][0]).encode())
    return told


def last_words(said: bytes) -> str:
    """The last line of what a command wrote that tells why it failed."""
    lines = said.decode(errors="replace").strip().splitlines()
    # Both of these only point to the command's help.
    told = [line for line in lines if line.strip() and not line.startswith(("See 'docker", "Run 'docker"))]
    return told[-1].strip().removeprefix("docker: ").removeprefix("Error response from daemon: ") if told else ""


def _refusal(said: bytes) -> EngineError:
    words = last_words(said).rstrip(".")
    if "permission denied while trying to connect" in words:
        return EngineError("this user may not use the Docker engine", _ALLOW)
    if "cannot connect" in words.lower() or "daemon running" in words:
        return EngineError("no Docker engine answers", _START)
    return EngineError(f"docker refused: {words or 'it gave no reason'}")
