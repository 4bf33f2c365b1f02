"""What play does outside the environment, and exceptions that it hides."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Program, Suspect, line

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
_CALLS = frozenset({
    "builtins.open", "io.open", "numpy.fromfile", "numpy.load", "numpy.loadtxt", "numpy.save", "numpy.savetxt",
    "numpy.savez", "os.execv", "os.fork", "os.kill", "os.makedirs", "os.mkdir", "os.open", "os.popen", "os.remove",
    "os.rename", "os.rmdir", "os.spawnv", "os.system", "os.unlink", "pygame.image.save", "threading.Thread",
    "threading.Timer",
})  # fmt: skip


def effects(program: Program) -> Iterator[Suspect]:
    """Find calls that open files or sockets, or start threads or processes."""
    for function in program.all:
        for node in function.nodes:
            if isinstance(node, ast.Call):
                path = program.path(node.func, function)
                if path in _CALLS or path.startswith(_MODULES):
                    yield Suspect(line(node), f"reaches outside the environment: {path.removeprefix('builtins.')}()")


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
