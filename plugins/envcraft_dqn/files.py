"""Atomic writes, and a lock for one run per folder."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import UsageError
from envcraft.files import atomic_write

_LOCK = "lock"


def write_atomically(path: Path, data: bytes | str, sync: bool = False) -> None:
    """Replace a file by another with new contents. A reader sees either the old contents or the new.

    Args:
        path: The file. Missing folders are created.
        data: The new contents; text is encoded as UTF-8.
        sync: Whether to flush the data to disk first, so that it survives a power failure.

    Raises:
        OSError: The file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path, sync=sync) as file:
        file.write(data.encode() if isinstance(data, str) else data)


@contextlib.contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes. The lock is released even if this process is killed.

    Raises:
        UsageError: Another process holds the lock, or the folder is not writable.
    """
    try:
        descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise UsageError(f"{folder} cannot be written to: {error.strerror or error}") from None
    with open(descriptor, "rb+", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = file.read(20).decode("ascii", "replace")
            who = f"process {holder}" if holder.isdigit() else "another process"
            raise UsageError(
                f"{who} is running in {folder}: wait until it ends, stop it, or choose another --output"
            ) from None
        file.truncate(0)
        file.write(str(os.getpid()).encode())
        yield
