"""The container engine, reached through the Docker SDK: Docker, or Podman through its compatible socket.

The SDK takes a fifth of a second to import, so only functions that use it import it.
"""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from envcraft.errors import SandboxUnavailable

if TYPE_CHECKING:
    from docker import APIClient

_EXTRA = "run `pip install 'envcraft-rl[docker]'`"
_START = "install Docker (on Debian and Ubuntu the package docker.io), or start it (`systemctl start docker`)"
_ALLOW = "let this user use the engine (`usermod -aG docker USER`, then log in again)"
_SECONDS = 30.0


class EngineError(SandboxUnavailable):
    """The engine or its SDK is missing, or the engine refused a request.

    Attributes:
        reason: what is wrong, in one line.
        fix: what the user can do about it.
    """

    def __init__(self, reason: str, fix: str = "see `envcraft doctor`") -> None:
        super().__init__(f"{reason}; {fix}")
        self.reason = reason
        self.fix = fix


class NotFoundError(EngineError):
    """The engine has no such image or container."""


class ConflictError(EngineError):
    """The engine is busy with the container, or its name is in use."""


def client(timeout: float = _SECONDS) -> APIClient:
    """Connect to the engine that ``DOCKER_HOST`` or the current Docker context names.

    Args:
        timeout: seconds without an answer after which a request fails.

    Raises:
        EngineError: the SDK is not installed, or no engine answers.
    """
    # A child process must not share its parent's connections.
    return _client(os.getpid(), os.environ.get("DOCKER_HOST"), timeout)


@functools.lru_cache(maxsize=4)
def _client(process: int, host: str | None, timeout: float) -> APIClient:
    with errors():
        import docker
        from docker.context import ContextAPI
        from docker.utils import kwargs_from_env

        # As the docker command does: the variable takes precedence over the context.
        where = kwargs_from_env() if host else ContextAPI.kwargs_from_context()
        return docker.APIClient(version="auto", timeout=timeout, **where)


@contextlib.contextmanager
def errors() -> Iterator[None]:
    """Turn the SDK's exceptions into EngineError."""
    try:
        import requests
        from docker import errors as sdk
    except ImportError as error:
        raise EngineError(f"the Docker SDK cannot be imported ({error})", _EXTRA) from None
    try:
        yield
    except sdk.APIError as error:
        reason = one_line(error.explanation or error) or "it gave no reason"
        kinds = {404: NotFoundError, 409: ConflictError}
        raise kinds.get(error.status_code, EngineError)(f"the engine refused: {reason}") from None
    except (sdk.DockerException, requests.exceptions.RequestException, OSError, ValueError) as error:
        causes = list(_causes(error))
        if any(isinstance(cause, PermissionError) for cause in causes):
            raise EngineError("this user may not use the container engine", _ALLOW) from None
        if any(isinstance(cause, TimeoutError | requests.exceptions.Timeout) for cause in causes):
            raise EngineError("the container engine did not answer in time", _START) from None
        fix = f"{_START}, or correct DOCKER_HOST" if os.environ.get("DOCKER_HOST") else _START
        raise EngineError(f"no container engine answers ({_reason(causes)})", fix) from None


def progress(events: Iterable[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of a build or a pull. Raises EngineError where it fails."""
    with errors():
        for event in events:
            if "error" in event:
                raise EngineError(f"the engine refused: {one_line(event['error'])}")
            # A download repeats its status with each block.
            text = event.get("stream") or ("" if event.get("progressDetail") else event.get("status", ""))
            yield from (line for line in text.splitlines() if line.strip())


def one_line(text: object) -> str:
    """The last line of a text that is not empty, without a final full stop."""
    lines = str(text).strip().splitlines()
    return lines[-1].strip().rstrip(".") if lines else ""


def _reason(causes: list[BaseException]) -> str:
    """Why nothing answers, without the number of an error."""
    if any(isinstance(cause, FileNotFoundError) for cause in causes):
        return "its socket does not exist"
    told = [cause.strerror for cause in causes if isinstance(cause, OSError) and cause.strerror]
    return told[-1] if told else one_line(causes[-1])


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """An exception and those that led to it, the first one last."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
