"""The imports that a file cannot run without, from its syntax tree."""

from __future__ import annotations

import ast
import operator
from collections.abc import Collection

from envcraft.model.target import nodes, walk

#: Methods that Gymnasium's own code calls.
_CALLED = {"reset", "step", "render", "close", "seed", "action", "observation", "reward"}
_ORDERS = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge}


def required_imports(tree: ast.Module, unknown: Collection[str] = (), python: tuple[int, ...] = ()) -> dict[str, int]:
    """Find the top-level modules that the code cannot do without.

    Args:
        tree: the syntax tree of the file.
        unknown: the modules that cannot be imported.
        python: the version of Python that runs the code; empty if it is not known.

    Returns:
        The line of each module's first import.
    """
    found: dict[str, int] = {}
    flags = _flags(tree) | {"find_spec"}
    mentioned: set[str] = set()
    uncalled: dict[str, list[tuple[ast.AST, bool]]] = {}
    pending: list[tuple[ast.AST, bool]] = [(tree, True)]
    while pending:
        node, required = pending.pop()
        optional: list[ast.AST] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not _is_called(node, mentioned):
            uncalled.setdefault(node.name, []).append((node, required))
            parts: list[ast.AST] = [node.args]
        elif isinstance(node, ast.Try) and any(_catches(handler.type) for handler in node.handlers):
            lacking = any(
                name in unknown for part in node.body for one in ast.walk(part) for name in imported_modules(one)
            )
            parts = [*(node.handlers if lacking else node.orelse), *node.finalbody]
            optional = [*node.body, *(node.orelse if lacking else node.handlers)]
        elif isinstance(node, ast.With) and any(_suppresses(item.context_expr) for item in node.items):
            parts, optional = [*node.items], [*node.body]
        elif isinstance(node, ast.If) and _names(node.test) & {"TYPE_CHECKING", "__name__"}:
            parts = [*node.orelse]
        elif isinstance(node, ast.If) and "version_info" in _names(node.test):
            runs = _holds(node.test, python)
            parts = [] if runs is None else [*(node.body if runs else node.orelse)]
            optional = [*node.body, *node.orelse] if runs is None else []
        elif isinstance(node, ast.If) and _names(node.test) & flags:
            parts, optional = [node.test], [*node.body, *node.orelse]
        else:
            parts = [*ast.iter_child_nodes(node)]
            for name in imported_modules(node) if required else []:
                line: int = getattr(node, "lineno", 1)
                found[name] = min(found.get(name, line), line)
        if isinstance(node, ast.Name | ast.Attribute):
            name = node.id if isinstance(node, ast.Name) else node.attr
            mentioned.add(name)
            pending += uncalled.pop(name, [])
        pending += [(part, required) for part in parts] + [(part, False) for part in optional]
    return found


def imported_modules(node: ast.AST) -> list[str]:
    """The top-level modules that a statement imports; a relative import keeps its dots."""
    if isinstance(node, ast.Import):
        return [alias.name.partition(".")[0] for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        module = node.module or ""
        return ["." * node.level + module if node.level else module.partition(".")[0]]
    return []


def _is_called(function: ast.FunctionDef | ast.AsyncFunctionDef, mentioned: set[str]) -> bool:
    """Whether a function may run: other code that runs names it, a decorator receives it, or Gymnasium calls it."""
    name = function.name
    return name in mentioned | _CALLED or name.startswith("__") or bool(function.decorator_list)


def _flags(tree: ast.Module) -> set[str]:
    """The variables that say whether a library is installed: find_spec() results, or set beside a guarded import."""
    assigned: list[ast.Assign] = []
    for node in nodes(tree):
        if isinstance(node, ast.Assign) and "find_spec" in _names(node.value):
            assigned.append(node)
        elif isinstance(node, ast.Try) and any(_catches(handler.type) for handler in node.handlers):
            blocks = [node.body, node.orelse, *(handler.body for handler in node.handlers)]
            lines = (line for block in blocks for line in block)
            assigned += [
                line for line in lines if isinstance(line, ast.Assign) and isinstance(line.value, ast.Constant)
            ]
    return {target.id for statement in assigned for target in statement.targets if isinstance(target, ast.Name)}


def _catches(caught: ast.expr | None) -> bool:
    """Whether an exception handler catches ImportError."""
    if caught is None:
        return True
    return bool(_names(caught) & {"ImportError", "ModuleNotFoundError", "Exception", "BaseException"})


def _suppresses(context: ast.expr) -> bool:
    if not isinstance(context, ast.Call) or "suppress" not in _names(context.func):
        return False
    return any(map(_catches, context.args))


def _holds(test: ast.expr, python: tuple[int, ...]) -> bool | None:
    """Whether a comparison of sys.version_info is true; None if that is not known."""
    if not python or not isinstance(test, ast.Compare) or not isinstance(test.left, ast.Name | ast.Attribute):
        return None
    order = _ORDERS.get(type(test.ops[0]))
    try:
        return None if order is None or test.ops[1:] else order(python, ast.literal_eval(test.comparators[0]))
    except (ValueError, TypeError):
        return None


def _names(expression: ast.expr) -> set[str]:
    every = walk(expression)
    names = {node.id for node in every if isinstance(node, ast.Name)}
    return names | {node.attr for node in every if isinstance(node, ast.Attribute)}
