"""Whether two traces of one episode differ."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from envcraft.model.trace import Divergence, Trace


def diverge(first: Trace, second: Trace, info: bool) -> Divergence | None:
    """How the second trace first differs, with or without `info`; None if it does not, or if either is incomplete."""
    from envcraft.model.job import ExitReason
    from envcraft.model.trace import diverge as first_difference

    if interrupted(first) or interrupted(second):
        return None
    found = first_difference(first, second, info)
    # A busy machine misses deadlines. The check sandbox reports a call that misses them repeatedly.
    late = any(trace.end is not None and trace.end.reason is ExitReason.TIMEOUT for trace in (first, second))
    return None if found is not None and found.field == "length" and late else found


def interrupted(trace: Trace) -> bool:
    """Whether a call that is only part of a condition raised, which the check api reports."""
    calls = ["earlier reset", "before", "companion", "render"]
    if trace.rollout.conditions.options:
        calls.append("reset")
    return trace.fault is not None and trace.fault.phase in calls
