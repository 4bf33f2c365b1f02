"""Objects that the module or the constructor creates once, and that play changes in ways that no field shows."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import MUTATORS, Function, Program, Suspect, arguments, bindings, line, name_of, root
from .sharing import writes_into

#: Calls that make an iterator, which only ever goes on.
_ITERATORS = frozenset({"builtins.iter", "itertools.cycle"})
#: Functions that change what they read.
_TAKES = frozenset({"heappop", "heappushpop", "heapreplace", "next"})
#: What makes an array whose values are those of earlier objects.
_EMPTY = frozenset({"numpy.empty", "numpy.empty_like"})


def constants(program: Program) -> Iterator[Suspect]:
    """Find writes to a list of the module through an attribute that reset() sets to it."""
    made = {target.id: line(node) for target, _, node in bindings(program.module_nodes) if isinstance(target, ast.Name)}
    for function in program.play:
        for target, value, _ in function.bindings:
            field = function.field(target)
            name, nested = _object_of(value)
            if not field or name not in made or name in function.local or not _is_container(program, name):
                continue
            owner = program.bound_to(function)
            for one in program.play if len(program.field_values(owner)[field]) == 1 else ():
                for node in one.nodes if program.bound_to(one) == owner else ():
                    if _depth(one, node, field) > nested:
                        what = f"the items of {name}" if nested else name
                        words = f"writes to {what}, which line {made[name]} creates once for all instances"
                        yield Suspect(line(node), words)


def uncopied(program: Program) -> Iterator[Suspect]:
    """Find where reset() gives an attribute an object that is made once, and that play changes in place."""
    resetting = [each for each in program.reached("reset") if program.bound_to(each) == program.env]
    for function in resetting:
        for target, value, statement in function.bindings:
            field = function.field(target)
            if not field or value is None or not _is_made_once(program, value, function, resetting):
                continue
            changes = [line(node) for one in program.play for node in one.nodes if _changes(one, node, field)]
            # The finder above names the writes.
            known = any(_depth(one, node, field) for one in program.play for node in one.nodes)
            if changes and not (known and _is_container(program, name_of(value))):
                words = f"gives self.{field} {ast.unparse(value)} itself, not a copy, and line {changes[0]} changes it"
                yield Suspect(line(statement), words)


def _is_made_once(program: Program, value: ast.expr, function: Function, resetting: list[Function]) -> bool:
    """Whether an expression is a mutable object that the module, a class or the constructor makes, and no reset."""
    if isinstance(value, ast.Name) and value.id not in function.local:
        made = program.module_values.get(value.id)
        return made is not None and not _is_immutable(made)
    if not (field := function.field(value)):
        return False
    made_by = [(made, one) for made, one in program.field_values(program.env).get(field, []) if one in resetting]
    values = [made for made, _ in program.values(value, function)]
    return not made_by and bool(values) and not any(made is not None and _is_immutable(made) for made in values)


def _is_immutable(value: ast.expr) -> bool:
    if isinstance(value, ast.BinOp):
        return _is_immutable(value.left) and _is_immutable(value.right)
    return isinstance(value, ast.Constant | ast.Tuple | ast.UnaryOp | ast.JoinedStr | ast.Compare)


def _changes(function: Function, node: ast.AST, field: str) -> bool:
    """Whether a node writes into the object of an attribute."""
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=attr)):
            return attr in MUTATORS and function.field(value) == field
        case ast.AugAssign(target=target):
            return function.field(target) == field or _depth(function, target, field) > 0
    return _depth(function, node, field) > 0


def changes(program: Program, name: str) -> set[int]:
    """Return the lines of play that may change the object of a name of the module or a class, once play has shown that
    some do: by another name, in a function that takes it, or in a call whose result nothing uses.
    """
    found: set[int] = set()
    for function in program.all:
        found |= {line(node) for target, node in function.writes if _refers(program, function, target, name)}
        for node in function.nodes:
            if not isinstance(node, ast.Call):
                continue
            if (called := program.called(node, function)) is not None:
                for parameter, value in arguments(node, called):
                    if _refers(program, function, value, name):
                        found |= writes_into(program, called, parameter, set())
                continue
            takes = isinstance(program.parents[node], ast.Expr) or name_of(node) in _TAKES
            if takes and any(_refers(program, function, each, name) for each in node.args):
                found.add(line(node))
    return found


def _refers(program: Program, function: Function | None, node: ast.expr | None, name: str, depth: int = 3) -> bool:
    """Whether an expression is the object of a name of the module or a class, or a part of it."""
    node = root(node) if node is not None else None
    if node is None or not depth or not isinstance(node, ast.Name | ast.Attribute):
        return False
    if name_of(node) == name and not (isinstance(node, ast.Name) and function is not None and name in function.local):
        return True
    if isinstance(node, ast.Name) and (function is None or node.id not in function.local):
        return False
    return any(_refers(program, one, value, name, depth - 1) for value, one in program.values(node, function))


def closures(program: Program) -> Iterator[Suspect]:
    """Find functions that the module makes once, and that change a variable of the function around them."""
    loaded = {
        node.id
        for function in program.play
        for node in function.nodes
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id not in function.local
    }
    for target, value, node in bindings(program.module_nodes):
        if not (isinstance(target, ast.Name) and target.id in loaded and isinstance(value, ast.Call)):
            continue
        maker = program.functions.get(name_of(value))
        for inner in maker.nodes if maker is not None and isinstance(value.func, ast.Name) else ():
            if isinstance(inner, ast.FunctionDef):
                names = {name for one in ast.walk(inner) if isinstance(one, ast.Nonlocal) for name in one.names}
                for one in ast.walk(inner):
                    if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store) and one.id in names:
                        words = f"changes {one.id} of {name_of(value)}(), which line {line(node)} calls once"
                        yield Suspect(line(one), f"{words} for all instances")


def iterators(program: Program) -> Iterator[Suspect]:
    """Find iterators that only the constructor or the module creates, and that play goes on with."""
    taken: dict[tuple[str, str], None] = {}
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Name(id="next"), args=[held, *_]):
                    if field := function.field(held):
                        taken[program.bound_to(function), field] = None
                    elif isinstance(held, ast.Name) and held.id not in function.local:
                        taken["", held.id] = None
    for owner, name in taken:
        if owner:
            values = program.field_values(owner).get(name, [])
            if len(values) == 1 and owner == program.env:
                value, function = values[0]
                built = function.name == "__init__" and function not in program.play
                if built and value is not None and _iterates(program, value, function):
                    words = f"creates self.{name}, which reset() does not create again"
                    yield Suspect(line(value), words)
        elif (value := program.module_values.get(name)) is not None and _iterates(program, value, None):
            yield Suspect(line(value), f"creates {name} once for all instances")


def uninitialised(program: Program) -> Iterator[Suspect]:
    """Find arrays of uninitialised memory that no statement fills at once, as a whole."""
    for function in dict.fromkeys([*program.all, *program.reached("render")]):
        for node in function.nodes:
            if isinstance(node, ast.Call) and (path := program.path(node.func, function)) in _EMPTY:
                parent = program.parents[node]
                target = parent.targets[0] if isinstance(parent, ast.Assign) else None
                if target is None or not any(_fills(one, ast.unparse(target)) for one in function.nodes):
                    yield Suspect(line(node), f"creates an array of uninitialised memory: {path}()")


def _object_of(value: ast.expr | None) -> tuple[str, int]:
    """The name whose object a value is, or whose items those of the value are, and how many copies that takes."""
    match value:
        case ast.Name(id=name):
            return name, 0
        case ast.Call(func=ast.Name(id="list" | "dict"), args=[ast.Name(id=name)], keywords=[]):
            return name, 1
        case ast.Call(func=ast.Attribute(attr="copy", value=ast.Name(id=name)), args=[], keywords=[]):
            return name, 1
        case ast.Subscript(value=ast.Name(id=name), slice=ast.Slice(lower=None, upper=None, step=None)):
            return name, 1
    return "", 0


def _is_container(program: Program, name: str) -> bool:
    return isinstance(program.module_values.get(name), ast.List | ast.Dict | ast.ListComp | ast.DictComp)


def _depth(function: Function, node: ast.AST, field: str) -> int:
    """How many subscripts lead from an attribute to what a node writes; 0 if it does not write to it."""
    if not (isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store | ast.Del)):
        return 0
    depth, inner = 1, node.value
    while isinstance(inner, ast.Subscript):
        depth, inner = depth + 1, inner.value
    return depth if function.field(inner) == field else 0


def _iterates(program: Program, value: ast.expr, function: Function | None) -> bool:
    """Whether an expression makes an iterator."""
    if isinstance(value, ast.GeneratorExp):
        return True
    if not isinstance(value, ast.Call):
        return False
    if program.path(value.func, function) in _ITERATORS:
        return True
    called = program.functions.get(name_of(value)) if function is None else program.called(value, function)
    return called is not None and any(isinstance(one, ast.Yield | ast.YieldFrom) for one in called.nodes)


def _fills(node: ast.AST, name: str) -> bool:
    """Whether a node is ``name[:] = ...``, ``name[...] = ...`` or ``name.fill(...)``."""
    match node:
        case ast.Assign(targets=[ast.Subscript(value=filled, slice=ast.Slice(None, None, None))]):
            return ast.unparse(filled) == name
        case ast.Assign(targets=[ast.Subscript(value=filled, slice=ast.Constant(value=value))]):
            return ast.unparse(filled) == name and value is ...
        case ast.Call(func=ast.Attribute(attr="fill", value=filled), args=[_]):
            return ast.unparse(filled) == name
    return False
