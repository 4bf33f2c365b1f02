"""Observe a running job from outside and report which limit it exceeds.

The kernel's limits apply to one process or one user, and count neither shared memory nor threads as a whole.
"""

from __future__ import annotations

import os

from envcraft_protocol.jobs import Exceeded, JobLimits

from .folder import JobFolder

#: Seconds between two observations.
INTERVAL = 0.1

_PAGE = os.sysconf("SC_PAGE_SIZE")
#: Fields of /proc/PID/stat, counted from the one after the name, which may hold spaces.
_THREADS, _RESIDENT = 17, 21


def available() -> bool:
    return _status(os.getpid()) is not None


def exceeded(pid: int, limits: JobLimits, folder: JobFolder) -> Exceeded | None:
    """The limit that the job of process `pid` exceeds; None if it exceeds none.

    Returns:
        ``memory`` (resident bytes), ``processes`` (threads) or ``disk`` (bytes in its folder).
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
    """Threads and resident bytes of a process; None if the kernel does not report them or the process has ended."""
    try:
        with open(f"/proc/{pid}/stat", errors="replace") as stat:
            fields = stat.read().rpartition(")")[2].split()
        return int(fields[_THREADS]), int(fields[_RESIDENT]) * _PAGE
    except (OSError, ValueError, IndexError):
        return None
