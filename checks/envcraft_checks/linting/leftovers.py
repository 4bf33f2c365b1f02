"""Attributes that step() changes and reset() leaves as they are, so that they outlive the episode."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import MUTATORS, Function, Program, Suspect, line, name_of
from .sharing import is_bookkeeping, only_remembers

#: What makes a container larger, and keeps what it held.
_GROWS = frozenset({"add", "append", "appendleft", "extend", "insert", "setdefault"})


def leftovers(program: Program) -> Iterator[Suspect]:
    """Find sums and containers that only grow from episode to episode, and flags that nothing takes back."""
    own = [function for function in program.play if program.bound_to(function) == program.env]
    indirect = any(name_of(node) in ("__dict__", "setattr") for one in own for node in one.nodes)
    if program.method(program.env, "reset") is None or indirect:
        return
    yield from _growing(program, own)
    yield from _latches(program, own)


def _growing(program: Program, own: list[Function]) -> Iterator[Suspect]:
    resetting = program.reached("reset")
    renewed = {one.field(target) for one in own for target, _, _ in one.bindings}
    renewed |= {
        one.field(target)
        for one in resetting
        for target, node in one.writes
        if not isinstance(node, ast.AugAssign) and name_of(node) not in _GROWS
    }
    renewed |= {one.field(target) for one in own for target, node in one.writes if name_of(node) in ("clear", "fill")}
    # A method of the object may set it back, and a deque of fixed length may be filled again.
    renewed |= {
        one.field(node.value)
        for one in resetting
        for node in one.nodes
        if isinstance(node, ast.Attribute) and node.attr not in MUTATORS and one.field(node.value)
    }
    for function in program.reached("step"):
        for target, node in function.writes:
            field = function.field(target)
            values = program.field_values(program.env).get(field, ())
            limited = any(isinstance(value, ast.Call) and name_of(value) == "deque" for value, _ in values)
            if not values or limited or function not in own or field in renewed or is_bookkeeping(field):
                continue
            if any(_uses(program, one, field) for one in own):
                words = f"changes self.{field}, which reset() never sets, so that it outlives the episode"
                yield Suspect(line(node), words)


def _latches(program: Program, own: list[Function]) -> Iterator[Suspect]:
    resetting = program.reached("reset")
    for field, values in program.field_values(program.env).items():
        during = [(value, one) for value, one in values if one in own]
        constants = [value.value for value, _ in values if isinstance(value, ast.Constant)]
        latched = {value.value for value, _ in during if isinstance(value, ast.Constant)}
        # A number that counts down, or is set before it is read, does no harm for long.
        if len(constants) < len(values) or {*map(repr, constants)} != {"True", "False"} or len(latched) != 1:
            continue
        if is_bookkeeping(field) or any(one in resetting for _, one in during):
            continue
        if not any(_uses(program, one, field) for one in own):
            continue
        for function in dict.fromkeys(one for _, one in during):
            for target, _, node in function.bindings:
                # What every step sets says nothing about the last episode.
                sometimes = isinstance(program.parents[node], ast.If)
                if function.field(target) == field and sometimes and not only_remembers(program, function, field, node):
                    words = f"sets self.{field}, which reset() never sets back, so that it outlives the episode"
                    yield Suspect(line(node), words)


def _uses(program: Program, function: Function, field: str) -> bool:
    """Whether a function uses the value of an attribute for more than changing it or telling it in info."""
    if "info" in function.name:
        return False
    for node in function.nodes:
        if function.field(node) == field and isinstance(getattr(node, "ctx", None), ast.Load):
            parent = program.parents[node]
            receiver = isinstance(parent, ast.Attribute) and parent.attr in MUTATORS
            stored = isinstance(parent, ast.Subscript) and isinstance(parent.ctx, ast.Store)
            turns = isinstance(parent, ast.BinOp) and _selects_buffer(program, function, parent)
            if not receiver and not stored and not turns and not isinstance(parent, ast.Dict):
                return True
    return False


def _selects_buffer(program: Program, function: Function, node: ast.BinOp) -> bool:
    """Whether a remainder only says which of the environment's buffers takes its turn."""
    parent = program.parents[node]
    return isinstance(node.op, ast.Mod) and isinstance(parent, ast.Subscript) and bool(function.field(parent.value))
