"""What the info of a step reports about success."""

from __future__ import annotations

import ast
from typing import NamedTuple

from .logic import names_success
from .program import Function, Program, line

_FLAGS = 5
_DEPTH = 5


class Reported(NamedTuple):
    """One value that info has under a key that stands for success.

    Attributes:
        key: in info.
        value: the expression.
        function: which contains it.
        end: the return statement of step() whose info it is.
    """

    key: str
    value: ast.expr
    function: Function
    end: ast.Return


def reported(program: Program, step: Function) -> list[Reported] | None:
    """What the return statements of step() report about success.

    Args:
        program: the file.
        step: its method.

    Returns:
        All values; None if the text does not show the keys of each info.
    """
    found: list[Reported] = []
    for end in step.nodes:
        if isinstance(end, ast.Return):
            if not isinstance(end.value, ast.Tuple) or len(end.value.elts) != _FLAGS:
                return None
            values = _values(program, end.value.elts[-1], step, _DEPTH)
            if values is None:
                return None
            found += [Reported(key, value, function, end) for key, value, function in values]
    keys = {each.key for each in found}
    return [each for each in found if each.key == "is_success" or "is_success" not in keys]


def reported_at(program: Program, step: Function, end: ast.Return) -> list[str] | None:
    """The keys for success that the info of one return statement has, None if the text does not show all keys.

    A name counts if the block of the statement binds it and does nothing else to it.
    """
    info = end.value.elts[-1] if isinstance(end.value, ast.Tuple) and len(end.value.elts) == _FLAGS else None
    if isinstance(info, ast.Name):
        name = info.id
        block = program.block(end)
        before = [one for one in block[: block.index(end)] if any(_is_name(node, name) for node in ast.walk(one))]
        bound = before[-1] if before else None
        info = bound.value if isinstance(bound, ast.Assign) and _is_name(bound.targets[0], name) else None
    values = _values(program, info, step, _DEPTH) if info is not None else None
    return None if values is None else [key for key, _, _ in values]


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


_Values = list[tuple[str, ast.expr, Function]]


def _values(program: Program, info: ast.expr, function: Function, depth: int) -> _Values | None:
    """What an expression has under keys that stand for success; None if the text does not show it."""
    if depth == 0:
        return None
    match info:
        case ast.Dict(keys=keys, values=values):
            return _joined(
                [
                    _values(program, value, function, depth - 1) if key is None else _stored(key, value, function)
                    for key, value in zip(keys, values, strict=True)
                ]
            )
        case ast.Call(func=ast.Name(id="dict"), args=args, keywords=keywords):
            inner = [_values(program, each, function, depth - 1) for each in args]
            return _joined([*inner, *(_named(program, each, function, depth) for each in keywords)])
        case ast.BinOp(left=left, op=ast.BitOr(), right=right) | ast.IfExp(body=left, orelse=right):
            return _joined([_values(program, each, function, depth - 1) for each in (left, right)])
        case ast.Call() if (called := program.called(info, function)) is not None:
            returns = [node.value for node in called.nodes if isinstance(node, ast.Return) and node.value is not None]
            return _joined([_values(program, each, called, depth - 1) for each in returns]) if returns else None
        case ast.Name() if info.id in function.local and info.id not in function.parameters:
            return _of_name(program, info.id, function, depth)
    return None


def _of_name(program: Program, name: str, function: Function, depth: int) -> _Values | None:
    parts: list[_Values | None] = []
    for node in function.nodes:
        match node:
            case ast.Name(id=used) if used == name:
                parts.append(_of_use(program, node, function, depth))
    return _joined(parts)


def _of_use(program: Program, node: ast.Name, function: Function, depth: int) -> _Values | None:
    """What one mention of a dictionary puts into it; None if it may put in anything."""
    parent = program.parents[node]
    above = program.parents[parent]
    match parent, above:
        case ast.Assign(targets=targets, value=value), _ if node in targets:
            return _values(program, value, function, depth - 1)
        case ast.AnnAssign(target=target, value=ast.expr() as value), _ if target is node:
            return _values(program, value, function, depth - 1)
        case ast.AugAssign(target=target, value=value), _ if target is node:
            return _values(program, value, function, depth - 1)
        case ast.Subscript(ctx=ast.Store(), slice=key), ast.Assign(value=value):
            return _stored(key, value, function)
        case ast.Attribute(attr="update"), ast.Call(args=args, keywords=keywords):
            inner = [_values(program, each, function, depth - 1) for each in args]
            return _joined([*inner, *(_named(program, each, function, depth) for each in keywords)])
        case ((ast.Attribute(attr="get") | ast.Subscript(ctx=ast.Load()) | ast.Return() | ast.Dict()), _):
            return []
        case ast.Tuple(elts=[*_, last]), ast.Return() if last is node:
            return []
    return None


def _named(program: Program, keyword: ast.keyword, function: Function, depth: int) -> _Values | None:
    if keyword.arg is None:
        return _values(program, keyword.value, function, depth - 1)
    return _stored(ast.Constant(keyword.arg), keyword.value, function)


def _stored(key: ast.expr, value: ast.expr, function: Function) -> _Values | None:
    if not isinstance(key, ast.Constant) or not isinstance(key.value, str):
        return None
    # "wins" counts what may be won several times.
    shown = names_success(key.value) and "wins" not in key.value.split("_")
    return [(key.value, value, function)] if shown else []


def _joined(parts: list[_Values | None]) -> _Values | None:
    found: _Values = []
    for part in parts:
        if part is None:
            return None
        found += part
    return found


def stored(program: Program, end: ast.Return, step: Function) -> list[tuple[str, ast.expr, Function, ast.stmt]]:
    """What a return statement of step() tells about success, each with the last statement of step() that stores it.

    Args:
        program: the file.
        end: the return statement.
        step: the method.

    Returns:
        The key, the value, the function that contains the value, and the statement. None of what a branch stores.
    """
    if not isinstance(end.value, ast.Tuple):
        return []
    info = end.value.elts[-1]
    if not isinstance(info, ast.Name):
        return [(*each, end) for each in _values(program, info, step, _DEPTH) or []]
    last: dict[str, tuple[str, ast.expr, Function, ast.stmt]] = {}
    for node in step.nodes:
        if isinstance(node, ast.Name) and node.id == info.id and line(node) <= line(end):
            statement = statement_of(program, node)
            for each in _of_use(program, node, step, _DEPTH) or []:
                last[each[0]] = (*each, statement)
    return list(last.values())


def statement_of(program: Program, node: ast.AST) -> ast.stmt:
    """The statement that contains a node."""
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
    return node
