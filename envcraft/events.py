"""What happens while subjects are judged, as reporters and the progress line see it.

With several workers the events of different subjects interleave; those of one subject stay in order.
"""

from __future__ import annotations

import msgspec

from envcraft.verdict import CheckReport, Report, SubjectReport


class SubjectStarted(msgspec.Struct, frozen=True):
    """A subject's turn: `number` of `total`."""

    path: str
    number: int
    total: int


class CheckStarted(msgspec.Struct, frozen=True):
    path: str
    check: str


class StepsTaken(msgspec.Struct, frozen=True):
    """A subject has come to `steps` environment steps; said a few times a second at the most."""

    path: str
    steps: int


class CheckFinished(msgspec.Struct, frozen=True):
    path: str
    report: CheckReport


class SubjectFinished(msgspec.Struct, frozen=True):
    report: SubjectReport


class Finished(msgspec.Struct, frozen=True):
    """The last event. The reports are in the order of the targets."""

    report: Report


Event = SubjectStarted | CheckStarted | StepsTaken | CheckFinished | SubjectFinished | Finished
