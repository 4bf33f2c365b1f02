"""The events of a validation run, for reporters and the progress line.

Events of different subjects interleave if several workers run; those of one subject stay in order.
"""

from __future__ import annotations

import msgspec

from envcraft.model.verdict import CheckReport, Report, SubjectReport


class SubjectStarted(msgspec.Struct, frozen=True):
    """Subject `number` of `total` is judged from now on; numbers start at 1."""

    path: str
    number: int
    total: int


class CheckStarted(msgspec.Struct, frozen=True):
    path: str
    check: str


class StepsTaken(msgspec.Struct, frozen=True):
    """A subject has taken `steps` environment steps so far. At most a few of these events come each second."""

    path: str
    steps: int


class CheckFinished(msgspec.Struct, frozen=True):
    path: str
    report: CheckReport


class SubjectFinished(msgspec.Struct, frozen=True):
    report: SubjectReport


class Finished(msgspec.Struct, frozen=True):
    """The last event. Its reports are in the order of the targets."""

    report: Report


Event = SubjectStarted | CheckStarted | StepsTaken | CheckFinished | SubjectFinished | Finished
