"""Remove what a job leaves in its process before the next job of a series."""

from __future__ import annotations

import _thread
import gc
import os
import shutil
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np

#: Modules that every file can reach and could store something in.
_SHARED = ("builtins", "gymnasium", "gymnasium.spaces", "math", "numpy", "numpy.random", "random", "time")
#: A library with a state of its own, such as a window, that its quit() ends.
_PYGAME = "pygame"


class Traces:
    """The state of a process before its first episode: an empty folder, and the settings of libraries."""

    def __init__(self, folder: str) -> None:
        self._folder = folder
        self._environment = dict(os.environ)
        self._recursion = sys.getrecursionlimit()
        self._floating = np.geterr()
        self._libraries = [(names, dict(names)) for names in _namespaces()]
        self._pygame = _PYGAME in sys.modules
        self._quit: Callable[[], None] | None = vars(sys.modules[_PYGAME]).get("quit") if self._pygame else None

    def remove(self) -> bool:
        """Restore the state and free the environment's objects.

        Returns:
            False if something remains: a thread, a process, a file that cannot be removed, a changed library, or one
            that an episode imported.
        """
        try:
            gc.collect()
            if self._quit is not None:
                self._quit()
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
            changed |= self._pygame is not (_PYGAME in sys.modules)
            return not changed and _thread._count() == 0 and not _has_children()
        except BaseException:
            # Something remains, so the process runs no other job.
            return False


def _namespaces() -> list[Any]:
    """The names and values that environments share: modules, their base class, and its metadata."""
    names = [*_SHARED, *(name for name in sys.modules if name.partition(".")[0] == _PYGAME)]
    # Modules that are not installed are None.
    modules = [vars(module) for name in names if isinstance(module := sys.modules[name], ModuleType)]
    return [*modules, vars(gymnasium.Env), gymnasium.Env.metadata]


def _is_changed(names: Any, kept: dict[str, Any]) -> bool:
    """Whether a value is new or another object. Modules do not count, since they are imported late."""
    if any(names.get(name) is not value for name, value in kept.items()):
        return True
    return len(names) > len(kept) and not all(isinstance(names[name], ModuleType) for name in names if name not in kept)


def _has_children() -> bool:
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    return True
