"""Results of step() in the wrong place, or of the wrong type, as the text shows it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of
from .reported import reported_at

_TERMINATED, _TRUNCATED, _INFO, _RESULTS = 2, 3, 4, 5
_DEPTH = 4
_NO_DICTS = {"list": "a list", "tuple": "a tuple", "str": "a str", "sorted": "a list", "set": "a set"}


def wrong_results(program: Program) -> Iterator[Suspect]:
    """Find flags that step() returns in each other's place, an info that is no dict, and one that lacks success."""
    step = program.method(program.env, "step")
    if step is None:
        return
    yield from _unreported(program, step)
    yield from misplaced_flags(program)
    for _, results in _results(step):
        for part, words in _no_dicts(program, results[_INFO], step, _DEPTH):
            yield Suspect(line(part), f"returns {words} as info")


def misplaced_flags(program: Program) -> Iterator[Suspect]:
    """Find flags that step() returns in each other's place, by their names."""
    step = program.method(program.env, "step")
    if step is None:
        return
    for node, results in _results(step):
        terminated, truncated = results[_TERMINATED], results[_TRUNCATED]
        if (name_of(terminated), name_of(truncated)) == ("truncated", "terminated"):
            yield Suspect(line(node), "returns truncated and terminated in the wrong order")
        elif _is_false(truncated) and _includes(program, terminated, step, "truncated"):
            yield Suspect(line(node), "returns truncated as terminated, and False as truncated")
        elif _is_false(terminated) and _includes(program, truncated, step, "terminated"):
            yield Suspect(line(node), "returns terminated as truncated, and False as terminated")


def _results(step: Function) -> Iterator[tuple[ast.Return, list[ast.expr]]]:
    """The statements that return five results, and these."""
    for node in step.nodes:
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == _RESULTS:
            yield node, node.value.elts


def _is_false(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is False


def _includes(program: Program, node: ast.expr, step: Function, flag: str) -> bool:
    """Whether a flag of this name alone makes an expression true, through one name and ``bool``."""
    match node:
        case ast.Call(func=ast.Name(id="bool"), args=[inner]):
            return _includes(program, inner, step, flag)
        case ast.Name() | ast.Attribute() if name_of(node) != flag:
            bound = [value for target, value, _ in step.bindings if ast.unparse(target) == ast.unparse(node)]
            return len(bound) == 1 and isinstance(bound[0], ast.BoolOp) and _includes(program, bound[0], step, flag)
    parts = node.values if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or) else [node]
    named = next((part for part in parts if name_of(part) == flag), None)
    values = [value for value, _ in program.values(named, step)] if named is not None else []
    return any(value is None or not isinstance(value, ast.Constant) or value.value for value in values)


def _unreported(program: Program, step: Function) -> Iterator[Suspect]:
    """The ends whose info has no key for success, where others have one."""
    shown = {end: reported_at(program, step, end) for end in step.nodes if isinstance(end, ast.Return)}
    key, there = next(((keys[0], end) for end, keys in shown.items() if keys), ("", None))
    for end, keys in shown.items():
        if there is not None and keys == [] and _ends(end):
            yield Suspect(line(end), f"returns info without {key!r}, which the info of line {line(there)} has")


def _ends(end: ast.Return) -> bool:
    """Whether a return statement ends the episode, and is not like one for calls after the end, which pays nothing.

    Only the end of an episode needs to report success.
    """
    match end.value:
        case ast.Tuple(elts=[_, ast.Constant(value=reward), *_]) if not reward:
            return False
        case ast.Tuple(elts=[*_, terminated, truncated, _]):
            flags = (terminated, truncated)
            return any(isinstance(each, ast.Constant) and each.value is True for each in flags)
    return False


def _no_dicts(program: Program, node: ast.expr, function: Function, depth: int) -> Iterator[tuple[ast.expr, str]]:
    """What an expression may be that is no dict, as far as the text shows it."""
    match node:
        case ast.List() | ast.ListComp():
            yield node, "a list"
        case ast.Tuple():
            yield node, "a tuple"
        case ast.Set() | ast.SetComp():
            yield node, "a set"
        case ast.Constant():
            yield node, repr(node.value)
        case ast.Call(func=ast.Name(id=name)) if name in _NO_DICTS and name not in program.functions:
            yield node, _NO_DICTS[name]
        case ast.IfExp(body=body, orelse=orelse):
            for part in (body, orelse):
                yield from _no_dicts(program, part, function, depth)
        case ast.Call() if depth and (called := program.called(node, function)) is not None:
            for end in called.nodes:
                if isinstance(end, ast.Return) and end.value is not None:
                    yield from _no_dicts(program, end.value, called, depth - 1)
