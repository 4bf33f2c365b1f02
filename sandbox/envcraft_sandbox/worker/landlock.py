"""Landlock: the process then reads only the given paths and writes only below one folder.

It needs no privilege and adds to the driver's isolation. What it can refuse depends on the kernel: files since 5.13,
TCP ports since 6.7, signals and abstract sockets outside the process's own domain since 6.12
(``Documentation/userspace-api/landlock.rst``).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterable

# The same numbers on every architecture.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION = 1
_PATH_BENEATH = 1

_WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 1, 1 << 2, 1 << 3
#: Execute, write, read, list, remove, and make each kind of file.
_FIRST = (1 << 13) - 1
_REFER, _TRUNCATE, _IOCTL_DEV = 1 << 13, 1 << 14, 1 << 15
_BIND_CONNECT_TCP = 0b11
_ABSTRACT_SOCKETS_SIGNALS = 0b11
_EXECUTE = 1
_DEVICES_AND_SOCKETS = 1 << 6 | 1 << 9 | 1 << 11


def version() -> int:
    """The version of Landlock that this kernel offers; 0 for none."""
    if sys.platform != "linux":
        return 0
    return max(int(ctypes.CDLL(None).syscall(_CREATE_RULESET, None, 0, _VERSION)), 0)


def ruleset(read: Iterable[str], write: Iterable[str]) -> int:
    """The descriptor of a set of rules for :func:`restrict`. Raises OSError.

    Args:
        read: files and folders to read; missing ones are skipped.
        write: files and folders to read and write; missing ones are skipped.
    """
    abi = version()
    handled = _FIRST
    for since, right in ((2, _REFER), (3, _TRUNCATE), (5, _IOCTL_DEV)):
        handled |= right if abi >= since else 0
    attributes = struct.pack(
        "<QQQ", handled, _BIND_CONNECT_TCP if abi >= 4 else 0, _ABSTRACT_SOCKETS_SIGNALS if abi >= 6 else 0
    )
    size = 24 if abi >= 6 else 16 if abi >= 4 else 8
    made = _call(_CREATE_RULESET, attributes, size, 0)
    try:
        for paths, rights in ((read, _READ_FILE | _READ_DIR), (write, handled & ~_EXECUTE & ~_DEVICES_AND_SOCKETS)):
            for path in paths:
                with contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError):
                    _allow(made, path, rights & handled)
    except BaseException:
        os.close(made)
        raise
    return made


def restrict(rules: int) -> None:
    """Apply `rules` for good to this process and all that it starts, and close them. Raises OSError.

    No new privileges must have been set.
    """
    try:
        _call(_RESTRICT_SELF, rules, 0)
    finally:
        os.close(rules)


def _allow(rules: int, path: str, rights: int) -> None:
    descriptor = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        if not os.path.isdir(path):
            rights &= _READ_FILE | _WRITE_FILE | _TRUNCATE
        _call(_ADD_RULE, rules, _PATH_BENEATH, struct.pack("<Qi", rights, descriptor), 0)
    finally:
        os.close(descriptor)


def _call(number: int, *arguments: int | bytes) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    given = [ctypes.c_long(value) if isinstance(value, int) else value for value in arguments]
    result: int = libc.syscall(ctypes.c_long(number), *given)
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, f"Landlock on {platform.release()}: {os.strerror(code)}")
    return result
