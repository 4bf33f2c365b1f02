"""What play does outside the environment, and exceptions that it hides."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator

from .program import Function, Program, Suspect, line

_MODULES = (
    "asyncio.",
    "concurrent.futures.",
    "ftplib.",
    "http.client.",
    "multiprocessing.",
    "requests.",
    "shutil.",
    "socket.",
    "subprocess.",
    "tempfile.",
    "urllib.request.",
)
_OPENS = frozenset({"builtins.open", "io.open"})
#: Calls that make a file or a folder, or may write to one.
_WRITES = _OPENS | {
    "numpy.save", "numpy.savetxt", "numpy.savez", "os.makedirs", "os.mkdir", "os.open", "pygame.image.save",
}  # fmt: skip
_CALLS = _WRITES | {
    "numpy.fromfile", "numpy.load", "numpy.loadtxt", "os.execv", "os.fork", "os.kill", "os.popen", "os.remove",
    "os.rename", "os.rmdir", "os.spawnv", "os.system", "os.unlink", "threading.Thread", "threading.Timer",
}  # fmt: skip


def effects(program: Program) -> Iterator[Suspect]:
    """Find calls that open files or sockets, or start threads or processes."""
    for node, path in _calls(program, program.all):
        yield Suspect(line(node), f"reaches outside the environment: {path.removeprefix('builtins.')}()")


def effect_lines(program: Program, method: str, files: bool) -> list[int]:
    """The lines that reach outside the environment, in order.

    Args:
        program: the file.
        method: ``reset`` or ``step``. If it reaches no such line, those of the whole file count, such as an ``open()``
            in the constructor.
        files: whether only calls that may write a file count.

    Returns:
        The lines.
    """
    for functions in (program.reached(method), program.all):
        calls = _calls(program, functions)
        if found := {line(node) for node, path in calls if not files or _may_write(node, path)}:
            return sorted(found)
    return []


def _calls(program: Program, functions: Iterable[Function]) -> Iterator[tuple[ast.Call, str]]:
    """The calls of some functions that reach outside the environment, and what they call."""
    for function in functions:
        for node in function.nodes:
            if isinstance(node, ast.Call):
                path = program.path(node.func, function)
                if path in _CALLS or path.startswith(_MODULES):
                    yield node, path


def _may_write(node: ast.Call, path: str) -> bool:
    if path not in _OPENS:
        return path in _WRITES or path.startswith(("shutil.", "tempfile."))
    given = [*node.args[1:2], *(keyword.value for keyword in node.keywords if keyword.arg == "mode")]
    mode = given[0] if given else ast.Constant("r")
    return not isinstance(mode, ast.Constant) or not {*"wax+"}.isdisjoint(str(mode.value))


def swallowed(program: Program) -> Iterator[Suspect]:
    """Find handlers of every exception that do nothing."""
    for function in program.play:
        for node in function.nodes:
            if isinstance(node, ast.ExceptHandler) and _broad(node.type) and all(_idle(one) for one in node.body):
                yield Suspect(line(node), "catches every exception and ignores it")


def _broad(kind: ast.expr | None) -> bool:
    return kind is None or (isinstance(kind, ast.Name) and kind.id in ("Exception", "BaseException"))


def _idle(statement: ast.stmt) -> bool:
    constant = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
    return constant or isinstance(statement, ast.Pass | ast.Continue)
