"""The lines that print, seed, wait or end the process, while a file is imported and its environment played."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Sequence

from .generators import draws
from .program import Function, Program, line, name_of, outside

#: What may wait, or go on, for ever, and methods that do.
_ENDLESS = frozenset({
    "builtins.input", "itertools.count", "itertools.cycle", "itertools.repeat", "select.select", "signal.pause",
    "time.sleep",
})  # fmt: skip
_WAITING = ("acquire", "wait")
#: Methods that write.
_WRITING = ("write", "writelines")
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


def writing_line(program: Program, stack: Sequence[int]) -> int | None:
    """The innermost line of a stack, if it writes: a process may already have gone on when it is asked."""
    calls = _calls(program, stack[0]) if stack else []
    return (
        stack[0]
        if any(program.path(call.func) == "builtins.print" or _name(call) in _WRITING for call in calls)
        else None
    )


def waiting_line(program: Program, stack: Sequence[int]) -> int | None:
    """The line at which a stack, the innermost line first, does not end.

    It is that of a call that is known to wait, else that of the ``while`` that the stack is in. A ``for`` ends some
    time, so a call in it comes before it. Of loops, an inner one comes before those around it.
    """
    calls = _calls(program, stack[0]) if stack else []
    if not stack or any(program.path(call.func) in _ENDLESS or _name(call) in _WAITING for call in calls):
        return stack[0] if stack else None
    loops = [node for node in program.nodes if isinstance(node, ast.While | ast.For)]
    for endless in (True, False):
        for at in stack:
            around = [
                loop.lineno
                for loop in loops
                if loop.lineno <= at <= (loop.end_lineno or 0) and (_is_endless(program, loop) or not endless)
            ]
            if around:
                return max(around)
        if calls:
            break
    return stack[0]


def exiting_line(program: Program, code: Iterable[_Place]) -> int | None:
    """The line of the only call that ends the process; None where there is none, or are several."""
    return _only(
        node for node, function in code if isinstance(node, ast.Call) and program.path(node.func, function) in _EXITS
    )


#: What makes a thread or a process, by the last part of its name.
_STARTS = frozenset({"Thread", "Timer", "ThreadPoolExecutor", "start_new_thread", "Popen", "run", "Process", "Pool"})


def starting_line(program: Program, code: Iterable[_Place]) -> int | None:
    """The line of the only call that makes a thread or a process; None where there is none, or are several."""
    modules = ("threading", "_thread", "subprocess", "multiprocessing", "concurrent")
    return _only(
        node
        for node, function in code
        if isinstance(node, ast.Call)
        and program.path(node.func, function).partition(".")[0] in modules
        and name_of(node) in _STARTS
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


def _calls(program: Program, at: int) -> list[ast.Call]:
    return [
        node for node in program.nodes if isinstance(node, ast.Call) and node.lineno <= at <= (node.end_lineno or 0)
    ]


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else ""


def _is_endless(program: Program, loop: ast.While | ast.For) -> bool:
    """Whether a loop may go on for ever."""
    if isinstance(loop, ast.While):
        return True
    return isinstance(loop.iter, ast.Call) and program.path(loop.iter.func) in _ENDLESS


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
