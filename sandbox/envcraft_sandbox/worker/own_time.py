"""How long a file's own code takes at import."""

from __future__ import annotations

import builtins
import importlib.util
import os
import resource
import sys
import threading
import time
from typing import Any

_import = builtins.__import__
_getrusage, _thread_time, _perf_counter = resource.getrusage, time.thread_time, time.perf_counter
#: Only Linux counts for a thread.
_WHOSE = getattr(resource, "RUSAGE_THREAD", resource.RUSAGE_SELF)
_Reading = tuple[int, float, float]


class OwnTime:
    """Times an import without the libraries that it imports, whose time is not the file's doing.

    It is the processor time, which other programs on the machine do not change, or all time if the code waits.

    Args:
        folder: the folder of the project, whose modules are no libraries.

    Attributes:
        seconds: the time, after the context ends.
    """

    def __init__(self, folder: str) -> None:
        self.seconds = 0.0
        self._folder = os.path.join(folder, "")
        self._thread = threading.get_ident()
        self._in_library = False
        self._left_out = (0, 0.0, 0.0)

    def __enter__(self) -> OwnTime:
        builtins.__import__ = self._timed
        self._started = _now()
        return self

    def __exit__(self, *_: object) -> None:
        waits, cpu, seconds = _sum(_now(), self._started, self._left_out, sign=-1)
        self.seconds = seconds if waits > 0 else cpu
        if builtins.__import__ == self._timed:
            builtins.__import__ = _import

    def _timed(self, name: str, *args: Any, **kwargs: Any) -> Any:
        level = kwargs.get("level", args[3] if len(args) > 3 else 0)
        nested = self._in_library or threading.get_ident() != self._thread
        if nested or level or not self._is_library(name.partition(".")[0]):
            return _import(name, *args, **kwargs)
        self._in_library, started = True, _now()
        try:
            return _import(name, *args, **kwargs)
        finally:
            self._in_library = False
            self._left_out = _sum(self._left_out, _sum(_now(), started, sign=-1))

    def _is_library(self, name: str) -> bool:
        """Whether a top-level module is in no file of the project."""
        try:
            spec = getattr(sys.modules.get(name), "__spec__", None) or importlib.util.find_spec(name)
            places = [spec.origin or "", *(spec.submodule_search_locations or ())] if spec is not None else []
        except Exception:
            return False
        return not any(os.path.abspath(place).startswith(self._folder) for place in places if place)


def _now() -> _Reading:
    """How often this thread has given up the processor, its processor time, and the time."""
    return _getrusage(_WHOSE).ru_nvcsw, _thread_time(), _perf_counter()


def _sum(first: _Reading, *others: _Reading, sign: int = 1) -> _Reading:
    for other in others:
        first = (first[0] + sign * other[0], first[1] + sign * other[1], first[2] + sign * other[2])
    return first
