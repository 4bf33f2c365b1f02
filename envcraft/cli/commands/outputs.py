"""Files that commands write their results to."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from typing import BinaryIO, TextIO

from envcraft.errors import UsageError
from envcraft.files import atomic_write


@contextlib.contextmanager
def output_file(path: str, what: str = "", setting: str = "") -> Iterator[BinaryIO]:
    """Open a file with :func:`envcraft.files.atomic_write`.

    Args:
        path: the file.
        what: words for messages, before the path.
        setting: the option that names the file.

    Raises:
        UsageError: if the file cannot be written.
    """
    with contextlib.ExitStack() as stack:
        try:
            stream = stack.enter_context(atomic_write(path))
        except OSError as error:
            raise UsageError(f"{what}{path} cannot be written: {error.strerror}", setting) from None
        yield stream


@contextlib.contextmanager
def report_stream(path: str | None, first: bool) -> Iterator[TextIO]:
    """Open the stream of a report.

    Args:
        path: the file; None, an empty text or ``-`` for standard output.
        first: whether ``--output`` names the file, and not ``--report``.

    Raises:
        UsageError: if the file cannot be written.
    """
    if not path or path == "-":
        yield sys.stdout
        return
    with output_file(path, "the report ", "output" if first else "report") as data:
        stream = io.TextIOWrapper(data, "utf-8")
        try:
            yield stream
        finally:
            stream.detach()
