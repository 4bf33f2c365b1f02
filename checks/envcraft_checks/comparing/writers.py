"""Fields that differ, in the code: which of them the others are calculated from, and which line writes each."""

from __future__ import annotations

import ast
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, partial
from typing import TYPE_CHECKING

from envcraft.model.target import Kind, parse
from envcraft.text import relative
from envcraft_checks.linting.clock import clocks, readings
from envcraft_checks.linting.generators import generators, kept_generators, seeded_draws
from envcraft_checks.linting.leftovers import kept, leftovers, used_fields
from envcraft_checks.linting.once import changes, closures, constants, iterators, uncopied, uninitialised
from envcraft_checks.linting.order import addresses, orders, turns
from envcraft_checks.linting.program import (
    Function,
    Program,
    Suspect,
    bindings,
    helpers,
    line,
    name_of,
    root,
)
from envcraft_checks.linting.sharing import is_bookkeeping, kept_actions, only_remembers, shared

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.target import Project

#: Codes of state that outlives an episode or that instances share.
SHARED = frozenset({"EC206", "EC207"})
#: What finds the lines that change what is created once.
_ONCE = (constants, uncopied, closures, iterators)
#: What finds the lines that may cause a difference, by its code.
FINDERS: dict[str, tuple[Callable[[Program], Iterator[Suspect]], ...]] = {
    "EC201": (generators, clocks),
    "EC202": (orders, generators),
    "EC203": (orders,),
    "EC204": (generators,),
    "EC205": (clocks,),
    "EC206": (kept, leftovers, shared, *_ONCE, kept_generators),
    "EC207": (shared, *_ONCE),
    "EC215": (kept_actions,),
}
#: What finds the lines where those above find none.
_LAST: dict[str, tuple[Callable[[Program], Iterator[Suspect]], ...]] = {
    "EC201": (uninitialised, addresses),
    "EC202": (
        uninitialised,
        partial(turns, kinds=("objects",)),
    ),
    "EC203": (partial(turns, kinds=("strings", "members of an enumeration")),),
    "EC204": (seeded_draws,),
    "EC205": (readings,),
}
#: The parts of the results of ``step``, in order.
PARTS = ("observation", "reward", "terminated", "truncated", "info")
_GENERATORS = ("random", "numpy.random", "np_random")


class Writers:
    """Answers about the fields of one subject.

    Args:
        subject: the environment. Of a file that cannot be read, nothing is known.
        code: of the finding.

    Attributes:
        code: of the finding.
        suspects: the places in the file that do what the code reports.
        elsewhere: the first file of the project that has such places if the file has none, and the places; of shared
            state, those of :meth:`follow`.
    """

    def __init__(self, subject: Subject, code: str) -> None:
        self.code = code
        self._program: Program | None = None
        self._project = subject.target.project
        self.suspects: list[Suspect] = []
        self.elsewhere: tuple[str, list[Suspect]] | None = None
        try:
            if subject.target.kind is Kind.SOURCE:
                program = Program(parse(subject.text), subject.class_statement)
            elif text := subject.installed_source:
                program = Program(parse(text), subject.env_class)
            else:
                return
            self._program = program
            for finders in (FINDERS.get(code, ()), _LAST.get(code, ())):
                if not self.suspects and self.elsewhere is None:
                    self.suspects = list(dict.fromkeys(one for find in finders for one in find(program)))
                    if not self.suspects and code not in SHARED and self._project is not None:
                        self.elsewhere = _elsewhere(program, self._project, finders)
        except (RecursionError, SyntaxError, ValueError):
            self._program = None

    def follow(self, path: str) -> None:
        """Look for the lines that change a field of another module of the project, if the file has none.

        Args:
            path: the field, by the name of its module.
        """
        if self.code not in SHARED or self._program is None or self._project is None or self._writes(path):
            return
        for file, helper in helpers(self._program, self._project):
            if inside := _inside(file, _plain(path)):
                name = re.split(r"[\[(]", inside)[0]
                words = f"changes {name}, which all episodes and instances share"
                found = [
                    Suspect(line(node), words)
                    for function in helper.all
                    for target, node in _targets(function)
                    if _names(target, _last(inside), function, inside)
                ]
                if found:
                    self.elsewhere = relative(os.path.join(self._project.root, file)), list(dict.fromkeys(found))
                    return

    def most_causal(self, paths: list[str], part: str) -> str:
        """The field that the others follow from, as far as the file tells; of several one that is returned.

        Args:
            paths: fields that differ after the same call.
            part: of the results, which differs: a key of :data:`PARTS`.
        """
        returned = self._returned(part)
        made = {path: self._made_from(_base(path)) for path in paths}

        def rank(path: str) -> tuple[bool | int, ...]:
            base = _base(path)
            others = {_base(other) for other in paths} - {base, *_GENERATORS}
            made_from = any(other in made[path] and base not in self._made_from(other) for other in others)
            ranks = made_from, not self._is_suspect(path), base not in returned
            return self.is_idle(path), base in _GENERATORS, *ranks, path.count(".")

        return min(paths, key=rank)

    def ordered(self, paths: list[str]) -> list[str]:
        """Those of some sets whose order a suspect line uses; all of them if no line names one."""
        texts = [self._text_at(suspect.line) for suspect in self.suspects]
        named = [path for path in paths if any(re.search(rf"\b{re.escape(_last(path))}\b", text) for text in texts)]
        return named or (paths if not texts else [])

    def line(self, path: str, ran: Iterable[int] = ()) -> int | None:
        """The line that writes a field: if some of those that do have run, one of these; if render() is the cause, one
        that it reaches.

        Args:
            path: the field.
            ran: lines that ran in the call after which it differs.
        """
        lines, suspected = set(ran), {suspect.line for suspect in self.suspects}

        def rank(write: tuple[ast.AST, int]) -> tuple[bool, bool, bool, int, int]:
            node, default = write
            own = _lines(node)
            return node not in self._drawing, lines.isdisjoint(own), suspected.isdisjoint(own), default, line(node)

        writes = self._writes(path)
        if self.code in SHARED:
            # What creates an object once runs in no episode.
            writes = [write for write in writes if write[0] not in self._created]
            if self.suspects:
                writes = [write for write in writes if write[0] not in self._constructing]
            # The method of another file may be the one that ran.
            if self._project is not None and path.startswith("self."):
                writes = [write for write in writes if not lines.isdisjoint(_lines(write[0]))]
        found = min(writes, key=rank, default=None)
        shared = self.code in SHARED and not path.startswith("self.")
        if found is None and shared and not self.suspects and self._program is not None:
            changing = changes(self._program, _base(path))
            return min(changing & lines or changing, default=None)
        return line(found[0]) if found is not None else None

    @cached_property
    def _created(self) -> frozenset[ast.AST]:
        """The nodes that bind names of the module and of classes."""
        return frozenset(node for _, _, node in bindings(self._outside))

    @cached_property
    def _constructing(self) -> frozenset[ast.AST]:
        """The nodes of the constructor, unless play calls it."""
        program = self._program
        methods = program.methods(program.env) if program is not None else []
        play = program.play if program is not None else []
        return frozenset(node for one in methods if one.name == "__init__" and one not in play for node in one.nodes)

    @cached_property
    def _drawing(self) -> frozenset[ast.AST]:
        """The nodes that render() reaches, if it is the cause."""
        reached = self._program.reached("render") if self._program is not None and self.code == "EC208" else ()
        return frozenset(node for one in reached for node in one.nodes)

    def _text_at(self, number: int) -> str:
        assert self._program is not None
        return " ".join(
            ast.unparse(node)
            for node in self._program.nodes
            if isinstance(node, ast.expr) and line(node) == number and not isinstance(node, ast.Constant)
        )

    def places(self, path: str) -> frozenset[int]:
        """All lines of the statements that write a field."""
        return frozenset(number for node, _ in self._writes(path) for number in _lines(node))

    def around(self, path: str) -> frozenset[int]:
        """The lines of the functions that write a field."""
        nodes = {node for node, _ in self._writes(path)}
        own = (one for one in self._functions if one.name != "reset" and not nodes.isdisjoint(one.nodes))
        return frozenset(number for one in own for number in _lines(one.node))

    def _is_suspect(self, path: str) -> bool:
        places = self.places(path)
        return any(suspect.line in places for suspect in self.suspects)

    def is_idle(self, path: str) -> bool:
        """Whether nothing but the field itself and info depends on it, or it only remembers what was calculated."""
        program, name = self._program, _base(path)
        if is_bookkeeping(name) or name == "_np_random_seed":
            return True
        if program is None or not path.startswith("self."):
            return False
        own = [function for function in program.all if program.bound_to(function) == program.env]
        writes = [(one, node) for one in own for target, node in _targets(one) if one.field(target) == name]
        # What is taken out of a container is used.
        taken = any(_takes(program, one, node, name) for one in own for node in one.nodes)
        remembers = bool(writes) and all(
            (only_remembers(program, one, name, node) and not _draws_value(program, one, node)) or _is_empty(node)
            for one, node in writes
        )
        return remembers or (bool(writes) and not taken and name not in used_fields(program, own))

    def _writes(self, path: str) -> list[tuple[ast.AST, int]]:
        """Each node that writes a field, and how likely it writes a default that another line replaces: 2 for the first
        value, 1 for a constant.
        """
        program, name = self._program, _last(path)
        if program is None:
            return []
        if parameter := re.search(r"(\w+)\((\w+)\)", _plain(path)):
            return self._default_writes(*parameter.groups())
        found: dict[ast.AST, int] = {}
        for function in self._functions:
            for target, node in _targets(function):
                if _names(target, name, function, path):
                    assigned = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
                    found[node] = 2 if function.name == "__init__" else int(isinstance(assigned, ast.Constant))
        if _base(path) in _GENERATORS or not found:
            drawing = ((node, one) for one in self._functions for node in one.nodes)
            found.update((node, 0) for node, one in drawing if _draws(program, node, name, one))
        for target, _, node in bindings(self._outside):
            if isinstance(target, ast.Name) and target.id == name and not path.startswith("self."):
                found[node] = 2
        return list(found.items())

    @cached_property
    def _outside(self) -> list[ast.AST]:
        """The nodes of the module and of the bodies of its own classes, outside functions."""
        program = self._program
        if program is None:
            return []
        return [*program.module_nodes, *(node for owner in program.own_classes for node in program.classes[owner].body)]

    def _default_writes(self, function: str, parameter: str) -> list[tuple[ast.AST, int]]:
        return [
            (node, 0)
            for one in self._functions
            if one.name == function
            for target, node in one.writes
            if isinstance(target, ast.Name) and target.id == parameter
        ]

    @cached_property
    def _functions(self) -> list[Function]:
        """The functions of the file, and the methods of the classes that the environment may use."""
        if (program := self._program) is None:
            return []
        methods = (method for owner in program.own_classes for method in program.methods(owner))
        return list(dict.fromkeys([*program.functions.values(), *methods]))

    def _made_from(self, base: str) -> frozenset[str]:
        """The names whose values a field's values are calculated from, directly or not."""
        found: set[str] = set()
        waiting = [base]
        while waiting:
            for name in self._sources.get(waiting.pop(), ()):
                if name not in found:
                    found.add(name)
                    waiting.append(name)
        return frozenset(found)

    def _returned(self, part: str) -> frozenset[str]:
        """The names that a part of the results of ``reset`` and ``step`` is calculated from, directly or not."""
        found: set[str] = set()
        for function in self._program.all if self._program is not None and part in PARTS else ():
            for node in function.nodes if function.name in ("reset", "step") else ():
                if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple):
                    values = node.value.elts
                    place = -1 if part == "info" else PARTS.index(part)
                    if place < len(values):
                        found.update(_mentioned(values[place]))
        return frozenset(found.union(*map(self._made_from, found)))

    @cached_property
    def _sources(self) -> dict[str, set[str]]:
        """The names that appear in what is assigned to each attribute, or put into it."""
        program = self._program
        found: dict[str, set[str]] = {}
        for function in program.all if program is not None else ():
            for target, value, node in function.bindings:
                base = function.field(target) or (target.id if isinstance(target, ast.Name) else "")
                origin = value if value is not None else getattr(node, "iter", getattr(node, "value", None))
                found.setdefault(base, set()).update(_mentioned(origin))
            for target, node in function.writes:
                base = function.field(root(target)) or name_of(target)
                put = [*node.args] if isinstance(node, ast.Call) else [getattr(node, "value", None)]
                if isinstance(node, ast.Subscript) and program is not None:
                    put = [node.slice, getattr(program.parents[node], "value", None)]
                found.setdefault(base, set()).update(name for one in put for name in _mentioned(one))
            for node in function.nodes:
                if isinstance(node, ast.Return):
                    found.setdefault(function.name, set()).update(_mentioned(node.value))
        return found


def _elsewhere(
    program: Program, project: Project, finders: Iterable[Callable[[Program], Iterator[Suspect]]]
) -> tuple[str, list[Suspect]] | None:
    """The first file of a project in which some finders find places, and these."""
    for path, helper in helpers(program, project):
        if found := list(dict.fromkeys(one for find in finders for one in find(helper))):
            return relative(os.path.join(project.root, path)), found
    return None


def _inside(file: str, path: str) -> str:
    """What follows the name of a file's module in the path of a field; "" if the path starts with another name."""
    parts = file.removesuffix(".py").removesuffix("/__init__").split("/")
    modules = (".".join(parts[start:]) for start in range(len(parts)))
    return next((path[len(module) + 1 :] for module in modules if path.startswith(f"{module}.")), "")


_WRAPPED = re.compile(r"(?:len|list|iter)\(")


def _plain(path: str) -> str:
    """A path without what the worker puts around it."""
    return path[path.index("(") + 1 : -1] if _WRAPPED.match(path) else path


def object_of(path: str) -> str:
    """The name of the object of which a field is a part."""
    return _plain(path).partition("[")[0]


def _base(path: str) -> str:
    """The attribute of the environment or of a class, or the global, that leads to a field."""
    plain = _plain(path)
    if plain in _GENERATORS:
        return plain
    parts = re.split(r"[.\[(]", plain)
    owned = parts[0] == "self" or (parts[0][:1].isupper() and plain.startswith(f"{parts[0]}."))
    return parts[1] if len(parts) > 1 and owned else parts[0]


def _last(path: str) -> str:
    """The last name of a path."""
    plain = _plain(path)
    if plain == "numpy.random":
        return plain
    return re.findall(r"[^\W\d]\w*", re.sub(r"\[[^\]]*\]|\.flat\b", "", plain))[-1:][0] if plain else ""


def _mentioned(node: ast.AST | None) -> Iterator[str]:
    for one in ast.walk(node) if node is not None else ():
        if isinstance(one, ast.Attribute):
            yield one.attr
        elif isinstance(one, ast.Name):
            yield one.id


def _targets(function: Function) -> Iterator[tuple[ast.expr, ast.AST]]:
    """Each name or attribute that a function binds or changes in place, and the node that does it."""
    yield from ((target, node) for target, _, node in function.bindings)
    yield from function.writes
    yield from ((node.target, node) for node in function.nodes if isinstance(node, ast.AugAssign))


def _names(target: ast.expr, name: str, function: Function, path: str) -> bool:
    target = root(target)
    if isinstance(target, ast.Attribute):
        return target.attr == name
    # A global, or one that a field of it follows.
    shared = isinstance(target, ast.Name) and target.id == name and name not in function.local
    return shared and _plain(path).split(".")[0].split("[")[0] == name


def _draws(program: Program, node: ast.AST, name: str, function: Function) -> bool:
    """Whether a node is a call of a method of the generator with this name."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    if name in ("random", "numpy.random"):
        return program.path(node.func, function).rpartition(".")[0] == name
    return name_of(node.func.value) == name


def _draws_value(program: Program, function: Function, node: ast.AST) -> bool:
    """Whether a statement, or a function of the file that it calls, uses the environment's generator."""
    calls = (one for one in ast.walk(node) if isinstance(one, ast.Call))
    called = (found for one in calls if (found := program.called(one, function)) is not None)
    nodes = itertools.chain(ast.walk(node), *(one.nodes for one in called))
    return any(name_of(one) == "np_random" for one in nodes)


def _takes(program: Program, function: Function, node: ast.AST, name: str) -> bool:
    """Whether a node uses what it takes out of an attribute."""
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr="pop" | "popitem" | "popleft")):
            return function.field(root(value)) == name and not isinstance(program.parents[node], ast.Expr)
    return False


def _is_empty(node: ast.AST) -> bool:
    value = getattr(node, "value", None)
    return (isinstance(value, ast.Constant) and value.value is None) or (isinstance(value, ast.Dict) and not value.keys)


def _lines(node: ast.AST) -> range:
    return range(line(node), (getattr(node, "end_lineno", None) or line(node)) + 1)
