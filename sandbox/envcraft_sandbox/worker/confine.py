"""Limits and rights that a job's child gives up before untrusted code runs in it.

These layers add to the driver's isolation, and each holds without the others.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import struct
import sys
from collections.abc import Iterable

from envcraft_protocol.jobs import JobLimits

from . import landlock, seccomp

_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_CAPABILITIES_3 = 0x20080522

_SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/etc/fonts")
_KERNEL = ("/dev/zero", "/dev/random", "/dev/urandom", "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system/cpu")


def layers() -> tuple[list[str], list[str]]:
    """The layers that :func:`enter` applies on this kernel, and those that it cannot apply."""
    offered = {
        "rlimits": True,
        "no capabilities": sys.platform == "linux",
        "no new privileges": sys.platform == "linux",
        "Landlock": landlock.version() > 0,
        "system call filter": seccomp.available(),
    }
    return [name for name, there in offered.items() if there], [name for name, there in offered.items() if not there]


def prepare(folder: str, read: Iterable[str] = ()) -> int | None:
    """Prepare the part that is the same for every job, before the first fork.

    Args:
        folder: the only folder that jobs may write to.
        read: paths that jobs may read besides the libraries.

    Returns:
        A descriptor for :func:`enter`; None without Landlock.

    Raises:
        OSError: the rules cannot be made.
    """
    if seccomp.available():
        seccomp.prepare()
    if not landlock.version():
        return None
    return landlock.ruleset([*_SYSTEM, *_KERNEL, *_libraries(), *read], [folder, "/dev/null"])


def enter(limits: JobLimits, shown: int | None) -> None:
    """Apply `limits` and the result of :func:`prepare`, whose descriptor it closes.

    Raises OSError if a layer that the kernel has cannot be applied.
    """
    if sys.platform == "linux":
        _offer_to_the_oom_killer()
        _limit(resource.RLIMIT_DATA, limits["memory"])
        _limit(resource.RLIMIT_AS, 2 * limits["memory"])
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_FSIZE, limits["file"])
    _limit(resource.RLIMIT_CPU, limits["cpu"])
    _limit(resource.RLIMIT_NOFILE, limits["descriptors"])
    if sys.platform != "linux":
        return
    drop_capabilities()
    allow_no_new_privileges()
    if shown is not None:
        landlock.restrict(shown)
    if seccomp.available():
        seccomp.restrict()


def set_dumpable(value: bool) -> None:
    """Set whether processes of the same user may trace this one and read its memory."""
    _prctl(_PR_SET_DUMPABLE, int(value))


def adopt_orphans() -> None:
    """Become the parent of processes that a descendant leaves behind."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def drop_capabilities() -> None:
    """Drop all capabilities. Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.capset(struct.pack("<Ii", _CAPABILITIES_3, 0), struct.pack("<6I", *[0] * 6)):
        raise OSError(ctypes.get_errno(), "the capabilities cannot be dropped")


def allow_no_new_privileges() -> None:
    """Deny programs that this process starts more rights than it has."""
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)


def _libraries() -> list[str]:
    """The interpreter's folders and those that the driver put on the path.

    Folders from ``.pth`` files are excluded: they may be a whole project.
    """
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return [sys.prefix, sys.base_prefix, sys.exec_prefix, *filter(None, paths)]


def _offer_to_the_oom_killer() -> None:
    """Make the kernel end the job, not the fork server of the same size, when memory runs out."""
    # The files in /proc of a process that is not dumpable belong to root.
    set_dumpable(True)
    with contextlib.suppress(OSError):
        adjustment = os.open("/proc/self/oom_score_adj", os.O_WRONLY)
        try:
            os.write(adjustment, b"1000")
        finally:
            os.close(adjustment)
    set_dumpable(False)


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _limit(which: int, value: int) -> None:
    _, hard = resource.getrlimit(which)
    if hard != resource.RLIM_INFINITY:
        value = min(value, hard)
    resource.setrlimit(which, (value, value))
