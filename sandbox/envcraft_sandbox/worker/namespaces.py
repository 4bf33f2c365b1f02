"""Own namespaces for each fork server of a zygote, inside the namespaces that they all share.

This does what ``bwrap`` does for a worker that it starts: the fork server has its own users, processes, mounts, IPC,
network, host name and control groups, drops its capabilities there, and can create no further user namespace (``bwrap
--disable-userns``). It needs no privilege, only a kernel that allows nested namespaces.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
from collections.abc import Callable
from typing import NoReturn

from . import confine

#: CLONE_NEWNS, CLONE_NEWCGROUP, CLONE_NEWUTS, CLONE_NEWIPC, CLONE_NEWUSER, CLONE_NEWPID and CLONE_NEWNET.
_ALL = 0x00020000 | 0x02000000 | 0x04000000 | 0x08000000 | 0x10000000 | 0x20000000 | 0x40000000
_MS_RDONLY, _MS_NOSUID, _MS_NODEV, _MS_NOEXEC = 1, 2, 4, 8
_MS_REMOUNT, _MS_BIND, _MS_REC, _MS_PRIVATE = 1 << 5, 1 << 12, 1 << 14, 1 << 18
_PR_CAPBSET_DROP = 24
_KEYCTL = {"x86_64": 250, "aarch64": 219}
_KEYCTL_JOIN_SESSION_KEYRING = 1

#: Paths in /proc where root could write to settings of the whole machine; bwrap covers the same.
_COVERED = ("sys", "sysrq-trigger", "irq", "bus")
_SHM_BYTES = 1024**2


def enter(folder: str, size: int, report: Callable[[int], None]) -> None:
    """Continue as process 1 of new namespaces, where `folder` is an empty file system of `size` bytes. Raises OSError.

    The calling process does not return: it calls `report` with the id of the new process, and exits.
    """
    _unshare()
    # The process that creates a process namespace stays outside it.
    pid = os.fork()
    if pid:
        _leave(pid, report)
    _mount(None, "/", None, _MS_REC | _MS_PRIVATE)
    _mount("tmpfs", folder, "tmpfs", _MS_NOSUID | _MS_NODEV, f"mode=0700,size={size}")
    _mount("tmpfs", "/dev/shm", "tmpfs", _MS_NOSUID | _MS_NODEV, f"mode=0700,size={_SHM_BYTES}")
    _mount("proc", "/proc", "proc", _MS_NOSUID | _MS_NODEV | _MS_NOEXEC)
    _write("/proc/sys/user/max_user_namespaces", "0")
    for name in _COVERED:
        _cover(f"/proc/{name}")
    _drop_capabilities()


def _leave(pid: int, report: Callable[[int], None]) -> NoReturn:
    report(pid)
    os._exit(0)


def _unshare() -> None:
    uid, gid = os.getuid(), os.getgid()
    # The files in /proc of a process that is not dumpable belong to root.
    confine.set_dumpable(True)
    _call("unshare", _ALL)
    _write("/proc/self/setgroups", "deny")
    _write("/proc/self/uid_map", f"{uid} {uid} 1")
    _write("/proc/self/gid_map", f"{gid} {gid} 1")
    confine.set_dumpable(False)
    if platform.machine() in _KEYCTL:
        # The session keyring is inherited, unlike those of users. Some kernels have none.
        with contextlib.suppress(OSError):
            _call("syscall", _KEYCTL[platform.machine()], _KEYCTL_JOIN_SESSION_KEYRING, None)


def _cover(path: str) -> None:
    """Make a path read-only."""
    with contextlib.suppress(FileNotFoundError):
        _mount(path, path, None, _MS_BIND | _MS_REC)
        protected = _MS_RDONLY | _MS_NOSUID | _MS_NODEV | _MS_NOEXEC
        _mount(None, path, None, _MS_REMOUNT | _MS_BIND | protected)


def _drop_capabilities() -> None:
    libc = ctypes.CDLL(None)
    for capability in range(64):
        if libc.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0):
            break
    confine.drop_capabilities()
    confine.allow_no_new_privileges()


def _mount(source: str | None, target: str, kind: str | None, flags: int, options: str | None = None) -> None:
    given = [value if value is None else value.encode() for value in (source, target, kind, options)]
    _call("mount", *given[:3], ctypes.c_ulong(flags), given[3])


def _write(path: str, words: str) -> None:
    # The kernel accepts only a single write.
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(descriptor, words.encode())
    finally:
        os.close(descriptor)


def _call(name: str, *arguments: int | bytes | ctypes.c_ulong | None) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, name)(*arguments) < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"{name}: {os.strerror(code)}")
