"""The concurrency limiter: additive increase, multiplicative decrease, with slow start.

The limit follows TCP's congestion window (Chiu and Jain, "Analysis of the increase and decrease algorithms for
congestion avoidance in computer networks", 1989; slow start: Jacobson, "Congestion avoidance and control", 1988).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque

#: The initial limit. It doubles with each round of completions until the endpoint first limits the rate.
START = 16
#: Factor of the limit when the endpoint limits the rate.
DECREASE = 0.5


class ConcurrencyLimiter:
    """Limits how many requests are in flight. Used in one event loop.

    Args:
        minimum: Lower bound of the limit.
        maximum: Upper bound of the limit.
    """

    def __init__(self, minimum: int, maximum: int) -> None:
        self._minimum, self._maximum = minimum, maximum
        self._limit = float(min(maximum, max(minimum, START)))
        self._slow_start = True
        # The last ticket, and the last one at the time of the last decrease.
        self._ticket = self._decreased_at = 0
        self._resume_at = 0.0
        self._alarm: asyncio.TimerHandle | None = None
        self._waiters: deque[asyncio.Future[None]] = deque()
        self._stopped = False
        self.in_flight = 0

    @property
    def limit(self) -> int:
        """The current limit of requests in flight."""
        return int(self._limit)

    async def acquire(self, retry: bool = False) -> int:
        """Wait for a free slot and return its ticket number.

        Args:
            retry: Whether to go to the head of the queue.
        """
        if self._waiters or not self._open():
            waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            (self._waiters.appendleft if retry else self._waiters.append)(waiter)
            self._admit()
            try:
                await waiter
            except asyncio.CancelledError:
                if waiter.cancelled():
                    with contextlib.suppress(ValueError):
                        self._waiters.remove(waiter)
                else:
                    self.release()
                raise
        else:
            self.in_flight += 1
        self._ticket += 1
        return self._ticket

    def release(self) -> None:
        """Free the slot."""
        self.in_flight -= 1
        self._admit()

    def stop(self) -> None:
        """Admit every waiter, now and later, so that each learns that no request is sent any more."""
        self._stopped = True
        if self._alarm is not None:
            self._alarm.cancel()
        if self._waiters:
            self._admit()

    def on_success(self) -> None:
        """Raise the limit, if at least half of it is in use."""
        if self.in_flight * 2 < self._limit:
            return
        self._limit = min(float(self._maximum), self._limit + (1.0 if self._slow_start else 1.0 / self._limit))

    def on_rate_limit(self, ticket: int, retry_after: float | None) -> None:
        """Lower the limit, once for all requests that were admitted before the last decrease.

        Args:
            ticket: Ticket of the request that the endpoint rejected.
            retry_after: Seconds during which no request is admitted, or None.
        """
        if ticket > self._decreased_at:
            self._limit = max(float(self._minimum), self._limit * DECREASE)
            self._slow_start = False
            self._decreased_at = self._ticket
        if retry_after is not None:
            self._resume_at = max(self._resume_at, asyncio.get_running_loop().time() + retry_after)

    def _open(self) -> bool:
        if self._stopped:
            return True
        return self.in_flight < self.limit and asyncio.get_running_loop().time() >= self._resume_at

    def _admit(self) -> None:
        while self._waiters and self._open():
            waiter = self._waiters.popleft()
            # A cancelled waiter stays in the queue until its task runs.
            if waiter.done():
                continue
            self.in_flight += 1
            waiter.set_result(None)
        paused = self._resume_at - asyncio.get_running_loop().time()
        if self._waiters and paused > 0 and self._alarm is None:
            self._alarm = asyncio.get_running_loop().call_later(paused, self._wake)

    def _wake(self) -> None:
        self._alarm = None
        self._admit()
