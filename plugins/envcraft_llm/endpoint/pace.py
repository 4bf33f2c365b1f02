"""How many requests may be under way at once: additive increase, multiplicative decrease, as TCP finds its window
(Chiu and Jain, 1989; slow start after Jacobson, 1988).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque

#: The limit at first; it doubles with each round of answers until the endpoint first turns one away.
START = 16
#: What is left of the limit when the endpoint turns a request away.
DECREASE = 0.5


class Pace:
    """Lets in as many as the limit is. Used in one event loop.

    Args:
        least, most: the bounds of the limit.
    """

    def __init__(self, least: int, most: int) -> None:
        self._least, self._most = least, most
        self._limit = float(min(most, max(least, START)))
        self._doubling = True
        self._entered = self._turn = 0
        self._resume_at = 0.0
        self._alarm: asyncio.TimerHandle | None = None
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._ended = False
        self.under_way = 0

    @property
    def limit(self) -> int:
        """How many may be under way now."""
        return int(self._limit)

    async def enter(self, again: bool = False) -> int:
        """Wait for a place; one who was in before is let in before the others. Gives the number of this entry."""
        if self._waiting or not self._open():
            place: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            (self._waiting.appendleft if again else self._waiting.append)(place)
            self._admit()
            try:
                await place
            except asyncio.CancelledError:
                if place.cancelled():
                    with contextlib.suppress(ValueError):
                        self._waiting.remove(place)
                else:
                    self.leave()
                raise
        else:
            self.under_way += 1
        self._entered += 1
        return self._entered

    def leave(self) -> None:
        """Give the place back."""
        self.under_way -= 1
        self._admit()

    def end(self) -> None:
        """Let everybody in, now and from now on: nothing is sent any more, and who waits is to hear of it."""
        self._ended = True
        if self._alarm is not None:
            self._alarm.cancel()
        if self._waiting:
            self._admit()

    def succeeded(self) -> None:
        """Raise the limit, where it is what holds requests back."""
        if self.under_way * 2 < self._limit:
            return
        self._limit = min(float(self._most), self._limit + (1.0 if self._doubling else 1.0 / self._limit))

    def turned_away(self, entry: int, seconds: float | None) -> None:
        """Lower the limit, once for all that went in before it was last lowered; and let nobody in for so many seconds
        as the endpoint asks for, if it does.
        """
        if entry > self._turn:
            self._limit = max(float(self._least), self._limit * DECREASE)
            self._doubling = False
            self._turn = self._entered
        if seconds is not None:
            self._resume_at = max(self._resume_at, asyncio.get_running_loop().time() + seconds)

    def _open(self) -> bool:
        if self._ended:
            return True
        return self.under_way < self.limit and asyncio.get_running_loop().time() >= self._resume_at

    def _admit(self) -> None:
        while self._waiting and self._open():
            place = self._waiting.popleft()
            # Who waited was cancelled, and has not yet come to hear of it.
            if place.done():
                continue
            self.under_way += 1
            place.set_result(None)
        paused = self._resume_at - asyncio.get_running_loop().time()
        if self._waiting and paused > 0 and self._alarm is None:
            self._alarm = asyncio.get_running_loop().call_later(paused, self._wake)

    def _wake(self) -> None:
        self._alarm = None
        self._admit()
