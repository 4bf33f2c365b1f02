"""Ctrl-C, SIGTERM, closed pipes and full disks: when they take effect, and their exit statuses."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator

import click

from envcraft.errors import ExitCode

#: 128 and SIGINT, as shells report it.
INTERRUPTED = 130
#: 128 and SIGPIPE, as shells report a program whose reader has gone.
CLOSED = 141
#: No space, no space within the user's quota, and a file that would be larger than the system allows.
_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM to the end of the block.

    An extension module that is interrupted during its import may swallow the exception. Outside the main thread the
    block changes nothing, because Python delivers signals to the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    usual = {number: signal.signal(number, lambda n, _: caught.append(n)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
    if caught:
        raise KeyboardInterrupt


@contextlib.contextmanager
def exit_statuses() -> Iterator[None]:
    """Exit with 130 on Ctrl-C, with 141 on a closed pipe, and with 3 and one sentence if a disk is full.

    Click and Rich exit with 1, which means that an environment fails.
    """
    try:
        yield
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    except BrokenPipeError:
        _hang_up()
        raise click.exceptions.Exit(CLOSED) from None
    except OSError as error:
        if not is_full(error):
            raise
        _hang_up()
        where = error.filename or "the output, or a temporary file,"
        with contextlib.suppress(OSError):
            # Standard error may be the same full disk.
            click.echo(f"Error: {where} cannot be written: {error.strerror}; free some space and try again", err=True)
        raise click.exceptions.Exit(ExitCode.ERROR) from None
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            raise click.exceptions.Exit(CLOSED) from None
        raise


def is_full(error: BaseException) -> bool:
    """Whether an error says that there is no space to write."""
    return isinstance(error, OSError) and error.errno in _FULL


def _hang_up() -> None:
    """Discard what cannot be written, so that the interpreter prints no error while it exits."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
