"""The line that makes a container larger which no episode empties."""

from __future__ import annotations

import ast

from .program import MUTATORS, Function, Program, line, root

#: What makes a container larger.
_GROWS = frozenset({"add", "append", "appendleft", "extend", "extendleft", "insert", "setdefault", "update"})


def growing_line(program: Program, method: str) -> int | None:
    """Find the only line at which a method, or one that it calls, makes a container larger that play never empties.

    Args:
        program: the file.
        method: ``reset`` or ``step``.

    Returns:
        The line; None if there are none or several.
    """
    emptied = {_kept(program, one, target) for one in program.play for target, _, _ in one.bindings}
    for one in program.play:
        for target, node in one.writes:
            if _shrinks(node):
                emptied.add(_kept(program, one, target))
    found = {
        line(node)
        for one in program.reached(method)
        for target, node in one.writes
        if _grows(program, one, target, node) and _kept(program, one, target) not in emptied
    }
    return found.pop() if len(found) == 1 else None


def _grows(program: Program, function: Function, target: ast.expr, node: ast.AST) -> bool:
    """Whether a write makes what an attribute of self or a name of the module holds larger."""
    values = [value for value, _ in program.values(root(target), function)]
    if _kept(program, function, target) is None or any(map(_is_bounded, values)):
        return False
    match node:
        case ast.Call(func=ast.Attribute(attr=attr)):
            return attr in _GROWS
        case ast.AugAssign(op=ast.Add(), value=ast.List() | ast.ListComp() | ast.Tuple()):
            return True
        case ast.Subscript(ctx=ast.Store()):
            return bool(values) and all(map(_is_dict, values))
    return False


def _is_dict(value: ast.expr | None) -> bool:
    match value:
        case ast.Dict() | ast.Call(func=ast.Name("dict" | "defaultdict" | "OrderedDict")):
            return True
    return False


def _is_bounded(value: ast.expr | None) -> bool:
    """Whether a value is a deque that drops what is too much."""
    return isinstance(value, ast.Call) and any(keyword.arg == "maxlen" for keyword in value.keywords)


def _shrinks(node: ast.AST) -> bool:
    match node:
        case ast.Subscript(ctx=ast.Del()):
            return True
        case ast.Call(func=ast.Attribute(attr=attr)):
            return attr in MUTATORS - _GROWS - {"fill", "reverse", "rotate", "sort"}
    return False


def _kept(program: Program, function: Function, target: ast.expr) -> tuple[str, str] | None:
    """The attribute of self, with the class, or the name of the module that an expression is; None for another."""
    if field := function.field(target):
        return program.bound_to(function), field
    if isinstance(target, ast.Name) and target.id not in function.local and target.id in program.module_values:
        return "", target.id
    return None
