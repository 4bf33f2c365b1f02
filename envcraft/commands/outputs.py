"""Files that commands write what they found to."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from typing import BinaryIO

from envcraft.errors import UsageError


@contextlib.contextmanager
def whole(path: str, what: str = "") -> Iterator[BinaryIO]:
    """A file that takes the place of an older one once it is whole, and not where an exception ends its writing; what
    is no plain file, such as a device, is written to as it is. `what` goes before its name in messages.

    Raises UsageError where there can be no such file.
    """
    place = os.path.realpath(path)
    new = None
    try:
        if os.path.exists(place) and not os.path.isfile(place):
            stream: BinaryIO = open(place, "wb")  # noqa: SIM115 (closed below, like the other)
        else:
            mode = os.stat(place).st_mode & 0o777 if os.path.exists(place) else 0o666 & ~_umask()
            descriptor, new = tempfile.mkstemp(prefix=f".{os.path.basename(place)}-", dir=os.path.dirname(place))
            os.fchmod(descriptor, mode)
            stream = open(descriptor, "wb")  # noqa: SIM115
    except OSError as error:
        raise UsageError(f"{what}{path} cannot be written: {error.strerror}") from None
    try:
        with stream:
            yield stream
        if new is not None:
            os.replace(new, place)
    except BaseException:
        if new is not None:
            with contextlib.suppress(OSError):
                os.unlink(new)
        raise


def _umask() -> int:
    """Reading it takes setting it."""
    found = os.umask(0o077)
    os.umask(found)
    return found
