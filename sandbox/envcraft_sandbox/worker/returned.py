"""Watch the observations that a caller could still hold: none of them may change after it was returned."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
from envcraft_protocol.wire import Kind

from .channel import Channel, Sent
from .subject import Subject

_Array = np.ndarray
_references = sys.getrefcount
#: Maximum number of observations that are held, and of their bytes: of all observations, and of those that the
#: environment holds itself.
_MOST, _BYTES = 4_096, 64 * 1024**2
_FEW, _FEW_BYTES = 64, 8 * 1024**2
#: Number of changes that are reported.
_REPORTS = 3


class Kept(NamedTuple):
    """An observation, what was sent of it, its number, the address of its memory or its identity, and its bytes."""

    observation: Any
    sent: Sent
    number: int
    memory: int
    size: int


class Returned:
    """The observations of an episode that may still change.

    An environment can only write into memory that it refers to itself. So an array is of interest if something else
    than the caller refers to it; that costs a look at its number of references. While an array is held here, no other
    one gets its memory: an array with the memory of a held one shares it.

    Args:
        subject: reads the observations again.
        everything: hold all observations, of every type, even if nothing else refers to them.
    """

    def __init__(self, subject: Subject, everything: bool) -> None:
        self._subject = subject
        self._channel: Channel = subject.channel
        self._everything = everything
        self._most, self._bytes = (_MOST, _BYTES) if everything else (_FEW, _FEW_BYTES)
        #: By their memory, the earliest first.
        self._kept: dict[int, Kept] = {}
        self._size = 0
        self._last: Kept | None = None
        self._reports = _REPORTS

    def add(self, observation: Any) -> None:
        """Note the observation that was sent last, and look at the one before."""
        last, self._last = self._last, None
        array = type(observation) is _Array
        if self._everything or (array and _is_shared(observation)):
            # The address of an array's data takes longer to find, and only views share it.
            view = array and observation.base is not None
            self._keep(observation, observation.__array_interface__["data"][0] if view else id(observation))
        if last is not None and self._kept.get(last.memory) is last:
            self._look_back(last)

    def check(self) -> None:
        """Read all held observations again."""
        for kept in list(self._kept.values()):
            self._compare(kept, self._read(kept.observation))

    def clear(self) -> None:
        """Hold nothing any more."""
        self._kept.clear()
        self._last = None

    def _keep(self, observation: Any, memory: int) -> None:
        channel = self._channel
        if not self._reports or channel.is_resized(observation):
            return
        sent = channel.sent
        size = observation.nbytes if type(observation) is _Array else len(sent[1])
        kept = self._last = Kept(observation, sent, channel.number, memory, size)
        same = self._kept.get(memory)
        if same is not None:
            self._compare(same, sent if same.observation is observation else self._read(same.observation))
            self._drop(same)
        self._kept[memory] = kept
        self._size += size
        while len(self._kept) > self._most or (self._size > self._bytes and len(self._kept) > 1):
            first = next(iter(self._kept.values()))
            self._compare(first, self._read(first.observation))
            self._drop(first)

    def _look_back(self, last: Kept) -> None:
        """Read an observation again after the next step. The environment cannot change it later if it has no
        reference any more.
        """
        self._compare(last, self._read(last.observation))
        observation = last.observation
        if not self._everything and not _is_shared(observation):
            self._drop(last)

    def _read(self, observation: Any) -> Sent:
        if type(observation) is _Array:
            # Reading it runs no code of the environment.
            return self._channel.read(observation)
        now: Sent = self._subject.call("step", self._channel.read, observation)
        return now

    def _compare(self, kept: Kept, now: Sent) -> None:
        if now != kept.sent:
            self._drop(kept)
            if self._reports:
                self._reports -= 1
                self._channel.send_json(Kind.CHANGED, {"at": kept.number})

    def _drop(self, kept: Kept) -> None:
        if self._kept.get(kept.memory) is kept:
            del self._kept[kept.memory]
            self._size -= kept.size


def _is_shared(observation: Any) -> bool:
    """Whether something else refers to an array or to the array whose memory it shows.

    Views of other memory do not count: holding one may lock a surface that the next step draws on.
    """
    base = observation.base
    if base is None:
        return _references(observation) > _ALONE
    if type(base) is not _Array or base.base is not None:
        return False
    return _references(observation) > _ALONE or _references(base) > _BASE_ALONE


def _count(observation: Any) -> tuple[int, int]:
    base = observation.base
    return _references(observation), _references(base)


def _counted(observation: Any) -> tuple[int, int]:
    """The references to an array and to its base when both have one owner. Calls like that of :meth:`Returned.add`
    lie between, since each holds references.
    """
    return _count(observation)


def _calibrate() -> tuple[int, int]:
    fresh = np.empty((2, 2)).T
    return _counted(fresh)


_ALONE, _BASE_ALONE = _calibrate()
