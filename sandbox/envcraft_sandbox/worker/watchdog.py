"""Look at a running job from outside and tell what it holds beyond its limits.

Limits of the kernel are for one process or one user, and count neither shared memory nor threads as a whole.
"""

from __future__ import annotations

import os
from typing import Any

from .folder import JobFolder

#: Seconds between two looks.
INTERVAL = 0.1

_PAGE = os.sysconf("SC_PAGE_SIZE")
#: Fields of /proc/PID/stat, counted from the one after the name, which may hold spaces.
_THREADS, _RESIDENT = 17, 21


def available() -> bool:
    return _status(os.getpid()) is not None


def exceeded(pid: int, limits: dict[str, Any], folder: JobFolder) -> str | None:
    """Name the limit that the job of process `pid` exceeds: ``memory`` (resident bytes), ``processes`` (threads) or
    ``disk`` (bytes in its folder); None while it keeps to all.
    """
    found = _status(pid)
    if found is None:
        return None
    threads, resident = found
    if resident > limits["memory"]:
        return "memory"
    if threads > limits["processes"]:
        return "processes"
    return "disk" if folder.bytes(limits["disk"]) > limits["disk"] else None


def _status(pid: int) -> tuple[int, int] | None:
    """Threads and resident bytes of a process; None where the kernel does not tell, or it has ended."""
    try:
        with open(f"/proc/{pid}/stat", errors="replace") as told:
            fields = told.read().rpartition(")")[2].split()
        return int(fields[_THREADS]), int(fields[_RESIDENT]) * _PAGE
    except (OSError, ValueError, IndexError):
        return None
