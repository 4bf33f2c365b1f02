"""The source of a class that was defined in a script, a notebook or an interactive interpreter.

Only the statements that the class needs are kept: its definition, the imports, and the functions and values that it
names, directly or not. They stay in their lines, so that findings name lines of the script.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import linecache
import sys
from collections.abc import Iterator
from types import FunctionType

from envcraft.errors import UsageError
from envcraft.model.target import Target, parse

#: The names of the cells of a notebook in Python's cache of lines.
_CELLS = ("<ipython-input-", "<stdin>-", "<python-input-")


def target_of(kind: type) -> Target:
    """The target that has the source of a class and of what it needs.

    Args:
        kind: a class that is defined at the top level of a module, a script or a notebook.

    Raises:
        UsageError: the source is not known, or lacks a name that the class needs.
    """
    if "<locals>" in kind.__qualname__ or "." in kind.__qualname__:
        raise UsageError(f"{kind.__qualname__} is defined inside a function or a class; define it at the top level")
    file = _file(kind)
    texts = _cells(file) if file.startswith("<") or "ipykernel" in file else ["".join(linecache.getlines(file))]
    if not any(texts):
        raise UsageError(f"the source of {kind.__name__} is not known; save it in a file, and validate the file")
    known = vars(sys.modules.get(kind.__module__, builtins))
    path = f"{kind.__name__} (notebook).py" if file.startswith("<") or "ipykernel" in file else file
    return Target(path, needed("\n".join(texts), kind.__name__, frozenset(known)).encode(), kind.__name__)


def needed(text: str, name: str, known: frozenset[str] = frozenset()) -> str:
    """Keep the statements of a module that a name of it needs, each in its line, and leave other lines empty.

    Args:
        text: the module.
        name: a name that it binds at its top level.
        known: the names that the module has when it runs.

    Returns:
        The module's text with as many lines.

    Raises:
        UsageError: nothing binds the name, or one that it needs.
    """
    try:
        body = parse(text).body
    except SyntaxError as error:
        raise UsageError(f"the source of {name} cannot be parsed: {error.msg} (line {error.lineno})") from None
    binding: dict[str, list[ast.stmt]] = {}
    for node in body:
        for bound in _bound(node):
            # A later definition replaces the earlier one, `x += 1` adds to it.
            binding[bound] = [*(binding.get(bound, []) if isinstance(node, ast.AugAssign) else []), node]
    kept: dict[int, ast.stmt] = {}
    pending = [name]
    seen: set[str] = set()
    while pending:
        wanted = pending.pop()
        if wanted in seen:
            continue
        seen.add(wanted)
        if wanted not in binding:
            if wanted == name:
                raise UsageError(f"its module does not name the class {name}; define it at the top level as {name}")
            if wanted in known and not hasattr(builtins, wanted) and not wanted.startswith("__"):
                raise UsageError(f"{name} needs {wanted}, and no statement of its module binds it; bind it, or pass it")
            continue
        for node in binding[wanted]:
            kept[id(node)] = node
            pending += [each.id for each in ast.walk(node) if isinstance(each, ast.Name)]
    # Annotations are evaluated lazily only as long as this import is there.
    futures = [node for node in body if isinstance(node, ast.ImportFrom) and node.module == "__future__"]
    lines = text.splitlines()
    shown: dict[int, str] = {}
    for node in [*kept.values(), *futures]:
        decorated = [decorator.lineno for decorator in getattr(node, "decorator_list", ())]
        numbers = range(min([node.lineno, *decorated]), (node.end_lineno or node.lineno) + 1)
        fewer = None if node in futures else _import_of(node, seen)
        if fewer is None:
            shown.update((number, lines[number - 1]) for number in numbers)
        else:
            for number in numbers:
                shown.setdefault(number, fewer if number == node.lineno else "")
    return "\n".join(shown.get(number, "") for number in range(1, len(lines) + 1)) + "\n"


def _import_of(node: ast.stmt, names: set[str]) -> str | None:
    """An import statement that imports only some of its names; None for another statement, or if it imports no more."""
    if not isinstance(node, ast.Import | ast.ImportFrom):
        return None
    aliases = [alias for alias in node.names if (alias.asname or alias.name.partition(".")[0]) in names]
    if len(aliases) == len(node.names):
        return None
    fewer = ast.Import(aliases) if isinstance(node, ast.Import) else ast.ImportFrom(node.module, aliases, node.level)
    return ast.unparse(fewer)


def _bound(node: ast.stmt) -> Iterator[str]:
    """The names that a statement at the top level binds."""
    if isinstance(node, ast.If) and "__name__" in ast.dump(node.test):
        return
    if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        yield node.name
    elif isinstance(node, ast.Import | ast.ImportFrom):
        for alias in node.names:
            yield alias.asname or alias.name.partition(".")[0]
    else:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt | ast.excepthandler):
                yield from _bound(child) if isinstance(child, ast.stmt) else _handled(child)
            else:
                names = (each for each in ast.walk(child) if isinstance(each, ast.Name))
                yield from (each.id for each in names if isinstance(each.ctx, ast.Store))


def _handled(node: ast.excepthandler) -> Iterator[str]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield from _bound(child)


def _file(kind: type) -> str:
    """The file, or the cell of a notebook, that defines a class."""
    for value in vars(kind).values():
        function = inspect.unwrap(value) if callable(value) else None
        if isinstance(function, FunctionType) and function.__module__ == kind.__module__:
            return function.__code__.co_filename
    return str(getattr(sys.modules.get(kind.__module__), "__file__", None) or "")


def _cells(file: str) -> list[str]:
    """The cells of a session in the order in which they ran; magic commands are left out."""
    history = getattr(sys.modules.get("__main__"), "In", None)
    if isinstance(history, list):
        texts = [str(cell) for cell in history]
    else:
        named = [name for name in list(linecache.cache) if name.startswith(_CELLS)]
        texts = ["".join(linecache.getlines(name)) for name in named or [file]]
    return [text for text in map(_without_magic, texts) if text.strip()]


def _without_magic(text: str) -> str:
    """A cell without the lines that only IPython understands; "" if it is no Python then."""
    lines = ["" if line.startswith(("%", "!")) else line for line in text.splitlines()]
    text = "\n".join(lines)
    try:
        parse(text)
    except (SyntaxError, ValueError):
        return ""
    return text
