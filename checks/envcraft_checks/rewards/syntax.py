"""What statements bind, which of them come before others, and numbers that never change, read from a syntax tree."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from envcraft_checks.linting.program import Function, Program, line, name_of

#: Names that lead from one to the next.
_DEEPEST = 30
_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_SIGNS = {ast.Add: 1, ast.Sub: -1}
_LOOPS = (ast.For, ast.AsyncFor, ast.While)
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)


@dataclass(eq=False)
class Scope:
    """One call of a function.

    Attributes:
        function: what is called.
        arguments: the value of each parameter, with the statement of the call and the scope around it.
        repeated: whether the function may be called several times in a step.
    """

    function: Function
    arguments: dict[str, tuple[ast.expr, ast.stmt, Scope]] = field(default_factory=dict)
    repeated: bool = False


class Binding(NamedTuple):
    """A statement that binds a name or changes its value: ``=``, ``+``, ``-``, or ``*`` for any other change."""

    statement: ast.stmt
    value: ast.expr
    change: str
    part: int | None = None


def constant(value: ast.expr, scope: Scope | None, program: Program, depth: int = 0) -> float | None:
    """The number that an expression always is: of constants, and of names that the file binds once."""
    if depth > _DEEPEST:
        return None
    match value:
        case ast.Constant(value=bool()):
            return None
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.UnaryOp(op=ast.USub(), operand=part):
            known = constant(part, scope, program, depth + 1)
            return -known if known is not None else None
        case ast.BinOp(left=one, op=op, right=other) if type(op) in _OPERATORS:
            pair = [constant(part, scope, program, depth + 1) for part in (one, other)]
            try:
                return None if pair[0] is None or pair[1] is None else _OPERATORS[type(op)](pair[0], pair[1])
            except (ZeroDivisionError, OverflowError):
                return None
        case ast.Call(func=func, args=[part], keywords=[]) if name_of(func) in ("float", "int"):
            return constant(part, scope, program, depth + 1)
    if scope is None or not isinstance(value, ast.Name | ast.Attribute):
        return None
    owner = program.bound_to(scope.function)
    if isinstance(value, ast.Attribute):
        if isinstance(value.value, ast.Name) and value.value.id in program.classes:
            owner = value.value.id
        elif not scope.function.field(value):
            return None
        written = value.attr in program.field_values(owner)
        known_values = [] if written else [program.class_values(owner).get(value.attr, ("", None))[1]]
    else:
        known_values = [one for one, _ in program.values(value, scope.function)]
    changed = any(isinstance(node, ast.AugAssign) and name_of(node.target) == name_of(value) for node in program.nodes)
    if changed or len(known_values) != 1 or known_values[0] is None:
        return None
    return constant(known_values[0], scope if isinstance(value, ast.Name) else None, program, depth + 1)


def largest(value: ast.expr, scope: Scope, program: Program) -> float | None:
    """The largest size of an expression that is a constant, or a choice of constants."""
    if isinstance(value, ast.IfExp):
        sizes = [largest(part, scope, program) for part in (value.body, value.orelse)]
        return None if sizes[0] is None or sizes[1] is None else max(sizes[0], sizes[1])
    known = constant(value, scope, program)
    return abs(known) if known is not None else None


def returns(function: Function) -> Iterator[ast.Return]:
    """The returns of a function, without those of functions in it."""
    waiting: list[ast.AST] = list(function.node.body)
    while waiting:
        node = waiting.pop(0)
        if isinstance(node, ast.Return):
            yield node
        elif not isinstance(node, SCOPES):
            waiting += ast.iter_child_nodes(node)


def bound_by(node: ast.AST, program: Program) -> Iterator[tuple[ast.expr, Binding]]:
    """Each name or attribute that a node binds."""
    match node:
        case ast.Assign(targets=targets, value=value):
            for target in targets:
                yield from _parts(target, Binding(node, value, "="))
        case ast.AnnAssign(target=target, value=ast.expr() as value):
            yield target, Binding(node, value, "=")
        case ast.AnnAssign(target=target):
            # The name has no value yet.
            yield target, Binding(node, target, "")
        case ast.AugAssign(target=target, op=op, value=value):
            yield target, Binding(node, value, change_of(op))
        case ast.NamedExpr(target=target, value=value):
            parent: ast.AST = node
            while not isinstance(parent, ast.stmt):
                parent = program.parents[parent]
            yield target, Binding(parent, value, "=")


def change_of(op: ast.operator) -> str:
    return {ast.Add: "+", ast.Sub: "-"}.get(type(op), "*")


def _parts(target: ast.expr, binding: Binding) -> Iterator[tuple[ast.expr, Binding]]:
    if not isinstance(target, ast.Tuple | ast.List):
        yield target, binding
        return
    for number, part in enumerate(target.elts):
        if isinstance(part, ast.Name | ast.Attribute):
            yield part, binding._replace(part=number)


def changes(one: Binding, is_it: Callable[[ast.AST], bool], plain: Callable[[ast.expr], ast.expr]) -> Iterator[Binding]:
    """A binding as changes of the value before: an assignment may add to it, or keep it."""
    if one.change != "=" or one.part is not None:
        if one.change:
            yield one
        return
    value = plain(one.value)
    if is_it(value):
        return
    if not any(is_it(part) for part in ast.walk(value)):
        yield one
        return
    terms = list(summands(value))
    own = [term for term, sign in terms if is_it(plain(term)) and sign > 0]
    others = [(term, sign) for term, sign in terms if term not in own]
    if len(own) == 1 and not any(is_it(part) for term, _ in others for part in ast.walk(term)):
        for term, sign in others:
            yield Binding(one.statement, term, "+" if sign > 0 else "-")
    else:
        yield Binding(one.statement, value, "*")


def summands(value: ast.expr, sign: int = 1) -> Iterator[tuple[ast.expr, int]]:
    if isinstance(value, ast.BinOp) and type(value.op) in _SIGNS:
        yield from summands(value.left, sign)
        yield from summands(value.right, sign * _SIGNS[type(value.op)])
    elif isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.USub):
        yield from summands(value.operand, -sign)
    else:
        yield value, sign


def is_fixed(value: ast.expr) -> bool:
    """Whether an expression looks like a fixed limit: a number, or a name in capitals."""
    if isinstance(value, ast.UnaryOp):
        return is_fixed(value.operand)
    return isinstance(value, ast.Constant) or name_of(value).isupper()


def place(node: ast.AST) -> tuple[int, int]:
    return line(node), getattr(node, "col_offset", 0)


Blocks = list[tuple[ast.AST, str, int]]


def blocks_to(statement: ast.stmt, program: Program) -> Blocks:
    """The way from a function to a statement: in each block the node, the block's name and the position in it."""
    found: Blocks = []
    node: ast.AST = statement
    while node in program.parents:
        parent = program.parents[node]
        for name, value in ast.iter_fields(parent):
            if isinstance(value, list) and node in value:
                found.append((parent, name, value.index(node)))
        if isinstance(parent, SCOPES):
            break
        node = parent
    return found[::-1]


def comes_before(one: Blocks, other: Blocks, looped: bool = True) -> bool:
    """Whether a statement may run before another one in the same call.

    Args:
        one: the way to the statement.
        other: the way to the other one.
        looped: the answer if a loop runs both.
    """
    for depth, (first, second) in enumerate(zip(one, other, strict=False)):
        if first == second:
            if isinstance(first[0], _LOOPS) and first[1] == "body":
                return looped
            continue
        if isinstance(first[0], _LOOPS) and first[1] == second[1] == "body":
            return looped
        if isinstance(first[0], ast.If | ast.Match) and (first[1] != second[1] or first[1] == "cases"):
            return False
        if first[1] != second[1]:
            return first[1] in ("body", "handlers")
        return first[1] != "handlers" and first[2] < second[2] and not _ends(one[depth + 1 :])
    return False


def _ends(blocks: Blocks) -> bool:
    """Whether one of some blocks leaves the function after a statement in it."""
    for node, name, position in blocks:
        later = getattr(node, name)[position + 1 :]
        if any(isinstance(one, ast.Return | ast.Raise) for one in later):
            return True
    return False


def is_looped(node: ast.AST, scope: Scope, program: Program) -> bool:
    while node in program.parents and node is not scope.function.node:
        node = program.parents[node]
        if isinstance(node, (*_LOOPS, ast.ListComp, ast.GeneratorExp, ast.SetComp, ast.DictComp)):
            return True
    return False
