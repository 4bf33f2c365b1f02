"""Files that are written completely or not at all."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from typing import BinaryIO

from envcraft.errors import UsageError
from envcraft.text import relative

#: How the name of an unfinished file begins. One stays only if the process is killed.
UNFINISHED = ".new-"


def refuse_file(path: str | os.PathLike[str]) -> None:
    """Raise UsageError if the path of a folder to write is a file, or below a file."""
    place = os.path.abspath(path)
    while not os.path.lexists(place):
        place = os.path.dirname(place)
    if not os.path.isdir(place):
        shown = os.fspath(path) if place == os.path.abspath(path) else relative(place)
        raise UsageError(f"{shown} is a file; name a folder")


@contextlib.contextmanager
def atomic_write(
    path: str | os.PathLike[str], *, temporary: str | os.PathLike[str] | None = None, sync: bool = False
) -> Iterator[BinaryIO]:
    """Open a binary stream whose content replaces the file at `path` when the block ends without an exception.

    A link is followed, and an existing file keeps its mode. What is not a regular file, such as a device, is written
    directly.

    Args:
        path: the file to write, in a folder that exists.
        temporary: the folder of the unfinished file, on the same file system; by default that of `path`.
        sync: whether to flush the content to the disk before the replacement, and the folder after it.

    Raises:
        OSError: if the file cannot be written.
    """
    place = os.fspath(path)
    mode = _mode(place)
    if mode is not None and stat.S_ISLNK(mode):
        place = os.path.realpath(place)
        mode = _mode(place)
    if mode is not None and not stat.S_ISREG(mode):
        with open(place, "wb") as stream:
            yield stream
        return
    folder = os.path.dirname(place) or os.curdir
    unfinished = os.path.join(temporary or folder, f"{UNFINISHED}{os.urandom(8).hex()}")
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        with open(descriptor, "wb") as stream:
            if mode is not None:
                os.fchmod(descriptor, stat.S_IMODE(mode))
            yield stream
            if sync:
                stream.flush()
                os.fsync(descriptor)
        os.replace(unfinished, place)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(unfinished)
        raise
    if sync:
        _sync(folder)


def _sync(folder: str) -> None:
    """Flush the entries of a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _mode(path: str) -> int | None:
    """The mode of a file, or of a link itself; None if there is none."""
    try:
        return os.lstat(path).st_mode
    except FileNotFoundError:
        return None
