"""What a job's child gives up before untrusted code runs in it: resources, privileges, files and system calls.

These layers hold beside whatever isolation the driver gives, and each without the others.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import struct
import sys
from collections.abc import Iterable
from typing import Any

from . import landlock, seccomp

_PR_SET_DUMPABLE = 4
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38
_CAPABILITIES_3 = 0x20080522

_SYSTEM = ("/usr", "/lib", "/lib32", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/etc/fonts")
_KERNEL = ("/dev/zero", "/dev/random", "/dev/urandom", "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system/cpu")


def layers() -> tuple[list[str], list[str]]:
    """The layers that :func:`enter` applies on this kernel, and those that it cannot."""
    offered = {
        "rlimits": True,
        "no capabilities": sys.platform == "linux",
        "no new privileges": sys.platform == "linux",
        "Landlock": landlock.version() > 0,
        "system call filter": seccomp.available(),
    }
    return [name for name, there in offered.items() if there], [name for name, there in offered.items() if not there]


def prepare(folder: str, read: Iterable[str] = ()) -> int | None:
    """What is the same for every job, made before the first is forked: a descriptor for :func:`enter`, or None without
    Landlock. Jobs may write in `folder` alone, and read the libraries and `read`. Raises OSError.
    """
    if seccomp.available():
        seccomp.prepare()
    if not landlock.version():
        return None
    return landlock.ruleset([*_SYSTEM, *_KERNEL, *_libraries(), *read], [folder, "/dev/null"])


def enter(limits: dict[str, Any], shown: int | None) -> None:
    """Apply `limits` (``memory`` and ``file`` in bytes, ``cpu`` in seconds, ``descriptors`` as a count) and what
    :func:`prepare` gave, whose descriptor is closed. Raises OSError when a layer that the kernel has cannot be applied.
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
    """Say whether processes of the same user may trace this one and read its memory."""
    _prctl(_PR_SET_DUMPABLE, int(value))


def adopt_orphans() -> None:
    """Make processes that a descendant leaves behind this process's children."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def drop_capabilities() -> None:
    """Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.capset(struct.pack("<Ii", _CAPABILITIES_3, 0), struct.pack("<6I", *[0] * 6)):
        raise OSError(ctypes.get_errno(), "the capabilities cannot be dropped")


def allow_no_new_privileges() -> None:
    """No program that this process starts gets more rights than it has."""
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)


def _libraries() -> list[str]:
    """The interpreter's folders, and what the driver put on the path; not what a ``.pth`` file adds, which may be a
    project's whole folder.
    """
    told = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    return [sys.prefix, sys.base_prefix, sys.exec_prefix, *filter(None, told)]


def _offer_to_the_oom_killer() -> None:
    """When memory runs out, let the kernel end the job and not the fork server, which is of the same size at first."""
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
