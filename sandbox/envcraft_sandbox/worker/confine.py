"""What a job's child gives up before untrusted code runs in it: resource limits and the right to new privileges."""

from __future__ import annotations

import resource
import sys
from typing import Any

_PR_SET_NO_NEW_PRIVS = 38


def available_layers() -> list[str]:
    """Name the layers that :func:`enter` applies on this kernel."""
    return ["rlimits", *(["no-new-privs"] if sys.platform == "linux" else [])]


def enter(limits: dict[str, Any]) -> None:
    """Apply `limits`: ``memory`` and ``file`` in bytes, ``cpu`` in seconds, ``descriptors`` as a count."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
        _limit(resource.RLIMIT_DATA, limits["memory"])
        _limit(resource.RLIMIT_AS, 2 * limits["memory"])
    _limit(resource.RLIMIT_FSIZE, limits["file"])
    _limit(resource.RLIMIT_CPU, limits["cpu"])
    _limit(resource.RLIMIT_NOFILE, limits["descriptors"])


def _limit(which: int, value: int) -> None:
    _, hard = resource.getrlimit(which)
    if hard != resource.RLIM_INFINITY:
        value = min(value, hard)
    resource.setrlimit(which, (value, value))
