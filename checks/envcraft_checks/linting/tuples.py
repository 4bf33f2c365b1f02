"""The numbers in the tuples of a list, such as what each coin is worth."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import READERS, Function, name_of
from .ranges import Ranges


def numbers_in_tuples(ranges: Ranges, node: ast.expr, method: Function) -> set[float]:
    """The numbers that one place of the tuples in a list may be, such as ``coin[2]`` in ``for coin in self.coins``, or
    ``worth`` in ``for x, y, worth in self.coins``.

    They are known if steps add tuples to the list again and again, and no test in the loop selects some of them by a
    place that is written out.

    Returns:
        The numbers; none if they are not known.
    """
    match node:
        case ast.Subscript(value=ast.Name(id=part), slice=ast.Constant(value=int() as place)):
            loops = [one for one in method.nodes if isinstance(one, ast.For) and name_of(one.target) == part]
        case ast.Name(id=part):
            loops = [
                one
                for one in method.nodes
                if isinstance(one, ast.For)
                and isinstance(one.target, ast.Tuple)
                and part in map(name_of, one.target.elts)
            ]
            names = loops[0].target.elts if loops and isinstance(loops[0].target, ast.Tuple) else []
            place = next((number for number, one in enumerate(names) if name_of(one) == part), 0)
        case _:
            return set()
    bound = [
        one for one in method.nodes if isinstance(one, ast.Name) and one.id == part and isinstance(one.ctx, ast.Store)
    ]
    if len(loops) != 1 or len(bound) != 1 or ranges.program.bound_to(method) != ranges.program.env:
        return set()
    listed = loops[0].iter
    match listed:
        case ast.Call(func=ast.Name(id="list" | "tuple" | "sorted" | "reversed"), args=[listed]):
            pass
        case ast.Subscript(value=listed, slice=ast.Slice(lower=None, upper=None)):
            pass
    field = method.field(listed)
    tuples = list(_tuples(ranges, field)) if field else []
    rows = [part.elts for part, _ in tuples if part is not None and len(part.elts) > place]
    if not rows or len(rows) != len(tuples) or _selects(loops[0], place, rows):
        return set()
    again = [one for one in ranges.program.reached("step") if any(owner is one for _, owner in tuples)]
    found = [ranges.numbers(row[place], owner) for row, (_, owner) in zip(rows, tuples, strict=True)]
    return set().union(*found) if again and all(found) else set()


def _selects(loop: ast.For, place: int, rows: list[list[ast.expr]]) -> bool:
    """Whether a test in a loop reads the place, or one that is written out in some tuple."""
    fixed = {number for row in rows for number, one in enumerate(row) if isinstance(one, ast.Constant)} | {place}
    names = [name_of(one) for one in loop.target.elts] if isinstance(loop.target, ast.Tuple) else []
    whole = loop.target.id if isinstance(loop.target, ast.Name) else ""
    tests: list[ast.AST] = []
    for node in ast.walk(loop):
        match node:
            case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test) | ast.Assert(test=test):
                tests.append(test)
            case ast.Match() | ast.NamedExpr():
                return True
    for node in (part for test in tests for part in ast.walk(test)):
        match node:
            case ast.Subscript(value=ast.Name(), slice=ast.Constant(value=int() as number)) if number in fixed:
                return True
            case ast.Name(id=name) if name in names and names.index(name) in fixed:
                return True
            case ast.Call(args=given) if any(isinstance(one, ast.Name) and one.id == whole for one in given):
                return True
    return False


def _tuples(ranges: Ranges, field: str) -> Iterator[tuple[ast.Tuple | None, Function]]:
    """The tuples that the environment puts in a list of its own; None for anything else, or if the list may change
    under another name.
    """
    methods = ranges.program.methods(ranges.program.env)
    own = {node for one in methods for node in one.nodes}
    for node in ranges.program.nodes:
        if isinstance(node, ast.Attribute) and node.attr == field and node not in own:
            yield None, methods[0]
    renewed = any(
        one.field(target) == field for one in ranges.program.reached("reset") for target, _, _ in one.bindings
    )
    for method in methods:
        given = {target: value for target, value, _ in method.bindings}
        for node in method.nodes:
            if not isinstance(node, ast.Attribute) or method.field(node) != field:
                continue
            outer = ranges.program.parents[node]
            match outer, ranges.program.parents.get(outer):
                case _ if isinstance(node.ctx, ast.Store) and not isinstance(outer, ast.AugAssign):
                    if method.name != "__init__" or not renewed:
                        yield from ((part, method) for part in _listed(given.get(node), field, method))
                case ast.Attribute(attr="append"), ast.Call(args=[ast.Tuple() as part]):
                    yield part, method
                case ast.Attribute(attr="remove" | "pop" | "popleft" | "clear" | "index" | "count"), ast.Call():
                    pass
                case (
                    (ast.For() | ast.comprehension() | ast.Compare() | ast.If() | ast.BoolOp() | ast.UnaryOp()),
                    _,
                ):
                    pass
                case ast.Call(func=ast.Name(id=name)), _ if name in READERS:
                    pass
                case ast.Subscript(ctx=ast.Load(), slice=ast.Slice(lower=None, upper=None)), ast.For():
                    pass
                case _:
                    yield None, method


def _listed(value: ast.expr | None, field: str, method: Function) -> Iterator[ast.Tuple | None]:
    """The tuples in a list that is written out, or made by a comprehension; None for anything else."""
    match value:
        case ast.List(elts=items):
            yield from (item if isinstance(item, ast.Tuple) else None for item in items)
        case ast.ListComp(elt=ast.Tuple() as item):
            yield item
        case ast.ListComp(elt=ast.Name(id=kept), generators=[ast.comprehension(target=ast.Name(id=each), iter=listed)]):
            if kept != each or method.field(listed) != field:
                yield None
        case _:
            yield None
