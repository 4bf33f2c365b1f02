"""The line of an environment that writes its reward, read from its syntax tree."""

from __future__ import annotations

import ast

from envcraft.model.target import parse

_NUMBERS = {"float", "int", "round", "float32", "float64"}
_RESULTS = 5
_BINDING = (ast.Assign, ast.AnnAssign, ast.AugAssign, ast.NamedExpr)


def reward_line(text: str, env_class: str | None) -> int | None:
    """Return the line that writes the reward that ``step`` of a class returns.

    A line that writes a zero counts only if no other line writes the reward.

    Args:
        text: the source.
        env_class: the name of the class.

    Returns:
        The line; None if several lines write the reward, or if the tree does not tell.
    """
    try:
        tree = parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == env_class]
    steps = [node for owner in classes for node in owner.body if isinstance(node, ast.FunctionDef)]
    steps = [node for node in steps if node.name == "step"]
    if len(steps) != 1:
        return None
    places: dict[int, bool] = {}
    for node in ast.walk(steps[0]):
        if isinstance(node, ast.Return):
            if not (isinstance(node.value, ast.Tuple) and len(node.value.elts) == _RESULTS):
                return None
            value = _plain(node.value.elts[1])
            found = _bound(value.id, steps[0]) if isinstance(value, ast.Name) else _own(value, classes[0])
            if found is None:
                return None
            places |= found
    lines = [line for line, zero in places.items() if not zero] or list(places)
    return lines[0] if len(lines) == 1 else None


def _own(value: ast.expr, owner: ast.ClassDef) -> dict[int, bool] | None:
    """The lines that write an expression, each with whether it writes a zero. An attribute is written elsewhere."""
    if isinstance(value, ast.Attribute) and isinstance(value.value, ast.Name):
        return _bound(value.attr, owner)
    return {value.lineno: _is_zero(value)}


def _bound(name: str, part: ast.AST) -> dict[int, bool] | None:
    """The lines in a part of a file that bind a name or an attribute; None if something else than a value binds it."""
    places: dict[int, bool] = {}
    written: set[int] = set()
    for node in ast.walk(part):
        if not isinstance(node, _BINDING):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        for each in (each for target in targets for each in ast.walk(target) if _is_named(each, name)):
            written.add(id(each))
            places[node.lineno] = node.value is None or _is_zero(node.value)
    bindings = [
        node for node in ast.walk(part) if _is_named(node, name) and isinstance(getattr(node, "ctx", 0), ast.Store)
    ]
    arguments = [node for node in ast.walk(part) if isinstance(node, ast.arg) and node.arg == name]
    if arguments or any(id(node) not in written for node in bindings):
        return None
    return places or None


def _is_named(node: ast.AST, name: str) -> bool:
    return (isinstance(node, ast.Name) and node.id == name) or (isinstance(node, ast.Attribute) and node.attr == name)


def _is_zero(value: ast.expr) -> bool:
    value = _plain(value)
    return isinstance(value, ast.Constant) and value.value == 0


def _plain(value: ast.expr) -> ast.expr:
    """An expression without the conversion to a number around it."""
    while isinstance(value, ast.Call) and len(value.args) == 1 and not value.keywords:
        func = value.func
        if (func.id if isinstance(func, ast.Name) else getattr(func, "attr", "")) not in _NUMBERS:
            break
        value = value.args[0]
    return value
