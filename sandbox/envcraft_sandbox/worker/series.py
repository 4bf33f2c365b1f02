"""What a job leaves behind in its process, and must not leave for the next one of a series."""

from __future__ import annotations

import _thread
import gc
import os
import shutil
import sys
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np

#: Modules that every file can reach, and in which one could keep something for a process.
_SHARED = ("builtins", "gymnasium", "gymnasium.spaces", "math", "numpy", "numpy.random", "random", "time")


class Traces:
    """How a process was before the first episode: `folder` empty, and settings that libraries keep for a process."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._environment = dict(os.environ)
        self._recursion = sys.getrecursionlimit()
        self._floating = np.geterr()
        self._libraries = [(names, dict(names)) for names in _namespaces()]

    def remove(self) -> bool:
        """Put everything back, and forget the environment's objects. False where something stays: a thread, a process,
        a file that cannot be removed, or what was written into a library.
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
            changed = any(_is_changed(names, kept) for names, kept in self._libraries)
            return not changed and _thread._count() == 0 and not _has_children()
        except BaseException:
            # Whatever it is, it stays: the process takes no other job.
            return False


def _namespaces() -> list[Any]:
    """Names and values of what environments share: modules, their base class, and its metadata."""
    modules = [vars(sys.modules[name]) for name in _SHARED]
    return [*modules, vars(gymnasium.Env), gymnasium.Env.metadata]


def _is_changed(names: Any, kept: dict[str, Any]) -> bool:
    """Whether anything is another object or new, but for modules, which are imported late."""
    if any(names.get(name) is not value for name, value in kept.items()):
        return True
    return len(names) > len(kept) and not all(isinstance(names[name], ModuleType) for name in names if name not in kept)


def _has_children() -> bool:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    return True
