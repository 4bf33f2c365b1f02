"""An environment without a render mode, which is what ``gymnasium.make`` gives, against one with ``rgb_array``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.judging.shrink import repro
from envcraft.model import phases
from envcraft.model.rollout import Conditions
from envcraft_checks.comparing.places import located
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import Finding

#: Steps that are compared.
_STEPS = 20
_UNRENDERED = Conditions(unrendered=True)


def unrendered(check: Check, subject: Subject) -> Iterator[Finding]:
    """Compare the first steps of an episode with those without a render mode, if the constructor's default is None."""
    rendering = subject.load().description.get("rendering")
    if rendering is None or rendering["given"] is None or not rendering["optional"]:
        return
    play = subject.episodes.probed[0]
    rollout = play.rollout.cut(min(_STEPS, play.steps))
    trace = subject.rollout(rollout.under(_UNRENDERED))
    base = subject.rollout(rollout)
    if (found := diverge(base, trace, info=False)) is None or diverge(base, subject.rerun(rollout), info=False):
        return
    fault = trace.fault
    if fault is not None and found.field == "length":
        happens = f"raises {subject.raised(fault)}" if fault.type else f"returns {fault.malformed}"
        words = f"{phases.in_words(fault.phase, fault.step)} {happens}"
    else:
        found = located(subject, rollout, _UNRENDERED, found)
        words = f"the {found}"
    yield check.finding(
        "EC219",
        f"without a render mode, the default, {words}",
        line=(fault and fault.line) or _reading(subject) or subject.line_of("step" if found.step else "reset"),
        repro=repro(rollout.cut(found.step).under(_UNRENDERED)),
        step=found.step,
        field=found.field,
        first=found.first,
        second=found.second,
        traceback=fault.traceback if fault is not None else None,
    )


def _reading(subject: Subject) -> int | None:
    """The first line that reads the render mode during play; None if none does."""
    if (program := program_of(subject)) is None:
        return None
    return next(
        (
            node.lineno
            for function in program.play
            for node in function.nodes
            if isinstance(node, ast.Attribute) and node.attr == "render_mode" and isinstance(node.ctx, ast.Load)
        ),
        None,
    )
