"""Rows of arrays that an assignment of tuples swaps, although each row is a view."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator

from .program import Function, Program, Suspect, arguments, line, name_of

_ALLOCATED = frozenset({"empty", "full", "ones", "zeros"})
#: Methods of generators that draw an array of a size.
_DRAWN = frozenset({"choice", "integers", "normal", "random", "uniform"})
_DEPTH = 6


def swapped_rows(program: Program) -> Iterator[Suspect]:
    """Find ``a[i], a[j] = a[j], a[i]`` for an array of at least two dimensions, which leaves both rows equal."""
    for function in program.all:
        for node in function.nodes:
            match node:
                case ast.Assign(
                    targets=[ast.Tuple(elts=[ast.Subscript() as first, ast.Subscript() as second])],
                    value=ast.Tuple(elts=[one, other]),
                ):
                    pass
                case _:
                    continue
            array, crossed = ast.unparse(first.value), [ast.unparse(second), ast.unparse(first)]
            same = [ast.unparse(one), ast.unparse(other)] == crossed and array == ast.unparse(second.value)
            if same and all(_rows_left(program, function, each) for each in (first, second)):
                yield Suspect(line(node), f"swaps views of rows, so both become the same: {ast.unparse(node)[:60]}")


def _rows_left(program: Program, function: Function, node: ast.Subscript) -> bool:
    """Whether an index of an array leaves at least one of its dimensions."""
    indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if not all(isinstance(index, ast.Slice) or _is_whole(program, index, function) for index in indices):
        return False
    left = sum(isinstance(index, ast.Slice) for index in indices)
    if isinstance(node.value, ast.Name) and node.value.id in function.parameters:
        return False
    values = program.values(node.value, function)
    known = [_dimensions(program, value, owner) for value, owner in values]
    return bool(known) and all(size > 0 and size - len(indices) + left > 0 for size in known)


def _is_whole(
    program: Program, node: ast.expr, function: Function, depth: int = _DEPTH, known: Collection[ast.AST] = ()
) -> bool:
    """Whether an index is one whole number, and no tuple, list or array of indices, if those in `known` are."""
    if depth == 0 or node in known:
        return depth > 0
    match node:
        case ast.Constant(value=int()):
            return True
        case ast.UnaryOp(operand=one):
            return _is_whole(program, one, function, depth, known)
        case ast.BinOp(left=left, right=right):
            return _is_whole(program, left, function, depth, known) and _is_whole(
                program, right, function, depth, known
            )
        case ast.Call(func=ast.Name(id="int" | "len")):
            return True
        case ast.Call(func=ast.Name(id="max" | "min"), args=args):
            return all(_is_whole(program, one, function, depth, known) for one in args)
        case ast.Compare(left=left):
            return _is_whole(program, left, function, depth, known)
        case ast.Attribute() if function.field(node):
            values = program.values(node, function)
            # A number that is added to itself stays one.
            own = {one for value, _ in values if value is not None for one in ast.walk(value) if _same(one, node)}
            return bool(values) and all(
                value is not None and _is_whole(program, value, owner or function, depth - 1, own)
                for value, owner in values
            )
        case ast.Name(id=name) if name in function.local:
            counted = (
                loop.target
                for loop in function.nodes
                if isinstance(loop, ast.For) and isinstance(loop.iter, ast.Call) and name_of(loop.iter) == "range"
            )
            if any(name_of(target) == name for target in counted):
                return True
            if name in function.parameters:
                return _given_whole(program, function, name, depth - 1)
            values = program.values(node, function)
            return all(value is not None and _is_whole(program, value, function, depth - 1) for value, _ in values)
        case ast.Name(id=name):
            value = program.module_values.get(name)
            return value is not None and _is_whole(program, value, function, depth - 1)
    return False


def _same(one: ast.AST, other: ast.expr) -> bool:
    return isinstance(one, ast.Attribute) and ast.unparse(one) == ast.unparse(other)


def _given_whole(program: Program, function: Function, name: str, depth: int) -> bool:
    """Whether all calls give a parameter a whole number."""
    given = [
        (value, caller)
        for caller in program.all
        for call in caller.nodes
        if isinstance(call, ast.Call) and program.called(call, caller) is function
        for parameter, value in arguments(call, function)
        if parameter == name
    ]
    return bool(given) and all(_is_whole(program, value, caller, depth) for value, caller in given)


def _dimensions(program: Program, node: ast.expr | None, function: Function | None) -> int:
    """The number of dimensions of a new array of NumPy; 0 if it is not known."""
    while isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ("copy", "astype"):
        node = node.func.value
    if not isinstance(node, ast.Call) or any(name_of(keyword.value) == "object" for keyword in node.keywords):
        return 0
    shape: ast.expr | None = None
    name = name_of(node.func)
    if name in _ALLOCATED and program.path(node.func, function).startswith("numpy."):
        shape = node.args[0] if node.args else None
    elif name in _DRAWN:
        shape = next((keyword.value for keyword in node.keywords if keyword.arg == "size"), None)
    elif name == "reshape":
        shape = node.args[0] if len(node.args) == 1 else ast.Tuple(node.args)
    elif name == "array" and program.path(node.func, function) == "numpy.array" and node.args:
        depth, inner = 0, node.args[0]
        while isinstance(inner, ast.List | ast.Tuple | ast.ListComp) and (
            isinstance(inner, ast.ListComp) or inner.elts
        ):
            depth, inner = depth + 1, inner.elt if isinstance(inner, ast.ListComp) else inner.elts[0]
        return depth
    return len(shape.elts) if isinstance(shape, ast.Tuple | ast.List) else 0


def _nested(node: ast.expr) -> int:
    """The number of dimensions of nested lists of equal lengths that are written out; 0 for others."""
    depth, level = 0, [node]
    while all(isinstance(one, ast.List | ast.Tuple) for one in level):
        items = [one.elts for one in level if isinstance(one, ast.List | ast.Tuple)]
        if len({len(one) for one in items}) > 1 or not items[0]:
            return 0
        depth, level = depth + 1, [item for one in items for item in one]
    return 0 if any(isinstance(one, ast.List | ast.Tuple) for one in level) else depth
