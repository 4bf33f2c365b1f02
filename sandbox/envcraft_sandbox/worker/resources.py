"""Measure the process between episodes: its memory, threads, open files and written files, and the lines it runs."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections import deque
from types import FrameType, TracebackType
from typing import Any

from envcraft_protocol.wire import RESOURCES

_PAGE = os.sysconf("SC_PAGE_SIZE")
#: Fields of /proc/self/stat, counted from the one after the name, which may hold spaces.
_THREADS, _RESIDENT = 17, 21
#: The most lines that are counted in one episode, because counting slows them down, and the most files.
_MOST_LINES, _MOST_FILES = 300_000, 10_000
#: Closed descriptors after which no open one is expected.
_CLOSED = 16


class _Allocated(ctypes.Structure):
    """``struct mallinfo2`` of glibc."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    ]


# Bound before any untrusted module can replace them.
_collect, _objects, _blocks = gc.collect, gc.get_objects, sys.getallocatedblocks
_settrace, _gettrace, _pread, _fstat = sys.settrace, sys.gettrace, os.pread, os.fstat
_mallinfo: Any = getattr(ctypes.CDLL(None), "mallinfo2", None)
if _mallinfo is not None:
    _mallinfo.restype = _Allocated


class Resources:
    """Measures this process. Create it before the process loses its rights.

    Args:
        folder: the only folder that the job may write to.
        descriptors: the most open files of a job.
    """

    def __init__(self, folder: str, descriptors: int) -> None:
        self._folder = folder
        self._descriptors = descriptors
        try:
            self._stat = os.open("/proc/self/stat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            self._stat = -1

    def measure(self, lines: int) -> bytes:
        """What the process uses once its garbage is collected, as the payload of a message.

        Args:
            lines: the number of lines that the last episode ran.
        """
        _collect()
        threads, resident = self._status()
        files, written = self._files()
        queued = sum(len(item) for item in _objects() if type(item) is deque and item.maxlen is not None)
        allocated = _mallinfo() if _mallinfo is not None else _Allocated()
        held, blocks = allocated.uordblks + allocated.hblkhd, _blocks()
        return RESOURCES.pack(
            resident, held, blocks, lines, written, threads, self._open(), files, min(queued, 0xFFFFFFFF)
        )

    def _status(self) -> tuple[int, int]:
        """Threads and resident bytes; 0 where the kernel does not say."""
        try:
            fields = _pread(self._stat, 4096, 0).rpartition(b")")[2].split()
            return int(fields[_THREADS]), int(fields[_RESIDENT]) * _PAGE
        except (OSError, ValueError, IndexError):
            return 0, 0

    def _open(self) -> int:
        """Open descriptors. New ones get the lowest numbers, so the search ends where many are closed."""
        count = 0
        for number in range(self._descriptors):
            try:
                _fstat(number)
                count += 1
            except OSError:
                if number >= count + _CLOSED:
                    break
        return count

    def _files(self) -> tuple[int, int]:
        """Files in the job's folder, and their bytes."""
        files = written = 0
        for path, _, names in os.walk(self._folder):
            for name in names:
                files += 1
                try:
                    written += os.lstat(os.path.join(path, name)).st_size
                except OSError:
                    continue
            if files > _MOST_FILES:
                break
        return files, written


class Lines:
    """Counts the lines of Python that run within it."""

    def __init__(self) -> None:
        self.count = 0
        self._before: Any = None

    def __enter__(self) -> None:
        self._before = _gettrace()
        _settrace(self._trace)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        _settrace(self._before)

    def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        self.count += event == "line"
        return self._trace if self.count < _MOST_LINES else None
