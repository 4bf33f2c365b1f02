"""What a job leaves behind in its process, and must not leave for the next one of a series."""

from __future__ import annotations

import _thread
import gc
import os
import shutil
import sys

import numpy as np


class Traces:
    """How a process was before the first episode: `folder` empty, and settings that libraries keep for a process."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._environment = dict(os.environ)
        self._recursion = sys.getrecursionlimit()
        self._floating = np.geterr()

    def remove(self) -> bool:
        """Put everything back, and forget the environment's objects. False where something stays: a thread, a process,
        or a file that cannot be removed.
        """
        try:
            gc.collect()
            os.chdir(self._folder)
            for entry in os.scandir("."):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                else:
                    os.unlink(entry.path)
            if os.environ != self._environment:
                os.environ.clear()
                os.environ.update(self._environment)
            sys.setrecursionlimit(self._recursion)
            np.seterr(**self._floating)
            return _thread._count() == 0 and not _has_children()
        except BaseException:
            # Whatever it is, it stays: the process takes no other job.
            return False


def _has_children() -> bool:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    return True
