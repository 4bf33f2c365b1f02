"""Errors that a person reads: one sentence with the value and the next step, printed without a traceback."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit status of the commands that judge environments."""

    PASS = 0  #: every subject passes
    FAIL = 1  #: at least one subject fails
    USAGE = 2  #: wrong use (Click's own)
    ERROR = 3  #: something could not be judged; never counted as a bad environment


class EnvCraftError(Exception):
    """Base of the errors that EnvCraft raises on purpose."""

    exit_code = ExitCode.ERROR


class UsageError(EnvCraftError):
    """What the user asked for does not exist or does not go together."""

    exit_code = ExitCode.USAGE


class SandboxUnavailable(EnvCraftError):
    """No sandbox of the wanted kind works on this machine."""


class WorkerLost(EnvCraftError):
    """The worker itself, not the code that it ran, stopped answering."""


class TargetLost(EnvCraftError):
    """What is to be judged cannot be read any more: the target at `path`, whose source had the digest `sha256`."""

    def __init__(self, path: str, env_class: str | None, sha256: str, reason: str) -> None:
        super().__init__(reason)
        self.path, self.env_class, self.sha256 = path, env_class, sha256


class EnvironmentFailed(EnvCraftError):
    """An environment that is in use raised, died, or gave what its spaces do not have."""


class MalformedValue(ValueError):
    """A value from the worker, its layout or its bytes are not what the protocol allows."""
