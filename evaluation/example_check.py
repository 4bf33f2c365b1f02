"""# example

## What it does
Checks that no info marks a defect: `info["example"]` must not be `True` at any step of any episode.

## Why is this bad?
Replace this rule by your own, and describe here what the defect does to training.

## Example
```python
return frame, reward, terminated, truncated, {"example": True}   # EC000
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.verdict import Finding
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject


class Example(Check):
    name = "example"
    rules = (Rule("EC000", "info-marked", "info marks a defect.", "Remove the mark."),)

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [trace for trace in subject.played() if trace.usable]
        if not traces:
            raise Skip("no episode has a step")
        for trace in traces:
            for step in range(len(trace.infos)):
                if trace.info(step).get(self.name) is True:
                    yield self.finding(
                        "EC000",
                        f"info marks a defect at step {step} (under {trace.rollout.player})",
                        line=subject.line_of("step" if step else "reset"),
                        repro=repro(trace.rollout.cut(step)),
                        step=step,
                    )
                    return


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Example()]
