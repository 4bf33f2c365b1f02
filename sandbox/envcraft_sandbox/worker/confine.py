"""What a job's child gives up before untrusted code runs in it: resource limits and the right to new privileges."""

from __future__ import annotations

import contextlib
import resource
import sys
from pathlib import Path
from typing import Any

_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38


def available_layers() -> list[str]:
    """Name the layers that :func:`enter` applies on this kernel."""
    return ["rlimits", *(["no-new-privs"] if sys.platform == "linux" else [])]


def enter(limits: dict[str, Any]) -> None:
    """Apply `limits`: ``memory`` and ``file`` in bytes, ``cpu`` in seconds, ``descriptors`` as a count."""
    if sys.platform == "linux":
        _prctl(_PR_SET_NO_NEW_PRIVS, 1)
        _offer_to_the_oom_killer()
        _limit(resource.RLIMIT_DATA, limits["memory"])
        _limit(resource.RLIMIT_AS, 2 * limits["memory"])
    _limit(resource.RLIMIT_FSIZE, limits["file"])
    _limit(resource.RLIMIT_CPU, limits["cpu"])
    _limit(resource.RLIMIT_NOFILE, limits["descriptors"])


def set_dumpable(value: bool) -> None:
    """Say whether processes of the same user may trace this one and read its memory."""
    _prctl(_PR_SET_DUMPABLE, int(value))


def adopt_orphans() -> None:
    """Make processes that a descendant leaves behind this process's children."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _offer_to_the_oom_killer() -> None:
    """When memory runs out, let the kernel end the job and not the fork server, which is of the same size at first."""
    # The files in /proc of a process that is not dumpable belong to root.
    set_dumpable(True)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")
    set_dumpable(False)


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _limit(which: int, value: int) -> None:
    _, hard = resource.getrlimit(which)
    if hard != resource.RLIM_INFINITY:
        value = min(value, hard)
    resource.setrlimit(which, (value, value))
