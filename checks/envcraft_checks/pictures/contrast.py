"""Pictures whose values span almost nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.model.rollout import Rollout

from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The widest range of a channel whose contrast is too low, in levels, and the shortest side of a picture in pixels.
_FAINT, _SIDE = 8, 32


def find_faint(subject: Subject) -> Defect | None:
    """Find pictures without contrast: first in those of the fingerprint, then in all of two episodes."""
    from envcraft.spaces.spec import Box

    space, promised = subject.observation_space, subject.contract.observation is not None
    if not shows_pictures(space) or not isinstance(space, Box) or not space.spans_dtype:
        return None
    if not promised and (len(space.shape) != 3 or space.shape[2] != 3 or min(space.shape[:2]) < _SIDE):
        return None
    known = next((trace for trace in subject.traces if trace.ranges), None)
    if known is None or _span(known.ranges) > _FAINT:
        return None
    best = subject.searches.best()
    traces = [known]
    for trace in [subject.episodes.whole[0], *([best] if best is not None else [])]:
        if trace.usable and subject.affords(trace.steps):
            traces.append(subject.rollout(_kept(trace)))
    spans = [_span(known.ranges), *(_span(_ranges(trace.frames)) for trace in traces[1:])]
    if max(spans) > _FAINT:
        return None
    return Defect(
        f"the values of the picture span at most {max(spans)} of 255 levels in {len(traces)} episodes, up to step "
        f"{max(trace.steps for trace in traces)}",
        known.rollout.cut(20),
        {"span": max(spans)},
        certain=promised,
    )


def _kept(trace: Trace) -> Rollout:
    """The same episode with its frames."""
    return msgspec.structs.replace(trace.rollout.cut(trace.steps), keep=trace.steps + 1)


def _span(ranges: list[tuple[int, int]]) -> int:
    return max((high - low for low, high in ranges), default=0)


def _ranges(frames: Sequence[Any]) -> list[tuple[int, int]]:
    """The lowest and highest value of each channel of some pictures."""
    shown = [frame for frame in frames if frame.ndim == 3]
    if len(shown) < len(frames) or len({frame.shape for frame in frames}) != 1:
        return [(int(frame.min()), int(frame.max())) for frame in frames if frame.size]
    channels = range(shown[0].shape[2])
    return [
        (min(int(frame[..., at].min()) for frame in shown), max(int(frame[..., at].max()) for frame in shown))
        for at in channels
    ]
