"""The line that prints while a file is imported and its environment constructed."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, line, name_of, outside


def printing_line(program: Program, printed: str) -> int | None:
    """The line that prints a text while the file loads; None where several may, or none does.

    Args:
        program: the file.
        printed: the first line of the output.
    """
    lines = {line(call) for call in _prints(program) if _may_print(call, printed)}
    return lines.pop() if len(lines) == 1 else None


def _prints(program: Program) -> Iterator[ast.Call]:
    """The calls of print() that may run: of the module, of its classes' bodies, and of what these and the constructor
    call.
    """
    body = [one for one in program.tree.body if not (isinstance(one, ast.If) and "__name__" in ast.unparse(one.test))]
    loaded = [node for part in (body, *(one.body for one in program.classes.values())) for node in outside(part)]
    found: dict[Function, None] = dict.fromkeys(program.reached("__init__"))
    waiting = list(loaded)
    while waiting:
        node = waiting.pop()
        function = program.functions.get(name_of(node)) if isinstance(node, ast.Call) else None
        if function is not None and function not in found:
            found[function] = None
            waiting += function.nodes
    for node, function in [*((node, None) for node in loaded), *((node, one) for one in found for node in one.nodes)]:
        if isinstance(node, ast.Call) and program.path(node.func, function) == "builtins.print":
            yield node


def _may_print(call: ast.Call, printed: str) -> bool:
    """Whether the text that a call begins with, as far as the file shows it, is how the output begins."""
    if not call.args:
        return False
    match call.args[0]:
        case ast.Constant(value=value):
            known = str(value)
        case ast.JoinedStr(values=[ast.Constant(value=str() as known), *_]):
            pass
        case _:
            return True
    return printed.startswith(known.strip().split("\n")[0])
