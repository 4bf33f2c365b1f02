"""A folder that is replaced as a whole: written beside the old one, whose place it takes once it is complete."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import UsageError
from envcraft.reports import one_line

#: By this file a folder is known to be a report: it lists what is in it, a name a line.
MARK = ".envcraft-report"


def usable(folder: Path) -> None:
    """Raises UsageError where a report cannot be put."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is a file; name a folder for the report")
    if not folder.is_dir():
        return
    foreign = {entry.name for entry in folder.iterdir()} - {MARK}
    with contextlib.suppress(OSError, UnicodeDecodeError):
        foreign.difference_update((folder / MARK).read_text("utf-8").splitlines())
    if foreign:
        raise UsageError(
            f"{folder} holds {one_line(min(foreign))}, which is no part of a report; name a folder that is new, empty "
            "or a report alone"
        )


@contextlib.contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """An empty folder to write to, which becomes `folder` when all has gone well. What is left of a process that was
    killed meanwhile goes with the next one. Raises UsageError.
    """
    usable(folder)
    # Through links, so that it is not the link that is replaced.
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
        raise UsageError(f"the report {folder} cannot be written: {error.strerror or error}") from None


def _sweep(folder: Path) -> None:
    for kind in ("new", "old"):
        for rest in folder.parent.glob(f".{folder.name}.{kind}-*"):
            number = rest.name.rpartition("-")[2]
            if number.isdigit() and not _alive(int(number)):
                # Killed between the two renames, it has left the old one beside its place.
                if kind == "old" and not folder.exists():
                    rest.rename(folder)
                else:
                    shutil.rmtree(rest, ignore_errors=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
