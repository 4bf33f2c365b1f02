"""Files that commands write their results to."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import BinaryIO, TextIO

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


@contextlib.contextmanager
def report_file(path: str) -> Iterator[TextIO]:
    """Open the file of a report as text. Raises UsageError."""
    with output_file(path, "the report ") as data:
        stream = io.TextIOWrapper(data, "utf-8")
        try:
            yield stream
        finally:
            stream.detach()
