"""Calls of the file's own functions with arguments that these do not take: the call raises."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator

from .program import Function, Program, Suspect, caught, line, name_of

#: Decorators that leave the parameters as they are.
_TRANSPARENT = frozenset({"abstractmethod", "cache", "classmethod", "lru_cache", "staticmethod"})


def wrong_arguments(program: Program) -> Iterator[Suspect]:
    """Find calls with too many arguments, too few, or a name that is no parameter."""
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
    counts = Counter(node.name for node in program.nodes if isinstance(node, ast.ClassDef))
    stored = {
        node.attr for node in program.nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
    }
    for function in program.reached("reset", "step", "__init__", "render", "close"):
        # A definition inside may have the name of another one.
        if any(isinstance(node, definitions) for node in function.nodes):
            continue
        for node in function.nodes:
            if not isinstance(node, ast.Call) or name_of(node.func) in stored | program.imports.keys():
                continue
            overrides = [] if counts[name_of(node.func)] > 1 else _overrides(program, node, function)
            words = {_wrong(node, one) for one in overrides}
            if words and "" not in words and not caught(program, node, function, "TypeError"):
                yield Suspect(line(node), f"calls {ast.unparse(node.func)} {min(words)}")


def _overrides(program: Program, call: ast.Call, function: Function) -> list[Function]:
    """The functions that a call may run; none if this file does not show all of them, or not their parameters."""
    name = name_of(call.func)
    if isinstance(call.func, ast.Name) and (name in function.local or name in program.module_values):
        return []
    if isinstance(call.func, ast.Name) and name in program.classes:
        found = [program.method(name, "__init__")]
        owners = [name]
        if program.method(name, "__new__") is not None or _decorated(program, name):
            return []
    elif (called := program.called(call, function)) is None or program.values(call.func, function):
        return []
    elif called.owner:
        # A class that inherits the caller may have another method of this name.
        owners = [one for one in program.classes if function.owner in program.lineage(one)]
        found = [program.method(one, called.name) for one in owners]
    else:
        owners, found = [], [called]
    whole = all(_in_line(program, one) for one in owners)
    shown = [one for one in found if one is not None]
    plain = all({name_of(each) for each in one.node.decorator_list} <= _TRANSPARENT for one in shown)
    return shown if whole and plain else []


def _decorated(program: Program, owner: str) -> bool:
    return any(program.classes[one].decorator_list or program.classes[one].keywords for one in program.lineage(owner))


def _in_line(program: Program, owner: str) -> bool:
    """Whether each class of a lineage has one base at most, and all of them are known."""
    lineage = program.lineage(owner)
    return not program.has_unknown_base(owner) and all(len(program.classes[one].bases) <= 1 for one in lineage)


def _wrong(call: ast.Call, called: Function) -> str:
    """Why a call fails, in words; "" if it does not, or may not."""
    taken = called.node.args
    places = [one.arg for one in [*taken.posonlyargs, *taken.args]][bool(called.me) :]
    named = {one.arg for one in [*taken.args, *taken.kwonlyargs]}
    given = [keyword.arg for keyword in call.keywords]
    spread = any(isinstance(one, ast.Starred) for one in call.args)
    if len(call.args) > len(places) and taken.vararg is None and not spread:
        return f"with {len(call.args)} arguments, but it takes {len(places)}"
    if taken.kwarg is None and (unknown := [name for name in given if name is not None and name not in named]):
        return f"with {unknown[0]}=, but it has no such parameter"
    if doubled := [name for name in given if not spread and name in named and name in places[: len(call.args)]]:
        return f"with two values for {doubled[0]}"
    if spread or None in given:
        return ""
    needed = places[: len(places) - len(taken.defaults)][len(call.args) :]
    needed += [one.arg for one, default in zip(taken.kwonlyargs, taken.kw_defaults, strict=True) if default is None]
    lacking = [name for name in needed if name not in given]
    return f"without {lacking[0]}, which it needs" if lacking else ""
