"""Names and attributes that nothing defines: the line that reads them raises."""

from __future__ import annotations

import ast
import enum
import importlib
import warnings
from collections import Counter
from collections.abc import Iterator
from functools import cached_property

from .program import Function, Program, Suspect, caught, line, name_of

#: Attributes that an environment has without defining them.
_INHERITED = frozenset({
    "_np_random", "_np_random_seed", "action_space", "close", "get_wrapper_attr", "has_wrapper_attr", "metadata",
    "np_random", "np_random_seed", "observation_space", "render", "render_mode", "reset", "set_wrapper_attr", "spec",
    "step", "unwrapped",
})  # fmt: skip
_ENVS = frozenset({"gymnasium.Env", "gymnasium.core.Env"})
#: Bases that give a class no attributes.
_PLAIN = frozenset({"builtins.object", "typing.Generic"})
_ENUMS = frozenset({"enum.Enum", "enum.Flag", "enum.IntEnum", "enum.IntFlag", "enum.StrEnum"})
_OF_ENUMS = frozenset({*dir(enum.IntFlag), *dir(str), *dir(type)})
#: Methods of Gym's generators, and of NumPy's older ones, that a generator of Gymnasium does not have.
OUTDATED = frozenset({
    "get_state", "rand", "randint", "randn", "random_integers", "random_sample", "ranf", "sample", "seed", "set_state",
    "tomaxint",
})  # fmt: skip
#: Modules that are installed here in the version with which environments run.
_MODULES = frozenset({"collections", "copy", "functools", "heapq", "itertools", "math", "numpy", "operator", "random"})
_RAISED = ("AttributeError", "NameError", "UnboundLocalError")
#: Ways to define what the text does not name, and to ask what there is.
_DYNAMIC = frozenset({
    "__dict__", "__getattr__", "__getattribute__", "__setattr__", "builtins", "eval", "exec", "globals", "install",
    "locals", "setattr", "vars",
})  # fmt: skip
_ASKING = frozenset({"NumpyVersion", "__version__", "hasattr", "isinstance", "version_info"})


def undefined_names(program: Program) -> Iterator[Suspect]:
    """Find names that no scope binds, attributes that nothing sets, and ones that a module or a generator lacks."""
    definitions = _Definitions(program)
    for function in program.reached("reset", "step", "__init__", "render", "close"):
        # A class inside has a `self` of its own.
        if any(isinstance(node, ast.ClassDef) for node in function.nodes):
            continue
        for node in function.nodes:
            words = definitions.lack(node, function)
            if words and not caught(program, node, function, *_RAISED):
                yield Suspect(line(node), words)


class _Definitions:
    """What a file defines."""

    def __init__(self, program: Program) -> None:
        self._program = program
        names = [name_of(node) for node in program.nodes if isinstance(node, ast.Name | ast.Attribute)]
        names += [node.name for node in program.nodes if isinstance(node, ast.FunctionDef)]
        self._dynamic = not _DYNAMIC.isdisjoint(names)
        #: Code that asks which version or which object it has may know what it reads.
        self._asking = not _ASKING.isdisjoint(names)

    def lack(self, node: ast.AST, function: Function) -> str:
        """What a node reads that nothing defines, in words; "" if it reads nothing of the kind."""
        if self._dynamic:
            return ""
        match node:
            case ast.Name(id=name, ctx=ast.Load(), lineno=row, col_offset=column) if (row, column) in self._unbound:
                return "" if _is_annotation(self._program, node) else f"reads {name}, which nothing defines"
            case ast.Attribute(attr=name, ctx=ast.Load()) if name[:2] != "__":
                return (
                    self._of_self(node, function) or self._of_class(node, function) or self._of_others(node, function)
                )
        return ""

    @cached_property
    def _unbound(self) -> set[tuple[int, int]]:
        """The places of the names that no scope binds."""
        # Their modules take as long to import as a small file to judge.
        from pyflakes.checker import Checker
        from pyflakes.messages import UndefinedName

        try:
            messages = Checker(self._program.tree, withDoctest=False).messages
        except RecursionError:
            return set()
        return {(each.lineno, each.col) for each in messages if isinstance(each, UndefinedName)}

    @cached_property
    def _attributes(self) -> set[str]:
        """Every attribute that the file sets on any object, and every string that could name one."""
        nodes = self._program.nodes
        found = {node.attr for node in nodes if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)}
        found |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
        for owner in self._classes:
            for node in ast.walk(owner):
                match node:
                    case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                        found.add(name)
                    case ast.Name(id=name):
                        found.add(name)
                    case ast.alias(name=name, asname=other):
                        found.add(other or name)
        return found

    @cached_property
    def _classes(self) -> list[ast.ClassDef]:
        return [node for node in self._program.nodes if isinstance(node, ast.ClassDef)]

    def _of_self(self, node: ast.Attribute, function: Function) -> str:
        owner = self._program.bound_to(function)
        if not function.field(node) or node.attr in self._attributes | _INHERITED or self._given_away:
            return ""
        bases = _PLAIN | _ENVS if owner == self._program.env else _PLAIN
        return f"reads self.{node.attr}, which nothing sets" if self._whole(owner, bases) else ""

    def _of_class(self, node: ast.Attribute, function: Function) -> str:
        owner = node.value.id if isinstance(node.value, ast.Name) and node.attr[:1] != "_" else ""
        if (
            owner not in self._program.classes
            or self._is_own(owner, function)
            or node.attr in self._attributes | _OF_ENUMS
        ):
            return ""
        return f"reads {owner}.{node.attr}, which nothing defines" if self._whole(owner, _PLAIN | _ENUMS) else ""

    def _of_others(self, node: ast.Attribute, function: Function) -> str:
        """An attribute of a generator, or of a module."""
        name, path = node.attr, self._program.path(node, function)
        module, _, attribute = path.rpartition(".")
        if self._asking or self._is_own(path.partition(".")[0], function):
            return ""
        if name in OUTDATED and self._is_generator(node.value, function):
            return f"calls {ast.unparse(node)}, which a generator of NumPy does not have"
        return f"reads {path}, which does not exist" if module in _MODULES and not _has(module, attribute) else ""

    def _is_own(self, name: str, function: Function) -> bool:
        """Whether a function, or a function in it, binds a name itself."""
        inner = {node.arg for node in function.nodes if isinstance(node, ast.arg)}
        return name in function.local | inner

    @cached_property
    def _given_away(self) -> bool:
        """Whether the file gives an instance to code of another file, which may set attributes."""
        program = self._program
        for node in program.nodes:
            if isinstance(node, ast.Call) and any(isinstance(one, ast.Name) and one.id == "self" for one in node.args):
                path = program.path(node.func)
                if path and not path.startswith("builtins."):
                    return True
        return False

    def _whole(self, owner: str, bases: frozenset[str]) -> bool:
        """Whether the file shows every attribute of a class, which has no bases elsewhere but some that are known."""
        lineage = self._program.lineage(owner)
        classes = [self._program.classes[one] for one in lineage]
        counts = Counter(each.name for each in self._classes)
        known = all(
            name_of(base) in self._program.classes or self._program.path(_plain(base)) in bases
            for each in classes
            for base in each.bases
        )
        decorated = {name_of(one) for each in classes for one in each.decorator_list} - {"dataclass"}
        return known and not decorated and not any(each.keywords or counts[each.name] > 1 for each in classes)

    def _is_generator(self, node: ast.expr, function: Function) -> bool:
        """Whether a value is a generator of NumPy: the environment's own, or one made by default_rng."""
        if function.field(node) == "np_random" and self._program.bound_to(function) == self._program.env:
            own = {"np_random", "_np_random"} & self._attributes
            return not own and self._whole(self._program.env, _PLAIN | _ENVS)
        if isinstance(node, ast.Name) and node.id in function.parameters:
            return False
        values = [value for value, _ in self._program.values(node, function)]
        made = [isinstance(each, ast.Call) and self._program.path(each.func, function) for each in values]
        return bool(made) and all(path == "numpy.random.default_rng" for path in made)


def _plain(base: ast.expr) -> ast.expr:
    return base.value if isinstance(base, ast.Subscript) else base


def _has(module: str, attribute: str) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return hasattr(importlib.import_module(module), attribute)


def _is_annotation(program: Program, node: ast.AST) -> bool:
    """Whether a node is part of an annotation in a function, which nothing needs to evaluate."""
    inner, outer = node, program.parents[node]
    while not isinstance(outer, ast.stmt | ast.arg):
        inner, outer = outer, program.parents[outer]
    if isinstance(outer, ast.AnnAssign):
        return inner is outer.annotation
    return isinstance(outer, ast.arg) or (isinstance(outer, ast.FunctionDef) and inner is outer.returns)
