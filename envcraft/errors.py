"""Errors for people: one sentence with the value and the next step, printed without a traceback."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """Exit status of the commands that judge environments."""

    PASS = 0  #: every subject passes
    FAIL = 1  #: at least one subject fails
    USAGE = 2  #: usage error (Click's own)
    ERROR = 3  #: something could not be judged; never counted as a bad environment


class EnvCraftError(Exception):
    """Base class of EnvCraft's own errors.

    Attributes:
        setting: the option whose value is wrong, without dashes, such as ``contract``; "" if it is not known.
    """

    exit_code = ExitCode.ERROR

    def __init__(self, message: str = "", setting: str = "") -> None:
        super().__init__(message)
        self.setting = setting

    @property
    def in_a_command(self) -> str:
        """The message for someone who types options instead of arguments."""
        return str(self)


class UsageError(EnvCraftError):
    """A name or an option does not exist, or options contradict each other."""

    exit_code = ExitCode.USAGE


class SandboxUnavailable(EnvCraftError):
    """No sandbox of the requested kind works on this machine."""


class WorkerLost(EnvCraftError):
    """The worker itself stopped answering, not the code that it ran."""


class TargetLost(EnvCraftError):
    """The target at `path` cannot be read any more; its source had the digest `sha256`."""

    def __init__(self, path: str, env_class: str | None, sha256: str, reason: str) -> None:
        super().__init__(reason)
        self.path, self.env_class, self.sha256 = path, env_class, sha256


class EnvironmentFailed(EnvCraftError):
    """An environment in use raised, died, or returned a value outside its spaces."""


class MalformedValue(ValueError):
    """The protocol does not allow a value from the worker, its layout or its bytes."""


class Skip(Exception):
    """A check does not apply to this subject; the message is the reason."""


class Undecided(Skip):
    """A check applies, and cannot settle its question within the budget."""
