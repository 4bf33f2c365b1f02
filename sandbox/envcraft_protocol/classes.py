"""Select the environment class of a module, and construct an instance of it."""

from __future__ import annotations

import ast
import functools
import inspect
import linecache
from types import CodeType, ModuleType
from typing import Any

import gymnasium

# Bound before any untrusted module can replace them.
_all, _any = all, any


def concrete_classes(module: ModuleType) -> list[str]:
    """Names of the environment classes that a module defines and that can be instantiated.

    Excluded are abstract bases, wrappers, and private classes if there is a public one. A base is abstract if it has
    abstract methods, or if ``step`` or ``reset`` is missing or only raises; if another class inherits from it, any
    method that only raises makes it abstract.
    """
    found = [
        name
        for name, value in list(vars(module).items())
        if inspect.isclass(value)
        and value.__module__ == module.__name__
        and value.__name__ == name
        and issubclass(value, gymnasium.Env)
        and not issubclass(value, gymnasium.Wrapper)
        and not inspect.isabstract(value)
        and _all(implements(value, method) for method in ("reset", "step"))
    ]
    kinds = [getattr(module, name) for name in found]
    bases = {kind.__name__ for kind in kinds if _is_open(kind) and _any(kind in other.__mro__[1:] for other in kinds)}
    found = [name for name in found if name not in bases]
    return [name for name in found if not name.startswith("_")] or found


def rendering(creator: Any, given: dict[str, Any]) -> dict[str, Any]:
    """``render_mode="rgb_array"`` if the constructor accepts it, the caller gives no other, and the class does not
    exclude it by its metadata.
    """
    if given.get("render_mode") is not None:
        return {}
    try:
        parameters = inspect.signature(creator).parameters
    except (ValueError, TypeError):
        return {}
    metadata = getattr(creator, "metadata", None)
    # The metadata that every environment inherits has no modes and means nothing.
    inherited = metadata is gymnasium.Env.metadata
    modes = metadata.get("render_modes") if isinstance(metadata, dict) and not inherited else None
    takes = "render_mode" in parameters
    passes = inspect.Parameter.VAR_KEYWORD in [parameter.kind for parameter in parameters.values()]
    offers = "rgb_array" in modes if isinstance(modes, list | tuple | set) else takes
    return {"render_mode": "rgb_array"} if (takes or (passes and modes)) and offers else {}


def is_environment(value: Any) -> bool:
    return inspect.isclass(value) and issubclass(value, gymnasium.Env) and value is not gymnasium.Env


def implements(kind: type, method: str) -> bool:
    """Whether a class or a base of it defines a method of environments that does more than raise."""
    function = getattr(kind, method, None)
    if function is None or function is getattr(gymnasium.Env, method):
        return False
    body = _body(function)
    return body is None or not _all(map(_refuses, body))


def _is_open(kind: type) -> bool:
    """Whether a class leaves a method to its subclasses."""
    own = {name for part in kind.__mro__ if part.__module__ == kind.__module__ for name in vars(part)}
    for method in (getattr(kind, name, None) for name in own):
        if getattr(method, "__isabstractmethod__", False) or ((body := _body(method)) and _all(map(_refuses, body))):
            return True
    return False


def _refuses(node: ast.stmt) -> bool:
    return isinstance(node, ast.Raise) and "NotImplementedError" in ast.dump(node)


def _body(function: Any) -> list[ast.stmt] | None:
    """The statements of a function without ``pass`` and its docstring; None if its source is unknown."""
    code = getattr(function, "__code__", None)
    definition = definitions(code.co_filename).get(code.co_firstlineno) if isinstance(code, CodeType) else None
    if not isinstance(definition, ast.FunctionDef):
        return None
    return [
        node
        for node in definition.body
        if not (isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)))
    ]


@functools.cache
def definitions(filename: str) -> dict[int, ast.stmt]:
    """The classes and functions of a file by their first line.

    One parse of the file is much faster than ``inspect``, which takes longer for a single class.
    """
    try:
        tree = ast.parse("".join(linecache.getlines(filename)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return {}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)]
    return {min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)]): node for node in nodes}


def type_name(value: Any) -> str:
    kind = type(value)
    name = kind.__qualname__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__qualname__}"
    return name[:200]
