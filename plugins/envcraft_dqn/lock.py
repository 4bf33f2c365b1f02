"""One run at a time in a folder."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import UsageError

_LOCK = "lock"


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Nobody else has `folder` meanwhile, by whatever this process ends. Raises UsageError, naming who has it."""
    try:
        descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise UsageError(f"{folder} cannot be written to: {error.strerror or error}") from None
    with open(descriptor, "rb+", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = file.read(20).decode("ascii", "replace")
            words = f"process {holder}" if holder.isdigit() else "another process"
            raise UsageError(
                f"{words} is at a run in {folder}: wait until it has ended, or end it, or choose another --output"
            ) from None
        file.truncate(0)
        file.write(str(os.getpid()).encode())
        yield
