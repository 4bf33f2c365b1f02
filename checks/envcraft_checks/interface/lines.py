"""The lines of a file that the check ``api`` names: of a space, a result, or a write into an array."""

from __future__ import annotations

import ast
import contextlib
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING

from envcraft.errors import Skip
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.target import Kind, parse
from envcraft_checks.linting.program import Function, Program, line, program_of
from envcraft_checks.linting.sharing import action_writes, same_objects
from envcraft_checks.rewards.syntax import returns

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.verdict import Finding, Line

_SPACES = {"observation_space", "action_space"}
#: How many values a method returns.
_VALUES = {"reset": 2, "step": 5}


def line_of_space(subject: Subject, space: str) -> int | Line:
    """The line that assigns a space; that of the constructor where the file does not show one."""
    lines = declared(subject, space) if not subject.target.wrappers else []
    return lines[0] if len(lines) == 1 else subject.line_of("__init__")


def declared(subject: Subject, attribute: str) -> list[int]:
    """The lines of the file that assign an attribute of the environment."""
    program = program_of(subject)
    if program is None and (source := subject.installed_source) and subject.env_class is not None:
        with contextlib.suppress(SyntaxError, ValueError, RecursionError, MemoryError):
            program = Program(parse(source), subject.env_class)
    return program.declared_at(attribute) if program is not None else []


def misspelt_space(subject: Subject, space: str) -> tuple[str, int] | None:
    """The attribute of the environment whose name is nearly that of a space, and the line that assigns it; None if the
    file assigns none.
    """
    program = program_of(subject) if not subject.target.wrappers else None
    if program is None:
        return None
    # Slow to import, and needed only for an error.
    import difflib

    names = {*program.field_values(program.env), *program.class_values(program.env)} - _SPACES
    near = difflib.get_close_matches(space, names, n=1, cutoff=0.85)
    return (near[0], program.declared_at(near[0])[0]) if near else None


def overwriting_line(subject: Subject, method: str) -> int | Line:
    """The first line of a method, or of one that it calls, that writes into what it returns as observation; else the
    line of its result.
    """
    source = subject.target.kind is Kind.SOURCE
    number = _first_write(subject.text, subject.class_statement, method) if source else None
    return number or line_of_result(subject, method, 0)


@lru_cache(8)
def _first_write(text: str, env_class: str | None, method: str) -> int | None:
    try:
        program = Program(parse(text), env_class)
    except RecursionError:
        return None
    returned: set[str] = set()
    for one, results in _makers(program, method, 0):
        values = [value for _, value in results if value is not None]
        returned.update(field for value in values for field in same_objects(program, one, value))
        # An attribute may keep what a function returns under a name of its own.
        names = {value.id for value in values if isinstance(value, ast.Name)}
        kept = ((target, value) for target, value, _ in one.bindings if isinstance(value, ast.Name))
        returned.update(field for target, value in kept if value.id in names and (field := one.field(target)))
    for one in program.reached(method):
        if program.bound_to(one) != program.env:
            continue
        writes = (node for target, node in one.writes if returned & same_objects(program, one, target))
        if lines := [line(node) for node in writes]:
            return min(lines)
    return None


def acting_line(subject: Subject) -> int | Line:
    """The first line of step(), or of the functions that it gives its action, that writes into the action; else the
    line of step().
    """
    source = subject.target.kind is Kind.SOURCE and not subject.target.wrappers
    program = program_of(subject) if source else None
    step = program.method(program.env, "step") if program is not None else None
    lines = action_writes(program, step) if program is not None and step is not None else []
    return lines[0] if lines else subject.line_of("step")


def lines_of_call(subject: Subject, finding: Finding, step: int) -> frozenset[int]:
    """The lines of the file that ran in one call of a finding's reproduction, 0 for the reset; none where the budget
    does not allow to play it again.
    """
    small = finding.repro
    if subject.target.wrappers or not subject.affords(step):
        return frozenset()
    conditions = Conditions.from_json(small.conditions)
    rollout = Rollout(small.seed, small.actions, conditions, player="these actions", fields=True)
    with contextlib.suppress(Skip):
        states = subject.rollout(rollout).states
        return states[step].lines if len(states) > step else frozenset()
    return frozenset()


def line_of_result(
    subject: Subject, method: str, part: int | None = None, ran: frozenset[int] = frozenset()
) -> int | Line:
    """Find the line at which a method, or the only function of the file that it calls for this, returns a value.

    Args:
        subject: the environment.
        method: the name of the method.
        part: the place of the value in the result; None for the whole result.
        ran: lines that ran in the call. Of several lines that return, those among these count.

    Returns:
        The line; that of the method where it may be at several, or where it is not in this file.
    """
    source = subject.target.kind is Kind.SOURCE and not subject.target.wrappers
    number = _only_return(subject.text, subject.class_statement, method, part, ran) if source else None
    return number or subject.line_of(method)


@lru_cache(8)
def _only_return(text: str, env_class: str | None, method: str, part: int | None, ran: frozenset[int]) -> int | None:
    # Many traces of one environment may show the same defect.
    try:
        program = Program(parse(text), env_class)
    except RecursionError:
        return None
    found = None
    for number, (_, results) in enumerate(_makers(program, method, part, ran)):
        if number and part is None and not all(isinstance(value, ast.Tuple) for _, value in results):
            # What makes an observation is right: its caller returns it alone.
            break
        if len(results) == 1:
            found = results[0][0]
        elif found is not None:
            break
    return found


def _makers(
    program: Program, method: str, part: int | None, ran: frozenset[int] = frozenset()
) -> Iterator[tuple[Function, list[tuple[int, ast.expr | None]]]]:
    """A method, then the function of the file that it calls wherever it returns a part of its result, and so on, each
    with the lines and the values that it returns. If some of these lines ran, or have the wrong number of values, only
    these.
    """
    function, seen = program.method(program.env, method), set[Function]()
    while function is not None and function not in seen:
        seen.add(function)
        results = [(line(each), _part(each.value, part)) for each in returns(function) if each.value is not None]
        results = [result for result in results if result[0] in ran] or results
        if part is None and method in _VALUES:
            results = [result for result in results if not _is_complete(result[1], _VALUES[method])] or results
        yield function, results
        calls = {_called(program, function, value) for _, value in results}
        function, part = calls.pop() if len(calls) == 1 else None, None


def _is_complete(value: ast.expr | None, count: int) -> bool:
    """Whether a returned value is a tuple of so many values."""
    starred = isinstance(value, ast.Tuple) and any(isinstance(each, ast.Starred) for each in value.elts)
    return isinstance(value, ast.Tuple) and len(value.elts) == count and not starred


def _part(value: ast.expr | None, part: int | None) -> ast.expr | None:
    """One part of a returned tuple; the value itself for None."""
    if part is None:
        return value
    return value.elts[part] if isinstance(value, ast.Tuple) and value.elts else None


def _called(program: Program, function: Function, value: ast.expr | None) -> Function | None:
    """The function of the file whose result a value is, directly or by one name."""
    if isinstance(value, ast.Name):
        bound = program.values(value, function) if value.id in function.local else []
        value = bound[0][0] if len(bound) == 1 else None
    return program.called(value, function) if isinstance(value, ast.Call) else None
