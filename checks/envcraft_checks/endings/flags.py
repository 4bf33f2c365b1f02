"""Where step() makes a flag that is no bool, and where it returns the wrong one."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from envcraft_checks.interface.lines import line_of_result
from envcraft_checks.linting.program import Program, line, program_of
from envcraft_checks.linting.results import misplaced_flags

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import Line

_FLAGS = {"terminated": 2, "truncated": 3}
_RESULTS = 5


def flag_line(program: Program, flag: str, ran: frozenset[int] = frozenset()) -> int | None:
    """Return the line of step() that gives a flag a value which need not be a bool.

    Args:
        program: the source.
        flag: ``terminated`` or ``truncated``.
        ran: lines that ran in the call. Of several lines, those among these count.

    Returns:
        The line; None if there is none or several.
    """
    step = program.method(program.env, "step")
    if step is None:
        return None
    lines = set()
    for node in step.nodes:
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == _RESULTS:
            returned = node.value.elts[_FLAGS[flag]]
            values = [value for target, value, _ in step.bindings if ast.unparse(target) == ast.unparse(returned)]
            lines |= {line(value) for value in values or [returned] if value is not None and not _is_bool(value)}
    lines = lines & ran or lines
    return lines.pop() if len(lines) == 1 else None


def deciding_line(subject: Subject, flag: str) -> int | Line:
    """Return the line of step() that decides a flag; where several may, the one that returns it, or that of step().

    Args:
        subject: the environment.
        flag: ``terminated`` or ``truncated``.
    """
    program = program_of(subject) if not subject.target.wrappers else None
    step = program.method(program.env, "step") if program is not None else None
    if step is None:
        return subject.line_of("step")
    lines: set[int] = set()
    for node in step.nodes:
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == _RESULTS:
            returned = node.value.elts[_FLAGS[flag]]
            values = [value for target, value, _ in step.bindings if ast.unparse(target) == ast.unparse(returned)]
            every = (value for value in values or [returned] if not isinstance(value, ast.Constant))
            lines |= {line(value) for value in every if value is not None}
    return lines.pop() if len(lines) == 1 else line_of_result(subject, "step", _FLAGS[flag])


def returned_flags(subject: Subject) -> tuple[int | Line, str]:
    """Where step() returns its flags, and how they are misplaced, as far as their names say.

    Args:
        subject: the environment.

    Returns:
        The line, and words to end a message with, such as ``; line 53 returns ...``; "" if the names do not say.
    """
    program = program_of(subject)
    found = next(misplaced_flags(program), None) if program is not None else None
    if found is None:
        return line_of_result(subject, "step", _FLAGS["terminated"]), ""
    return found.line, f"; line {found.line} {found.words}"


def _is_bool(node: ast.expr) -> bool:
    """Whether the text shows that a value is a bool."""
    match node:
        case (
            ast.Constant(value=bool()) | ast.UnaryOp(op=ast.Not()) | ast.Compare() | ast.Call(func=ast.Name(id="bool"))
        ):
            return True
        case ast.BoolOp(values=values):
            return all(map(_is_bool, values))
        case ast.IfExp(body=body, orelse=orelse):
            return _is_bool(body) and _is_bool(orelse)
    return False
