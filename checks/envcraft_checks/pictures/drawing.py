"""Where a method makes the picture that it returns."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from envcraft.model.target import Kind
from envcraft_checks.linting.program import Function, line, program_of
from envcraft_checks.rewards.syntax import returns

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject


def frame_line(subject: Subject) -> int | None:
    """The only line at which step() makes the picture that it returns later, under a name; None if there is none."""
    source = subject.target.kind is Kind.SOURCE and not subject.target.wrappers
    program = program_of(subject) if source else None
    step = program.method(program.env, "step") if program is not None else None
    lines = {_made_at(step, each) for each in returns(step)} if step is not None else set()
    return lines.pop() if len(lines) == 1 else None


def _made_at(step: Function, result: ast.Return) -> int | None:
    first = result.value.elts[0] if isinstance(result.value, ast.Tuple) and result.value.elts else None
    if not isinstance(first, ast.Name):
        return None
    made = [line(node) for target, _, node in step.bindings if isinstance(target, ast.Name) and target.id == first.id]
    # What changes the game may follow; a return that follows at once leaves no room for it.
    return made[0] if len(made) == 1 and made[0] < line(result) - 1 else None
