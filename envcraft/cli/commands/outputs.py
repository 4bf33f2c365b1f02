"""Files that commands write their results to."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import BinaryIO

from envcraft.errors import UsageError
from envcraft.files import atomic_write


@contextlib.contextmanager
def output_file(path: str, what: str = "") -> Iterator[BinaryIO]:
    """Open a file with :func:`envcraft.files.atomic_write`.

    Args:
        path: the file.
        what: words for messages, before the path.

    Raises:
        UsageError: if the file cannot be written.
    """
    with contextlib.ExitStack() as stack:
        try:
            stream = stack.enter_context(atomic_write(path))
        except OSError as error:
            raise UsageError(f"{what}{path} cannot be written: {error.strerror}") from None
        yield stream
