"""Files that commands write what they found to."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from functools import partial
from typing import BinaryIO

from envcraft.errors import UsageError


@contextlib.contextmanager
def whole(path: str, what: str = "") -> Iterator[BinaryIO]:
    """A file that takes the place of an older one once it is whole, and not where an exception ends its writing; what
    is no plain file, such as a device, is written to as it is. `what` goes before its name in messages.

    Raises UsageError where there can be no such file.
    """
    place = os.path.realpath(path)
    with contextlib.ExitStack() as stack:
        try:
            if os.path.exists(place) and not os.path.isfile(place):
                stream: BinaryIO = stack.enter_context(open(place, "wb"))
            else:
                mode = os.stat(place).st_mode & 0o777 if os.path.exists(place) else 0o666 & ~_umask()
                descriptor, new = tempfile.mkstemp(prefix=f".{os.path.basename(place)}-", dir=os.path.dirname(place))
                stack.push(partial(_settle, new, place))
                stream = stack.enter_context(open(descriptor, "wb"))
                os.fchmod(descriptor, mode)
        except OSError as error:
            raise UsageError(f"{what}{path} cannot be written: {error.strerror}") from None
        yield stream


def _settle(new: str, place: str, wrong: type[BaseException] | None, *_: object) -> None:
    """Put a new file in its place, or where something went wrong, away."""
    try:
        if wrong is None:
            os.replace(new, place)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(new)


def _umask() -> int:
    """Reading it takes setting it."""
    found = os.umask(0o077)
    os.umask(found)
    return found
