"""The folder that a job may write to: its working directory, home and temporary directory, emptied after each job."""

from __future__ import annotations

import os

_MODE = 0o700


class JobFolder:
    """One folder below a temporary directory. Its contents are untrusted: nothing here follows a link."""

    def __init__(self, path: str) -> None:
        self.path = path
        os.makedirs(path, _MODE, exist_ok=True)
        self.empty()

    def empty(self) -> None:
        """Remove all that a job left, however deep: subfolders are moved up before they are removed."""
        while entries := list(os.scandir(self.path)):
            for entry in entries:
                if not entry.is_dir(follow_symlinks=False):
                    os.unlink(entry.path)
                    continue
                os.chmod(entry.path, _MODE)
                for inner in list(os.scandir(entry.path)):
                    if inner.is_dir(follow_symlinks=False):
                        # A folder that is moved is written to: its parent's entry is in it.
                        os.chmod(inner.path, _MODE)
                    # A name that the job cannot have taken.
                    os.rename(inner.path, os.path.join(self.path, os.urandom(16).hex()))
                os.rmdir(entry.path)

    def bytes(self, most: int) -> int:
        """What the files in it hold on the disk. Counting stops beyond `most`; each entry counts for something, and
        what cannot be looked into for more than `most`.
        """
        total, folders = 0, [self.path]
        while folders and total <= most:
            try:
                with os.scandir(folders.pop()) as entries:
                    for entry in entries:
                        total += entry.stat(follow_symlinks=False).st_blocks * 512 + 1024
                        if entry.is_dir(follow_symlinks=False):
                            folders.append(entry.path)
            except FileNotFoundError:
                continue
            except OSError:
                return most + 1
        return total
