"""The folder of a report, which is written beside the old one and replaces it when it is complete."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import UsageError
from envcraft.files import refuse_file
from envcraft.text import one_line

#: The file that identifies a report: it lists the entries of the folder, one a line.
MARK = ".envcraft-report"


def check_usable(folder: Path) -> None:
    """Check whether a folder is new, empty or a report.

    Raises:
        UsageError: if it is not.
    """
    refuse_file(folder)
    if not folder.is_dir():
        return
    foreign = {entry.name for entry in folder.iterdir()} - {MARK}
    with contextlib.suppress(OSError, UnicodeDecodeError):
        foreign.difference_update((folder / MARK).read_text("utf-8").splitlines())
    if foreign:
        raise UsageError(
            f"{folder} contains {one_line(min(foreign))}, which does not belong to a report; name a folder that is "
            "new, empty or a report"
        )


@contextlib.contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """Create an empty folder that replaces `folder` when the block ends without an exception.

    What killed processes left behind is removed.

    Raises:
        UsageError: if `folder` cannot be written or replaced.
    """
    check_usable(folder)
    # Resolved, so that the target of a link is replaced and not the link.
    folder = folder.resolve()
    made, old = (folder.with_name(f".{folder.name}.{kind}-{os.getpid()}") for kind in ("new", "old"))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _sweep(folder)
        made.mkdir()
        try:
            yield made
            (made / MARK).write_text("".join(f"{entry.name}\n" for entry in sorted(made.iterdir())), "utf-8")
            if folder.exists():
                folder.rename(old)
            made.rename(folder)
        except BaseException:
            if old.exists() and not folder.exists():
                old.rename(folder)
            raise
        finally:
            for rest in (made, old):
                shutil.rmtree(rest, ignore_errors=True)
    except OSError as error:
        raise UsageError(f"cannot write the report {folder}: {error.strerror or error}") from None


def _sweep(folder: Path) -> None:
    """Remove what killed processes left behind."""
    for kind in ("new", "old"):
        for rest in folder.parent.glob(f".{folder.name}.{kind}-*"):
            number = rest.name.rpartition("-")[2]
            if number.isdigit() and not _is_running(int(number)):
                # A process that was killed between the two renames left the old report under this name.
                if kind == "old" and not folder.exists():
                    rest.rename(folder)
                else:
                    shutil.rmtree(rest, ignore_errors=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
