"""Ends of the episode that the code lists, and that never end it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .late import calls_of
from .program import Function, Program, Suspect, line, name_of
from .success import CONDITIONS, PURE, Conditions

_TERMINATED, _RESULTS = 2, 5


def absorbed_ends(program: Program) -> Iterator[Suspect]:
    """Find a reason for the end that never makes the flag true, as ``lost`` does not in ``(won or lost) and won``."""
    step = program.method(program.env, "step")
    ends = [node for node in step.nodes if isinstance(node, ast.Return)] if step is not None else []
    if (
        step is None
        or len(ends) != 1
        or not isinstance(ends[0].value, ast.Tuple)
        or len(ends[0].value.elts) != _RESULTS
    ):
        return
    end, flag = ends[0], ends[0].value.elts[_TERMINATED]
    conditions = Conditions(program, step, end)
    value = conditions.of(flag, end)
    if not 0 < len(conditions.atoms) <= CONDITIONS:
        return
    same = [atoms for atoms in _alike(program, step, conditions, end) if len(atoms) > 1]
    rows = [row for row in conditions.rows() if all(len({row[each] for each in atoms}) == 1 for atoms in same)]
    if not any(map(value, rows)):
        yield Suspect(line(flag), f"returns {ast.unparse(flag)[:60]} as terminated, which is never true")
        return
    listed = {ast.unparse(part) for part in _listed(program, step, flag)}
    for atom, (node, _) in conditions.atoms.items():
        group = next((atoms for atoms in same if atom in atoms), [atom])
        true, false = (dict.fromkeys(group, holds) for holds in (True, False))
        if ast.unparse(node) in listed and not any(value(row | true) and not value(row | false) for row in rows):
            yield Suspect(line(node), f"lists {ast.unparse(node)[:40]} as an end, which never makes terminated true")
            return


def _listed(program: Program, step: Function, flag: ast.expr) -> Iterator[ast.expr]:
    """The parts of choices of which a flag is made, and what names among them stand for."""
    waiting: list[tuple[ast.expr, bool]] = [(flag, False)]
    seen: set[tuple[ast.expr, bool]] = set()
    while waiting:
        node, chosen = waiting.pop()
        if (node, chosen) in seen:
            continue
        seen.add((node, chosen))
        if chosen:
            yield node
        match node:
            case ast.BoolOp(op=op, values=values):
                waiting += [(value, isinstance(op, ast.Or)) for value in values]
            case ast.Call(func=ast.Name(id="bool"), args=[inner]):
                waiting.append((inner, chosen))
            case ast.Name():
                waiting += [(value, chosen) for value, _ in program.values(node, step) if value is not None]


def _alike(program: Program, step: Function, conditions: Conditions, end: ast.Return) -> Iterator[list[str]]:
    """The atoms with the same text that nothing changes from the first of them on."""
    texts: dict[str, list[str]] = {}
    for atom, (node, _) in conditions.atoms.items():
        texts.setdefault(ast.unparse(node), []).append(atom)
    for atoms in texts.values():
        node, _ = conditions.atoms[atoms[0]]
        first = min(line(place) for _, place in (conditions.atoms[atom] for atom in atoms))
        later = [each for each in step.node.body if first <= line(each) <= line(end)]
        if _stay(program, step, node, later):
            yield atoms


def _stay(program: Program, step: Function, node: ast.expr, statements: list[ast.stmt]) -> bool:
    """Whether some statements change nothing that an expression reads, which calls no function of the file."""
    if any(isinstance(part, ast.Call) and name_of(part) not in PURE for part in ast.walk(node)):
        return False
    names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)} - {step.me}
    fields = {step.field(part) for part in ast.walk(node)} - {""}
    parts = [part for statement in statements for part in ast.walk(statement)]
    called = [one for part in parts if isinstance(part, ast.Call) and (one := program.called(part, step)) is not None]
    functions = {each for one in called for each in calls_of(program, one)}
    stored = [part for part in parts if not isinstance(getattr(part, "ctx", ast.Load()), ast.Load)]
    if any((isinstance(part, ast.Name) and part.id in names) or step.field(part) in fields for part in stored):
        return False
    return not any(
        each.field(target) in fields
        for each in functions
        for target in [*(target for target, _, _ in each.bindings), *(target for target, _ in each.writes)]
    )
