"""Attributes that step() changes and reset() leaves as they are, so that they outlive the episode."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import MUTATORS, Function, Program, Suspect, line, name_of
from .renewal import renewed
from .sharing import is_bookkeeping, only_remembers
from .usage import Usage


def leftovers(program: Program) -> Iterator[Suspect]:
    """Find sums and containers that only grow from episode to episode, and flags that nothing takes back."""
    own = [function for function in program.play if program.bound_to(function) == program.env]
    reset = program.method(program.env, "reset")
    # A reset() without a seed may go on from episode to episode by design.
    if reset is None or "seed" not in reset.parameters:
        return
    resetting = program.reached("reset")
    if program.has_unknown_base(program.env):
        # The base may call what only this class defines.
        stepping = program.reached("step", "__init__")
        resetting += [one for one in program.methods(program.env) if one not in resetting and one not in stepping]
    if any(by_name(node) for one in own for node in one.nodes) or any(map(_reads_by_name, resetting)):
        return
    changed = renewed(program, resetting)
    used = used_fields(program, own) | _successes(own)
    yield from _growing(program, own, resetting, changed, used)
    yield from _latches(program, own, resetting, changed, used)
    yield from _timers(program, own, resetting, changed, used)


def kept(program: Program) -> Iterator[Suspect]:
    """Find what reset() sets only once, or from its old value. A cache does so, too: play shows whether it matters."""
    for field, suspects in _kept(program, program.reached("reset")).items():
        if not is_bookkeeping(field):
            yield from (suspect._replace(certain=False) for suspect in suspects)


def _kept(program: Program, resetting: list[Function]) -> dict[str, list[Suspect]]:
    """Where these functions assign an attribute but may leave it at its old value, by attribute."""
    found: dict[str, list[Suspect]] = {}
    for function in resetting:
        for target, value, node in function.bindings:
            field = function.field(target)
            if not field or program.bound_to(function) != program.env:
                continue
            if _of_itself(function, field, value):
                how = "from its old value"
            elif only_remembers(program, function, field, node):
                how = "only if it has no value yet"
            else:
                continue
            words = f"sets self.{field} {how}, so that it outlives the episode"
            found.setdefault(field, []).append(Suspect(line(node), words))
    return found


def by_name(node: ast.AST) -> bool:
    """Whether a node may set attributes whose names the code does not show."""
    return name_of(node) in ("__dict__", "setattr", "vars")


def _reads_by_name(function: Function) -> bool:
    """Whether a function reads an attribute whose name the code does not show, and may change its object."""
    for node in function.nodes:
        match node:
            case ast.Call(func=ast.Name(id="getattr"), args=[ast.Name(), name, *_]):
                if not isinstance(name, ast.Constant):
                    return True
    return False


def _growing(
    program: Program, own: list[Function], resetting: list[Function], changed: set[str], used: set[str]
) -> Iterator[Suspect]:
    anew = changed | {
        field
        for one in dict.fromkeys([*own, *resetting])
        for target, value, node in one.bindings
        if (field := one.field(target)) and not _of_itself(one, field, value)
        if not only_remembers(program, one, field, node)
    }
    anew |= {one.field(target) for one in own for target, node in one.writes if name_of(node) in ("clear", "fill")}
    keeping = _kept(program, resetting)
    for function in own:
        again = [
            (target, node)
            for target, value, node in function.bindings
            if _of_itself(function, function.field(target), value)
        ]
        for target, node in [*function.writes, *again]:
            field = function.field(target)
            values = program.field_values(program.env).get(field, ())
            # A deque of fixed length may be filled again.
            limited = any(isinstance(value, ast.Call) and name_of(value) == "deque" for value, _ in values)
            if not values or limited or field in anew or field not in used or is_bookkeeping(field):
                continue
            if not only_remembers(program, function, field, node):
                words = f"changes self.{field}, which reset() never sets, so that it outlives the episode"
                yield from keeping.get(field) or [Suspect(line(node), words)]


def _of_itself(function: Function, field: str, value: ast.AST | None) -> bool:
    """Whether a value is made of the attribute that it is assigned to."""
    for node in ast.walk(value) if value is not None else ():
        match node:
            case ast.Call(func=ast.Name(id="getattr"), args=[_, ast.Constant(value=str(name)), *_]) if name == field:
                return True
            case ast.Attribute() if function.field(node) == field != "":
                return True
    return False


def _latches(
    program: Program, own: list[Function], resetting: list[Function], changed: set[str], used: set[str]
) -> Iterator[Suspect]:
    for field, values in program.field_values(program.env).items():
        during = [(value, one) for value, one in values if one in own]
        constants = [value.value for value, _ in values if isinstance(value, ast.Constant)]
        latched = {value.value for value, _ in during if isinstance(value, ast.Constant)}
        # A number that counts down, or is set before it is read, does no harm for long.
        if len(constants) < len(values) or {*map(repr, constants)} != {"True", "False"} or len(latched) != 1:
            continue
        if field not in used or field in changed or is_bookkeeping(field) or any(one in resetting for _, one in during):
            continue
        for function in dict.fromkeys(one for _, one in during):
            for target, _, node in function.bindings:
                # What every step sets says nothing about the last episode.
                sometimes = isinstance(program.parents[node], ast.If)
                if function.field(target) == field and sometimes and not only_remembers(program, function, field, node):
                    words = f"sets self.{field}, which reset() never resets, so that it outlives the episode"
                    yield Suspect(line(node), words)


def _timers(
    program: Program, own: list[Function], resetting: list[Function], changed: set[str], used: set[str]
) -> Iterator[Suspect]:
    """Find numbers that an event sets, that each step counts down, and that the next episode finds where they are."""
    for field, values in program.field_values(program.env).items():
        if field not in used or field in changed or is_bookkeeping(field) or any(one in resetting for _, one in values):
            continue
        before = [value for value, one in values if one not in own]
        if len(before) != 1 or not _is_number(before[0], 0):
            continue
        events = [
            (function, node)
            for function in own
            for target, value, node in function.bindings
            if function.field(target) == field and not _of_itself(function, field, value)
        ]
        # What a method always sets may be set before it is read.
        sometimes = all(isinstance(program.parents[node], ast.If) for _, node in events)
        if sometimes and any(
            _counts_down(program, function, node, field) for function in own for node in function.nodes
        ):
            for function, node in events:
                zero = isinstance(node, ast.Assign) and _is_number(node.value, 0)
                if not zero and not only_remembers(program, function, field, node):
                    words = f"starts self.{field}, which reset() never resets, so that it outlives the episode"
                    yield Suspect(line(node), words)


def _is_number(node: ast.AST | None, number: int) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value == number


def _counts_down(program: Program, function: Function, node: ast.AST, field: str) -> bool:
    """Whether a statement is ``self.timer -= 1`` or ``self.timer = max(0, self.timer - 1)``, and no other attribute
    decides whether it runs: a timer of one state is set before that state reads it.
    """
    match node:
        case ast.AugAssign(target=target, op=ast.Sub(), value=ast.Constant()):
            counts = function.field(target) == field
        case ast.Assign(targets=[target], value=value) if function.field(target) == field:
            parts = value.args if isinstance(value, ast.Call) and name_of(value) == "max" else [value]
            counts = any(
                isinstance(one, ast.BinOp) and isinstance(one.op, ast.Sub) and function.field(one.left) == field
                for one in parts
            )
        case _:
            return False
    return counts and all(
        isinstance(each, ast.If)
        and {function.field(one) or name_of(one) for one in ast.walk(each.test)} <= {field, function.me, ""}
        for each in program.around(node, function)
    )


def used_fields(program: Program, own: list[Function]) -> set[str]:
    """The attributes that these functions read for more than changing them, logging them, or telling them in info."""
    found = set()
    usage = Usage(program, told=False)
    for function in own:
        for node in function.nodes if "info" not in function.name else ():
            field = function.field(node)
            if not field or field in found or not isinstance(getattr(node, "ctx", None), ast.Load):
                continue
            parent = program.parents[node]
            receiver = isinstance(parent, ast.Attribute) and parent.attr in MUTATORS
            stored = isinstance(parent, ast.Subscript) and isinstance(parent.ctx, ast.Store)
            turns = isinstance(parent, ast.BinOp) and _selects_buffer(program, function, parent)
            turns = turns or _picks_canvas(program, function, node)
            told = receiver or stored or turns or isinstance(parent, ast.Dict)
            if not told and not _only_updates(program, function, node) and usage.is_used(node, function):
                found.add(field)
    return found


def _successes(own: list[Function]) -> set[str]:
    """The attributes that ``info["is_success"]`` tells as they are."""
    found = set()
    for function in own:
        for node in function.nodes:
            pairs: list[tuple[ast.expr | None, ast.expr]] = []
            match node:
                case ast.Dict(keys=keys, values=values):
                    pairs = [*zip(keys, values, strict=True)]
                case ast.Assign(targets=[ast.Subscript(slice=place)], value=told):
                    pairs = [(place, told)]
            for key, value in pairs:
                if isinstance(key, ast.Constant) and key.value == "is_success":
                    inner = value.args[0] if isinstance(value, ast.Call) and len(value.args) == 1 else value
                    found.add(function.field(inner))
    return found - {""}


def _selects_buffer(program: Program, function: Function, node: ast.BinOp) -> bool:
    """Whether a remainder only says which of the environment's buffers takes its turn."""
    parent = program.parents[node]
    return isinstance(node.op, ast.Mod) and isinstance(parent, ast.Subscript) and bool(function.field(parent.value))


def _picks_canvas(program: Program, function: Function, node: ast.AST) -> bool:
    """Whether a number only picks an array that the method fills anew before it draws on it."""
    picked = program.parents[node]
    if not (isinstance(picked, ast.Subscript) and picked.slice is node and function.field(picked.value)):
        return False
    match program.parents[picked]:
        case ast.Assign(targets=[ast.Name(id=canvas)]):
            return any(_fills(one, canvas) for one in function.nodes)
    return False


def _fills(node: ast.AST, name: str) -> bool:
    """Whether a node is ``name[:] = ...``, ``name[...] = ...`` or ``name.fill(...)``."""
    match node:
        case ast.Assign(targets=[ast.Subscript(value=ast.Name(id=filled), slice=ast.Slice(None, None, None))]):
            return filled == name
        case ast.Assign(targets=[ast.Subscript(value=ast.Name(id=filled), slice=ast.Constant(value=value))]):
            return filled == name and value is ...
        case ast.Call(func=ast.Attribute(attr="fill", value=ast.Name(id=filled)), args=[_]):
            return filled == name
    return False


def _only_updates(program: Program, function: Function, node: ast.AST) -> bool:
    """Whether a value only serves to calculate itself anew, as a record does, also in the test before that."""
    field = function.field(node)
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
    statements = node.body if isinstance(node, ast.If) and not node.orelse else [node]
    return all(
        isinstance(one, ast.Assign) and all(function.field(target) == field for target in one.targets)
        for one in statements
    )
