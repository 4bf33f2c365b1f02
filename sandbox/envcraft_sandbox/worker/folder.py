"""The folder that a job may write to: its working directory, home and temporary directory, emptied after each job."""

from __future__ import annotations

import os

_MODE = 0o700
#: No game nests folders this deeply. Each level makes all paths below it slower to look up.
_DEPTH = 512


class JobFolder:
    """A folder below a temporary directory. Its contents are untrusted: no method follows a link."""

    def __init__(self, path: str) -> None:
        self.path = path
        os.makedirs(path, _MODE, exist_ok=True)
        self.empty()

    def empty(self) -> None:
        """Remove everything that a job left, at any depth: subfolders move up before they are removed."""
        while entries := list(os.scandir(self.path)):
            for entry in entries:
                if not entry.is_dir(follow_symlinks=False):
                    os.unlink(entry.path)
                    continue
                os.chmod(entry.path, _MODE)
                for inner in list(os.scandir(entry.path)):
                    if inner.is_dir(follow_symlinks=False):
                        # A move writes to the moved folder: the entry of its parent changes.
                        os.chmod(inner.path, _MODE)
                    # The job cannot have used this name.
                    os.rename(inner.path, os.path.join(self.path, os.urandom(16).hex()))
                os.rmdir(entry.path)

    def bytes(self, most: int) -> int:
        """The disk space of its files in bytes. Counting stops beyond `most`.

        Each entry counts for something. A folder that cannot be read, or that lies 512 folders deep, counts for more
        than `most`.
        """
        total, folders = 0, [(self.path, 0)]
        while folders and total <= most:
            path, depth = folders.pop()
            if depth > _DEPTH:
                return most + 1
            try:
                with os.scandir(path) as entries:
                    for entry in entries:
                        total += entry.stat(follow_symlinks=False).st_blocks * 512 + 1024
                        if entry.is_dir(follow_symlinks=False):
                            folders.append((entry.path, depth + 1))
            except FileNotFoundError:
                continue
            except OSError:
                return most + 1
        return total
