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
        OSError: if the disk is full at the end; it names the file.
    """
    inside: BaseException | None = None
    try:
        with contextlib.ExitStack() as stack:
            try:
                stream = stack.enter_context(atomic_write(path))
            except OSError as error:
                raise UsageError(f"{what}{path} cannot be written: {error.strerror}", setting) from None
            try:
                yield stream
            except BaseException as error:
                inside = error
                raise
    except OSError as error:
        # An error inside the block may be about another file, and its own end writes this one.
        if error is not inside:
            error.filename = path
        raise


class _Report(io.TextIOWrapper):
    """A stream whose errors name its file."""

    def __init__(self, data: BinaryIO, path: str) -> None:
        super().__init__(data, "utf-8")
        self._path = path

    def write(self, text: str) -> int:
        with self._naming():
            return super().write(text)

    def flush(self) -> None:
        with self._naming():
            super().flush()

    @contextlib.contextmanager
    def _naming(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            error.filename = self._path
            raise


@contextlib.contextmanager
def report_stream(path: str | None, first: bool) -> Iterator[TextIO]:
    """Open the stream of a report.

    Args:
        path: the file; None, an empty text or ``-`` for standard output.
        first: whether ``--output`` names the file, and not ``--report``.

    Raises:
        UsageError: if the file cannot be written.
        OSError: if the disk is full; it names the file.
    """
    if not path or path == "-":
        yield sys.stdout
        return
    with output_file(path, "the report ", "output" if first else "report") as data:
        stream = _Report(data, path)
        try:
            yield stream
        finally:
            stream.detach()
