"""State of the game that drawing changes: what step() decides by, and the random numbers that it draws next."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

_COMPUTED = (ast.BinOp, ast.UnaryOp, ast.IfExp)


def drawn_changes(program: Program) -> Iterator[Suspect]:
    """Find attributes that render() computes from their last value, and by which step() decides without drawing."""
    drawing = program.reached("render")
    play = [function for function in program.reached("step") if function not in drawing]
    read = {
        field: node
        for function in play
        for node in function.nodes
        if isinstance(node, ast.If | ast.IfExp | ast.While | ast.Compare | ast.BinOp)
        for part in _deciding(node)
        if (field := function.field(part))
    }
    for function in drawing:
        for node in function.nodes:
            if (field := _advanced(node, function)) in read:
                yield Suspect(line(node), f"changes self.{field} while it draws, and line {line(read[field])} reads it")


def drawn_numbers(program: Program) -> Iterator[Suspect]:
    """Find random numbers that render() draws from the generator of the game, where step() needs the next ones."""
    drawing, stepping = program.reached("render"), program.reached("step")
    # A picture before the first episode may call reset().
    if not any(map(_draws, stepping)) or any(function.name == "reset" for function in drawing):
        return
    # What drawing sets and tests is drawn once, or once a step.
    kept = {function.field(target) for function in drawing for target, _, _ in function.bindings} - {""}
    tests = [node.test for function in drawing for node in function.nodes if isinstance(node, ast.If | ast.IfExp)]
    if any(isinstance(part, ast.Attribute) and part.attr in kept for test in tests for part in ast.walk(test)):
        return
    for function in drawing:
        texts = {node.attr for node in function.nodes if isinstance(node, ast.Attribute)}
        for node in _draws(function) if "bit_generator" not in texts else ():
            words = f"draws from self.np_random while it draws the picture: {ast.unparse(node)[:60]}"
            yield Suspect(line(node), words)


def _draws(function: Function) -> list[ast.Call]:
    """The calls of a function that draw from ``self.np_random``, under its own name or another one."""
    names = {
        target.id
        for target, value, _ in function.bindings
        if isinstance(target, ast.Name) and function.field(value) == "np_random"
    }
    return [
        node
        for node in function.nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and (function.field(node.func.value) == "np_random" or name_of(node.func.value) in names)
    ]


def _deciding(node: ast.If | ast.IfExp | ast.While | ast.Compare | ast.BinOp) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(left=left, comparators=others):
            yield from (left, *others)
        case ast.BinOp(left=left, right=right):
            yield from (left, right)
        case _:
            yield node.test


def _advanced(node: ast.AST, function: Function) -> str:
    """The attribute that a statement computes from its last value, "" if there is none."""
    match node:
        case ast.AugAssign(target=target):
            return function.field(target)
        case ast.Assign(targets=[target], value=value) if isinstance(value, _COMPUTED):
            field = function.field(target)
            return field if any(function.field(part) == field for part in ast.walk(value)) else ""
    return ""
