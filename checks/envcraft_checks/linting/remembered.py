"""What the constructor makes and later episodes find changed: tables of what was drawn, and painted surfaces."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .leftovers import by_name
from .outdated import only_if_seeded
from .program import Function, Program, Suspect, line
from .repeating import repeats

#: A test for a key that fills a table: the function, the test, and the key.
_Filled = tuple[Function, ast.If, ast.expr]
#: Methods by which play may empty a table.
_EMPTIES = frozenset({"clear", "pop", "popitem", "update"})


def remembered(program: Program) -> Iterator[Suspect]:
    """Find tables that keep what one episode has drawn, and surfaces on which play paints, that reset() leaves."""
    reset = program.method(program.env, "reset")
    # A base of another file may call what only this class defines.
    if reset is None or "seed" not in reset.parameters or program.has_unknown_base(program.env):
        return
    own = [function for function in program.play if program.bound_to(function) == program.env]
    if any(by_name(node) for one in own for node in one.nodes):
        return
    filled: dict[str, list[_Filled]] = {}
    for function in own:
        for node in function.nodes:
            match node:
                case ast.If(test=ast.Compare(left=key, ops=[ast.NotIn()], comparators=[table])) if (
                    field := function.field(table)
                ):
                    if any(_fills(function, one, field, key) for one in node.body):
                        filled.setdefault(field, []).append((function, node, key))
    for field, found in filled.items():
        yield from _tables(program, own, field, found)
    for field, values in program.field_values(program.env).items():
        if all(one not in program.play and _is_surface(program, value, one) for value, one in values):
            yield from _painted(program, own, field)


def _drawn_fields(program: Program, own: list[Function]) -> set[str]:
    """The attributes that reset() makes of what it draws."""
    resetting = program.reached("reset")
    return {
        field
        for function in own
        if function in resetting
        for target, value, _ in function.bindings
        if (field := function.field(target)) and value is not None and _draws(program, function, value, set())
    }


def _tables(program: Program, own: list[Function], field: str, found: list[_Filled]) -> Iterator[Suspect]:
    """Report ``if key not in self.table: self.table[key] = <what is drawn>`` for keys that come again."""
    seeded = False
    for function in own:
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Attribute(value=owner, attr=attr)) if function.field(owner) == field:
                    empties = attr in _EMPTIES
                case ast.Subscript(ctx=ast.Del(), value=owner):
                    empties = function.field(owner) == field
                case ast.Attribute(ctx=ast.Store()):
                    empties = function.field(node) == field
                case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Call(args=parts):
                    # Under another name it may be emptied where the code does not show it.
                    empties = field in map(function.field, parts)
                case _:
                    continue
            if empties and not only_if_seeded(program, function, node):
                return
            seeded |= empties
    how = "empties only if it has a seed" if seeded else "never empties"
    drawn = _drawn_fields(program, own)
    for function, node, key in found:
        # A table that is emptied for a new seed has keys that come again.
        if not seeded and not repeats(program, key, function):
            continue
        # What belongs to a level that the key names is the same each time.
        parts = [key, *(value for one, value, _ in function.bindings if ast.dump(one) == _stored(key) and value)]
        others = drawn - {function.field(one) for part in parts for one in ast.walk(part)}
        if any(_draws(program, function, statement, others) for statement in node.body):
            yield Suspect(line(node), f"keeps what one episode drew in self.{field}, which reset() {how}")


def _fills(function: Function, statement: ast.stmt, field: str, key: ast.expr) -> bool:
    match statement:
        case ast.Assign(targets=[ast.Subscript(value=table, slice=place)]):
            return function.field(table) == field and ast.dump(place) == ast.dump(key)
    return False


def _stored(key: ast.expr) -> str:
    return ast.dump(key).replace("Load()", "Store()")


def _draws(program: Program, function: Function, node: ast.AST, drawn: set[str]) -> bool:
    """Whether code uses ``self.np_random`` or one of some attributes, here or in the functions that it calls."""
    waiting, seen = [(node, function)], {function}
    while waiting:
        part, where = waiting.pop()
        for one in ast.walk(part):
            if where.field(one) in {"np_random", *drawn} and isinstance(getattr(one, "ctx", None), ast.Load):
                return True
            called = program.called(one, where) if isinstance(one, ast.Call) else None
            if called is not None and called not in seen:
                seen.add(called)
                waiting.append((called.node, called))
    return False


def _is_surface(program: Program, node: ast.expr | None, function: Function) -> bool:
    """Whether an expression is ``pygame.Surface(...)``, or that with a call such as ``convert()``."""
    while isinstance(node, ast.Call):
        if program.path(node.func, function) == "pygame.Surface":
            return True
        node = node.func.value if isinstance(node.func, ast.Attribute) else None
    return False


def _painted(program: Program, own: list[Function], field: str) -> Iterator[Suspect]:
    """Find where step() draws shapes on a surface that no method of play covers again."""
    stepping, found = set(program.reached("step")), []
    for function in own:
        for node in function.nodes:
            if function.field(node) != field:
                continue
            parent = program.parents[node]
            match parent:
                case ast.Call(args=[surface, *_]) if surface is node and _blits(parent):
                    continue
                case ast.Call(func=ast.Attribute() as painter, args=[surface, _, *shape]) if surface is node:
                    path = program.path(painter, function)
                    # A shape that is always the same may be what clears the surface.
                    same = all(isinstance(one, ast.Constant) for one in _leaves(shape))
                    if not path.startswith("pygame.draw.") or same or _may_cover(path, shape):
                        return
                    if function in stepping:
                        words = f"draws on self.{field}, which reset() never repaints: {ast.unparse(parent)[:60]}"
                        found.append(Suspect(line(parent), words))
                case ast.Attribute(attr="get_width" | "get_height" | "get_size" | "get_rect" | "copy"):
                    continue
                case _:
                    return
    yield from found


def _blits(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Attribute) and call.func.attr == "blit"


def _may_cover(path: str, shape: list[ast.expr]) -> bool:
    """Whether a shape may be as large as the surface."""
    if path != "pygame.draw.rect":
        return path == "pygame.draw.polygon"
    match shape:
        case [ast.Tuple(elts=[left, top, *_]), *_]:
            return not any(isinstance(one, ast.Constant) and one.value for one in (left, top))
    return True


def _leaves(parts: list[ast.expr]) -> Iterator[ast.expr]:
    for part in parts:
        for one in ast.walk(part):
            if isinstance(one, ast.Constant | ast.Name | ast.Attribute):
                yield one
