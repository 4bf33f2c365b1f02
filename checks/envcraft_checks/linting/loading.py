"""The lines that print, seed, end the process or may never end, while a file is imported and its environment played."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from .generators import draws
from .program import Function, Program, line, outside

#: What may wait, or go on, for ever.
_ENDLESS = frozenset({
    "builtins.input", "itertools.count", "itertools.cycle", "itertools.repeat", "select.select", "signal.pause",
    "time.sleep",
})  # fmt: skip
_SEEDS = frozenset({"random.seed", "random.setstate", "numpy.random.seed", "numpy.random.set_state"})
#: What ends the process without an exception.
_EXITS = frozenset({"os._exit", "os.abort", "os.kill", "signal.raise_signal"})
#: A node, and the function that it is in.
_Place = tuple[ast.AST, Function | None]


def printing_line(program: Program, code: Iterable[_Place], output: str) -> int | None:
    """The line that prints the first line of an output; None where several may, or none does."""
    printed = output.strip().split("\n")[0]
    return _only(
        node
        for node, function in code
        if isinstance(node, ast.Call)
        and program.path(node.func, function) == "builtins.print"
        and _may_print(node, printed)
    )


def seeding_line(program: Program) -> int | None:
    """The first line of the import that seeds a global generator or draws from one, if the file has one."""
    called = ((node, program.path(node.func, one)) for node, one in import_code(program) if isinstance(node, ast.Call))
    return min((line(node) for node, path in called if path in _SEEDS or _draws(path)), default=None)


def endless_line(program: Program, code: Iterable[_Place]) -> int | None:
    """The line of the only loop or call that may never end; None where there is none, or are several."""
    return _only(
        node
        for node, function in code
        if isinstance(node, ast.While) or (isinstance(node, ast.Call) and program.path(node.func, function) in _ENDLESS)
    )


def exiting_line(program: Program, code: Iterable[_Place]) -> int | None:
    """The line of the only call that ends the process; None where there is none, or are several."""
    return _only(
        node for node, function in code if isinstance(node, ast.Call) and program.path(node.func, function) in _EXITS
    )


def import_code(program: Program) -> Iterator[_Place]:
    """What an import runs: the module, the bodies of its classes, and the functions that these call."""
    body = [one for one in program.tree.body if not (isinstance(one, ast.If) and "__name__" in ast.unparse(one.test))]
    waiting: list[_Place] = [
        (node, None) for part in (body, *(one.body for one in program.classes.values())) for node in outside(part)
    ]
    called: set[Function] = set()
    for node, function in waiting:
        yield node, function
        name = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
        if (found := program.functions.get(name)) is not None and found not in called:
            called.add(found)
            waiting += ((one, found) for one in found.nodes)


def method_code(program: Program, *methods: str) -> Iterator[_Place]:
    """What some methods of the environment may run."""
    return ((node, function) for function in program.reached(*methods) for node in function.nodes)


def _only(nodes: Iterable[ast.AST]) -> int | None:
    lines = {line(node) for node in nodes}
    return lines.pop() if len(lines) == 1 else None


def _draws(path: str) -> bool:
    module, _, name = path.rpartition(".")
    return module in ("random", "numpy.random") and name.islower() and draws(path)


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
