"""A part of the action that two names hold, while nothing reads another part."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .actions import Actions
from .program import Function, Program, Suspect, line, name_of

#: Calls that do not read the parts of an action.
_CHECKS = frozenset({"contains", "isinstance", "len", "print", "type"})
#: Words of names that keep a part for the next step.
_KEPT = frozenset({"before", "last", "old", "prev", "previous", "was"})


def parts_read_twice(program: Program) -> Iterator[Suspect]:
    """Find two names for one part of the action, if another part is never read."""
    twins = [(function, *pair) for function in program.reached("step") for pair in _twins(program, function)]
    actions = Actions(program) if twins else None
    if actions is None or not actions.known or not actions.parts:
        return
    reads: dict[ast.AST, int] = {}
    for function in program.reached("step"):
        for node in function.nodes:
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and actions.is_whole(node, function):
                found = _reads(program, actions, node, function)
                if found is None:
                    return
                reads.update(found)
    unread = sorted(set(range(actions.parts)) - set(reads.values()))
    for _, first, second, value in twins if unread else ():
        if _only(value, reads):
            words = (
                f"gives {second.id} the same {ast.unparse(value)[:40]} as line {line(first)} gives {first.id}, while "
                f"nothing reads part{'s' * (len(unread) > 1)} {', '.join(map(str, unread))} of the action"
            )
            # One read for each part: the code means to read all of them.
            yield Suspect(line(second), words, len(reads) == actions.parts)


def _reads(program: Program, actions: Actions, node: ast.expr, function: Function) -> dict[ast.AST, int] | None:
    """The parts that are read where the code names an action; None if it may read any."""
    while True:
        parent = program.parents[node]
        call = program.parents[parent] if isinstance(parent, ast.Attribute) else parent
        # np.asarray(action) and action.copy() are the action, too.
        if not isinstance(call, ast.Call) or not actions.is_whole(call, function):
            break
        node = call
    match parent:
        case ast.Subscript(slice=index, value=value) if value is node:
            place = actions.place(index, function)
            return None if place is None or not isinstance(parent.ctx, ast.Load) else {parent: place}
        case ast.Assign(targets=[ast.Name() as target]) if actions.is_whole(target, function):
            return {}
        case ast.Call() if name_of(parent) in _CHECKS:
            return {}
        case ast.Call(args=args) if node in args and (called := program.called(parent, function)) is not None:
            place = args.index(node) + bool(called.me)
            taken = [one.arg for one in [*called.node.args.posonlyargs, *called.node.args.args]]
            named = ast.Name(taken[place], ast.Load()) if place < len(taken) else None
            return {} if named is not None and actions.is_whole(named, called) else None
        case ast.Compare(ops=[ast.Is() | ast.IsNot()]):
            return {}
    return None


def _twins(program: Program, function: Function) -> Iterator[tuple[ast.Name, ast.Name, ast.expr]]:
    """Pairs of names that one block binds to an item in the same way."""
    seen: dict[tuple[ast.AST, bool, str], ast.Name] = {}
    for target, value, statement in function.bindings:
        if (
            not isinstance(target, ast.Name)
            or value is None
            or not any(isinstance(one, ast.Subscript) for one in ast.walk(value))
        ):
            continue
        block = program.parents[statement]
        key = block, statement in getattr(block, "orelse", ()), ast.unparse(value)
        kept = not _KEPT.isdisjoint(target.id.lower().split("_"))
        if not kept and (first := seen.setdefault(key, target)).id != target.id:
            yield first, target, value


def _only(value: ast.expr, reads: dict[ast.AST, int]) -> bool:
    """Whether an expression depends on one part of the action, and on nothing else."""
    parts = [one for one in ast.walk(value) if one in reads]
    named = {one for one in ast.walk(value) if isinstance(one, ast.Attribute | ast.Name)}
    own = {one for part in parts for one in ast.walk(part)}
    return len(parts) == 1 and all(isinstance(one, ast.Name) and one.id in ("bool", "int") for one in named - own)
