"""# brightness

## What it does
Plays at random on several seeds and looks at the first 64 frames of each episode. An episode is dark if no pixel of
these frames is brighter than 8 of 255, in any colour. It plays until it is settled whether most episodes are dark. One
lit pixel on a black screen is enough, and so is a picture that fades in.

## Why is this bad?
Such a frame shows nothing to a person, and divided by 255 next to nothing to a network. Mostly the colours were meant
as shares of 1, or as numbers of a palette, and were cast to bytes as they are.

## Example
```python
frame = np.zeros((84, 84, 3))
frame[self.y, self.x] = (1.0, 0.5, 0.0)
return frame.astype(np.uint8)            # LN001: use (frame * 255).astype(np.uint8)
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.judging.statistics import settle
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The first so many frames of an episode are looked at; the first of them is that of the reset.
_FRAMES = 64
#: The brightest that a pixel of a dark frame is.
_DARK = 8
#: "Most episodes" are more than this share.
_MOST = 0.5


class Brightness(Check):
    name = "brightness"
    rules = (
        Rule(
            "LN001",
            "dark-frames",
            "Hardly anything on the screen can be seen.",
            "Scale colours to 0 to 255 before they are cast to bytes.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        def dark(number: int) -> bool:
            return brightest(subject.rollout(_watched(subject, number))) <= _DARK

        def prefetch(numbers: range) -> None:
            subject.prefetch(_watched(subject, number) for number in numbers)

        verdict, rate = settle(dark, _MOST, subject.budget.looks, prefetch)
        if verdict is None:
            raise Undecided(f"whether most episodes are dark is not settled: {rate}")
        if verdict:
            plays = [subject.rollout(_watched(subject, number)) for number in range(rate.n)]
            seen = [value for play in plays if (value := brightest(play)) <= _DARK]
            shown = next(play for play in plays if brightest(play) <= _DARK)
            yield self.finding(
                "LN001",
                f"no pixel is brighter than {max(seen)} of 255 in the first {_FRAMES} frames under random play, on "
                f"{rate} seeds",
                line=subject.line_of("render") or subject.line_of("step"),
                repro=repro(shown.rollout.cut(shown.steps)),
                brightest=max(seen),
                rate=rate.evidence(),
            )

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        recorded = finding.repro
        rollout = Rollout(recorded.seed, recorded.actions, Conditions.from_json(recorded.conditions), keep=_FRAMES)
        return finding if brightest(subject.rollout(rollout)) <= _DARK else None


def _watched(subject: Subject, number: int) -> Rollout:
    """Random play whose frames are kept; a trace usually has only a digest of each."""
    return msgspec.structs.replace(subject.probes.random(number, _FRAMES - 1), keep=_FRAMES)


def brightest(trace: Trace) -> int:
    """The highest value of any pixel in the frames that a trace kept. Raises Skip if it kept no picture."""
    # The shape and the type come from the environment, regardless of its space.
    pictures = [frame for frame in trace.frames if frame.dtype == "uint8" and frame.ndim in (2, 3) and frame.size]
    if not pictures:
        raise Skip("its observations are not pictures")
    return max(int(picture.max()) for picture in pictures)
