"""The time that the validation of one subject may take."""

from __future__ import annotations

import time

from envcraft.errors import Undecided


class OutOfTime(Undecided):
    """The time limit is over before the question is settled."""


class TimeLimit:
    """Seconds of wall clock from the opening of a subject.

    Args:
        seconds: the limit.
        fixed: whether the user set the limit, so that nothing shortens it.

    Attributes:
        seconds: the limit.
        decided: whether a question was not settled because of the limit.
    """

    def __init__(self, seconds: float, fixed: bool = False) -> None:
        self.seconds = seconds
        self.decided = False
        self._fixed = fixed
        self._started = time.monotonic()

    @property
    def left(self) -> float:
        """The seconds that are left; negative after the limit."""
        return self._started + self.seconds - time.monotonic()

    @property
    def over(self) -> bool:
        return self.left <= 0

    def shorten(self, seconds: float) -> None:
        """Lower the limit to `seconds`, unless the user set it."""
        if not self._fixed:
            self.seconds = min(self.seconds, seconds)

    def skip(self) -> OutOfTime:
        """Return the exception that ends a check at the limit, and record that the clock decided."""
        self.decided = True
        return OutOfTime(f"out of time: the limit of {self.seconds:g} s is reached")
