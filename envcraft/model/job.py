"""The result of a job in the worker."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any, TypedDict

import msgspec

Count = Annotated[int, msgspec.Meta(ge=0)]


class ExitReason(StrEnum):
    """How a job ended."""

    DONE = "done"  #: the job reported its own end
    TIMEOUT = "timeout"  #: no message within the deadline
    DIED = "died"  #: the process ended without a report
    FORGED = "forged"  #: its messages violate the protocol
    FLOOD = "flood"  #: it printed more than the limit
    MEMORY = "memory"  #: it held more memory than the limit
    PROCESSES = "processes"  #: it ran more threads than the limit
    DISK = "disk"  #: it wrote more to files than the limit
    STOPPED = "stopped"  #: the receiver stopped the job


class JobResult(msgspec.Struct, frozen=True):
    """The end of a job.

    Attributes:
        reason: why it ended.
        phase: the call that was running, such as ``step``.
        seconds: wall time.
        signal: the signal that killed the process, if it died of one.
        exit_code: the exit status of the process, if it exited.
        detail: the exceeded limit or the violation, for messages.
        output: the first part of what the process printed.
        output_bytes: how many bytes it printed.
        cpu: processor time of its processes, in seconds; of a series it is known at the end of the last job.
        before: jobs of the same series that ran in the process before.
        steps: calls of step() of every kind, as the job reports them at its end; 0 if it does not come to report.
        whole: the time of the whole job was over, not that of one call.
        waits: calls of reset and step that gave up the processor to wait, if the job is measured.
        busy: the processor time of the steps in seconds, if the job is measured. Of a step that waits, all time counts.
        reached: a digit for each of the job's marks, 1 for those that were reached; empty if it does not say.
        stack: the lines of the target's file that were running when a deadline, a flood of output or a crash ended the
            job, the innermost call first; empty if they are unknown. The job itself reports them.
    """

    reason: ExitReason
    phase: str
    seconds: float
    signal: int | None = None
    exit_code: int | None = None
    detail: str = ""
    output: str = ""
    output_bytes: int = 0
    cpu: float = 0.0
    before: int = 0
    whole: bool = False
    steps: int = 0
    waits: int = 0
    busy: float = 0.0
    reached: str = ""
    stack: tuple[int, ...] = ()


class SearchOutcome(TypedDict, total=False):
    """The result of a search: action lists to a crash, to a win and to the highest return, and its size.

    Attributes:
        loop: actions whose last `loop_length` ones lead back to the same coarse picture, and pay each time.
        still: actions of which the last `still_length` ones did not change the picture.
        paid: steps with a reward other than 0.
        states: the states that it met.
        late_states: those of them that it met first in its second half.
        player: the attributes with the player's cell, with a comma between two.
        place: the attribute with the cells of things that the player gathers.
        board: the attribute with the grid of cells.
        placed: the most things that one start has.
        looked: the number of seeds whose start was looked at.
        enclosed: those of them, counted from the first, on which walls enclose a thing.
    """

    crash: list[Any] | None
    win: list[Any] | None
    best: list[Any] | None
    loop: list[Any] | None
    loop_length: Count
    still: list[Any] | None
    still_length: Count
    paid: Count
    steps: int
    states: int
    late_states: int
    exhausted: bool
    stochastic: bool
    player: str
    place: str
    board: str
    placed: Count
    looked: Count
    enclosed: list[Count]
