"""A file's syntax tree as the rules read it: what names mean, and which functions play runs.

Nothing is executed. Only this file is known: a method that the environment inherits from a library has no body here.
"""

from __future__ import annotations

import ast
import contextlib
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from envcraft.model.target import Kind, nodes, parse

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.target import Project

#: Methods that change a list, a dict, a set, a deque or an array in place.
MUTATORS = frozenset({
    "add", "append", "appendleft", "clear", "discard", "extend", "extendleft", "fill", "insert", "pop", "popitem",
    "popleft", "remove", "reverse", "rotate", "setdefault", "sort", "update",
})  # fmt: skip
#: Functions that read a list and leave it as it is.
READERS = frozenset({
    "all", "any", "array", "bool", "enumerate", "len", "list", "max", "min", "reversed", "set", "sorted", "sum",
    "tuple", "zip",
})  # fmt: skip
#: Modules whose classes know nothing of what an environment adds.
_KNOWN = frozenset({"abc", "gym", "gymnasium", "typing"})


#: Exceptions that include all others.
_BROAD = frozenset({"BaseException", "Exception"})


class Suspect(NamedTuple):
    """One place in the code that a rule reports.

    Attributes:
        line: of the file.
        words: what the line does, after "line 12".
        certain: whether it is a defect in any play.
    """

    line: int
    words: str
    certain: bool = True


def in_words(suspects: Iterable[Suspect]) -> tuple[str, list[int]]:
    """What the first of some suspects does, with the other lines, and all lines in order."""
    found = list(suspects)
    first, lines = found[0], sorted({suspect.line for suspect in found})
    others = [str(number) for number in lines if number != first.line]
    more = f" (also line {', '.join(others[:5])})" if others else ""
    return f"line {first.line} {first.words}{more}", lines


class Function:
    """A function of the file.

    Attributes:
        node: its definition.
        owner: the class that defines it, "" for a function of the module.
        me: the name of its first parameter if it is bound to an instance or a class, else "".
    """

    def __init__(self, node: ast.FunctionDef | ast.AsyncFunctionDef, owner: str) -> None:
        self.node = node
        self.name = node.name
        self.owner = owner
        every = [*node.args.posonlyargs, *node.args.args]
        bound = owner and every and "staticmethod" not in {name_of(one) for one in node.decorator_list}
        self.me = every[0].arg if bound else ""

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """The nodes of the body in the order of the text, without what only a human's window needs."""
        return [node for statement in self.node.body for node in _running(statement)]

    @property
    def parameters(self) -> list[str]:
        """The names of the parameters that a caller may give by name."""
        arguments = self.node.args
        return [one.arg for one in [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]]

    @cached_property
    def local(self) -> frozenset[str]:
        """The names that the function binds itself."""
        arguments = self.node.args
        every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
        stored = {node.id for node in self.nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        shared = {name for node in self.nodes if isinstance(node, ast.Global) for name in node.names}
        return frozenset((stored | {one.arg for one in every if one is not None}) - shared)

    def field(self, node: ast.AST | None) -> str:
        """The attribute if the node is ``self.attribute``, else ""."""
        mine = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == self.me != ""
        return node.attr if mine and isinstance(node, ast.Attribute) else ""

    @cached_property
    def bindings(self) -> list[tuple[ast.expr, ast.expr | None, ast.AST]]:
        """Each name or attribute that the body binds, its value where one expression gives it, and the statement."""
        return list(bindings(self.nodes))

    @cached_property
    def writes(self) -> list[tuple[ast.expr, ast.AST]]:
        """Each name or attribute whose object the body may change in place, and the node that does it."""
        return list(_writes(self.nodes))


class Program:
    """A file.

    Args:
        tree: the syntax tree.
        env_class: the environment's class, by the name of its statement; "" if the file has none. Without it, it is
            the last class that defines ``step`` and is not private.

    Attributes:
        nodes: all of the tree.
        parents: of each node.
        classes: by name.
        functions: the functions of the module, by name.
        env: the name of the environment's class, "" if there is none.
    """

    def __init__(self, tree: ast.Module, env_class: str | None = None) -> None:
        self.tree = tree
        self.parents: dict[ast.AST, ast.AST] = {}
        self.imports: dict[str, str] = {}
        self.classes: dict[str, ast.ClassDef] = {}
        self.nodes = nodes(tree)
        self._values: dict[str, dict[str, list[tuple[ast.expr | None, Function]]]] = {}
        self._class_values: dict[str, dict[str, tuple[str, ast.expr | None]]] = {}
        for node in self.nodes:
            self.parents.update(dict.fromkeys(ast.iter_child_nodes(node), node))
            if isinstance(node, ast.Import):
                for alias in node.names:
                    name = alias.name if alias.asname else alias.name.partition(".")[0]
                    self.imports[alias.asname or name] = name
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    self.imports[alias.asname or alias.name] = f"{node.module}.{alias.name}"
            elif isinstance(node, ast.ClassDef):
                self.classes[node.name] = node
        self.functions = {
            node.name: Function(node, "")
            for node in tree.body
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        }
        self._methods = {
            name: {
                item.name: Function(item, name)
                for item in node.body
                if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef)
            }
            for name, node in self.classes.items()
        }
        stepping = [name for name in self.classes if not name.startswith("_") and "step" in self._methods[name]]
        if env_class is None:
            env_class = stepping[-1] if stepping else ""
        self.env = env_class if env_class in self.classes else ""

    def lineage(self, name: str) -> list[str]:
        """A class and its bases in this file, in the order in which attributes are looked up."""
        found: list[str] = []
        waiting = [name]
        while waiting:
            one = waiting.pop(0)
            if one in self.classes and one not in found:
                found.append(one)
                waiting += [name_of(base) for base in self.classes[one].bases]
        return found

    @cached_property
    def own_classes(self) -> list[str]:
        """The classes of the file, without environments that the judged one does not use."""
        bodies = [node for one in self.lineage(self.env) for node in outside(self.classes[one].body)]
        named = _names(bodies, *(one.nodes for one in self.all))
        # An instance of a helper may be a name of the module.
        named |= _names(*(ast.walk(value) for name in named if (value := self.module_values.get(name)) is not None))
        used = {one for name in (self.env, *named) for one in self.lineage(name)}
        return [
            name
            for name in self.classes
            if name in used or not (self.method(name, "reset") and self.method(name, "step"))
        ]

    def method(self, owner: str, name: str, after: str = "") -> Function | None:
        """The method that a class has under this name; `after` skips the lineage up to that class, as super() does."""
        lineage = self.lineage(owner)
        if after in lineage:
            lineage = lineage[lineage.index(after) + 1 :]
        return next((self._methods[one][name] for one in lineage if name in self._methods[one]), None)

    def methods(self, owner: str) -> list[Function]:
        """All methods of a class and its bases in this file."""
        return [method for one in self.lineage(owner) for method in self._methods[one].values()]

    def bound_to(self, function: Function) -> str:
        """The class of ``self`` in a method: the environment for its own methods and inherited ones."""
        return self.env if function.owner in self.lineage(self.env) else function.owner

    def path(self, node: ast.AST, function: Function | None = None) -> str:
        """What a name means by the file's imports, such as ``numpy.random.rand``; ``builtins.open`` for a built-in.

        Returns:
            "" for what the file itself binds.
        """
        parts = []
        while isinstance(node, ast.Attribute):
            parts.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name) or (function is not None and node.id in function.local):
            return ""
        if node.id in self.imports:
            return ".".join([self.imports[node.id], *reversed(parts)])
        own = node.id in self.functions or node.id in self.classes or node.id in self.module_values
        return "" if own or parts else f"builtins.{node.id}"

    def has_unknown_base(self, owner: str) -> bool:
        """Whether a class inherits from one of another file, other than Gymnasium's, which may use all that it adds."""
        bases = [base for one in self.lineage(owner) for base in self.classes[one].bases]
        bases = [base.value if isinstance(base, ast.Subscript) else base for base in bases]
        paths = [self.path(base) for base in bases if name_of(base) not in self.classes]
        return any(path.partition(".")[0] not in _KNOWN and path != "builtins.object" for path in paths)

    @cached_property
    def module_nodes(self) -> list[ast.AST]:
        """The nodes of the module outside functions and classes."""
        return list(outside(self.tree.body))

    @cached_property
    def module_values(self) -> dict[str, ast.expr | None]:
        """The names that the module binds, with their last values."""
        return {target.id: value for target, value, _ in bindings(self.module_nodes) if isinstance(target, ast.Name)}

    def class_values(self, owner: str) -> dict[str, tuple[str, ast.expr | None]]:
        """The attributes that the bodies of a class and its bases bind: the class that does, and the value."""
        if owner not in self._class_values:
            self._class_values[owner] = {
                target.id: (one, value)
                for one in reversed(self.lineage(owner))
                for target, value, _ in bindings(outside(self.classes[one].body))
                if isinstance(target, ast.Name)
            }
        return self._class_values[owner]

    def field_values(self, owner: str) -> dict[str, list[tuple[ast.expr | None, Function]]]:
        """What the methods of a class bind to each attribute of ``self``, with the method that does."""
        if owner not in self._values:
            found = self._values[owner] = {}
            for method in self.methods(owner):
                for target, value, _ in method.bindings:
                    if field := method.field(target):
                        found.setdefault(field, []).append((value, method))
        return self._values[owner]

    def values(self, node: ast.AST, function: Function | None) -> list[tuple[ast.expr | None, Function | None]]:
        """What a name or an attribute is bound to anywhere, with the function that does; None for an unknown value."""
        if function is not None and (field := function.field(node)):
            owner = self.bound_to(function)
            found: list[tuple[ast.expr | None, Function | None]] = [*self.field_values(owner).get(field, ())]
            known = self.class_values(owner)
            return [*found, (known[field][1], None)] if field in known else found
        if not isinstance(node, ast.Name):
            return []
        if function is not None and node.id in function.local:
            bound = [
                value for target, value, _ in function.bindings if name_of(target) == node.id and target is not node
            ]
            return [(value, function) for value in bound] or [(None, function)]
        return [(self.module_values[node.id], None)] if node.id in self.module_values else []

    def around(self, node: ast.AST, function: Function) -> Iterator[ast.AST]:
        """The nodes of a function's body that hold a node, innermost first."""
        while (node := self.parents[node]) is not function.node:
            yield node

    def changed(self, *names: str) -> set[str]:
        """The attributes of ``self`` that these methods, or functions that they may call, bind or change in place."""
        functions = self.reached(*names)
        bound = {one.field(target) for one in functions for target, _, _ in one.bindings}
        return (bound | {one.field(target) for one in functions for target, _ in one.writes}) - {""}

    def block(self, statement: ast.AST) -> list[ast.stmt]:
        """The statements among which one stands, itself included; none for what is no statement."""
        parent = self.parents[statement]
        blocks = (getattr(parent, name, None) for name in ("body", "orelse", "finalbody"))
        return next((each for each in blocks if isinstance(each, list) and statement in each), [])

    def declared_at(self, name: str) -> list[int]:
        """The lines at which the environment gets an attribute: those of a property, else of the nearest class whose
        methods assign it, else of the nearest class whose body does.
        """
        if (method := self.method(self.env, name)) is not None:
            return [line(method.node)]
        lineage = self.lineage(self.env)
        assigned = (
            [
                line(target)
                for each in self._methods[one].values()
                for target, _, _ in each.bindings
                if each.field(target) == name
            ]
            for one in lineage
        )
        bound = (
            [line(target) for target, _, _ in bindings(outside(self.classes[one].body)) if name_of(target) == name]
            for one in lineage
        )
        return next((lines for lines in (*assigned, *bound) if lines), [])

    def called(self, call: ast.Call, function: Function) -> Function | None:
        """The function of the file, or the method of ``self``, that a call names."""
        if field := function.field(call.func):
            return self.method(self.bound_to(function), field)
        return self.functions.get(call.func.id) if isinstance(call.func, ast.Name) else None

    @cached_property
    def play(self) -> list[Function]:
        """The functions that reset() and step() may call."""
        return self.reached("reset", "step")

    @cached_property
    def all(self) -> list[Function]:
        """The functions that reset(), step() and the constructor may call."""
        return self.reached("reset", "step", "__init__")

    def reached(self, *names: str) -> list[Function]:
        """The functions that these methods of the environment may call, themselves included."""
        found: dict[Function, None] = {}
        live: set[str] = set()
        used: set[str] = set()
        waiting = [method for name in names if (method := self.method(self.env, name)) is not None]
        while waiting:
            for function in waiting:
                found[function] = None
            mentioned = [self._mentions(function) for function in waiting]
            for _, classes, attributes in mentioned:
                live |= classes
                used |= attributes
            # A call of a helper's method is known by the method's name only.
            called = [
                one for name in sorted(live) for one in self.methods(name) if one.name in used or one.name[:2] == "__"
            ]
            called += [call for calls, _, _ in mentioned for call in calls]
            waiting = [one for one in dict.fromkeys(called) if one not in found]
        return list(found)

    def _mentions(self, function: Function) -> tuple[list[Function], set[str], set[str]]:
        """The functions that a function names, the helper classes that it names, and every attribute that it reads."""
        calls: list[Function | None] = []
        classes, attributes = set(), set()
        owner = self.bound_to(function)
        for node in function.nodes:
            if isinstance(node, ast.Attribute):
                attributes.add(node.attr)
                if function.field(node):
                    calls.append(self.method(owner, node.attr))
                elif isinstance(node.value, ast.Call) and name_of(node.value.func) == "super":
                    calls.append(self.method(owner, node.attr, after=function.owner))
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id not in function.local:
                calls.append(self.functions.get(node.id))
                if node.id in self.classes and node.id not in self.lineage(self.env):
                    classes.add(node.id)
        return [call for call in calls if call is not None], classes, attributes


class Helpers(Program):
    """A file of the environment's project, of which play may run what has one of these names.

    Args:
        tree: the syntax tree.
        mentioned: names that the files of the project mention.
    """

    def __init__(self, tree: ast.Module, mentioned: set[str]) -> None:
        super().__init__(tree, "")
        self._mentioned = mentioned

    @cached_property
    def all(self) -> list[Function]:
        methods = [method for owner in self._methods.values() for method in owner.values()]
        return [one for one in [*self.functions.values(), *methods] if one.name in self._mentioned]

    @cached_property
    def play(self) -> list[Function]:
        return self.all


def mentions(tree: ast.Module) -> set[str]:
    """The names and attributes that a file reads, and the methods that Python or Gymnasium calls."""
    read = {node.id for node in nodes(tree) if isinstance(node, ast.Name)}
    read |= {node.attr for node in nodes(tree) if isinstance(node, ast.Attribute)}
    return read | {"reset", "step", "render", "__init__", "__call__"}


def helpers(program: Program, project: Project) -> Iterator[tuple[str, Helpers]]:
    """The other files of a project that can be read, by path."""
    trees: dict[str, ast.Module] = {}
    for path, data in sorted(project.files.items()):
        if path.endswith(".py"):
            with contextlib.suppress(SyntaxError, ValueError, RecursionError, MemoryError):
                trees[path] = parse(data)
    mentioned = set().union(*map(mentions, (program.tree, *trees.values())))
    yield from ((path, Helpers(tree, mentioned)) for path, tree in trees.items())


def program_of(subject: Subject) -> Program | None:
    """The code of an environment; None for an installed one, or one that is nested too deeply."""
    if subject.target.kind is not Kind.SOURCE:
        return None
    try:
        return Program(parse(subject.text), subject.class_statement)
    except RecursionError:
        return None


def name_of(node: ast.AST) -> str:
    """The last part of a dotted name, of what is called, or of what is subscripted; "" for anything else."""
    if isinstance(node, ast.Call):
        return name_of(node.func)
    if isinstance(node, ast.Subscript):
        return name_of(node.value)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def arguments(call: ast.Call, called: Function) -> Iterator[tuple[str, ast.expr]]:
    """Yield what a call gives a function of the file, with the name of each parameter that takes it."""
    taken = called.node.args
    parameters = [one.arg for one in [*taken.posonlyargs, *taken.args]][bool(called.me) :]
    for number, value in enumerate(call.args):
        if number < len(parameters):
            yield parameters[number], value
        elif taken.vararg is not None:
            yield taken.vararg.arg, value
    for keyword in call.keywords:
        if keyword.arg is not None:
            yield keyword.arg, keyword.value


def _names(*nodes: Iterable[ast.AST]) -> set[str]:
    return {node.id for each in nodes for node in each if isinstance(node, ast.Name)}


def caught(program: Program, node: ast.AST, function: Function, *errors: str) -> bool:
    """Whether a handler around a node catches one of these exceptions, or all of them."""
    inner = node
    for outer in program.around(node, function):
        if isinstance(outer, ast.Try) and inner in outer.body:
            if any(catches(handler, *errors) for handler in outer.handlers):
                return True
        elif isinstance(outer, ast.With):
            calls = [item.context_expr for item in outer.items if name_of(item.context_expr) == "suppress"]
            kinds = [kind for call in calls if isinstance(call, ast.Call) for kind in call.args]
            if any(name_of(kind) in {*errors, *_BROAD} for kind in kinds):
                return True
        inner = outer
    return False


def catches(handler: ast.ExceptHandler, *errors: str) -> bool:
    """Whether a handler catches one of these exceptions, or all of them."""
    kinds = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(kind is None or name_of(kind) in {*errors, *_BROAD} for kind in kinds)


def root(node: ast.expr) -> ast.expr:
    """The name or attribute whose items a chain of subscripts reads."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return node


def line(node: ast.AST) -> int:
    """The line of a node, 0 for one that has none."""
    return getattr(node, "lineno", 0)


def bindings(nodes: Iterable[ast.AST]) -> Iterator[tuple[ast.expr, ast.expr | None, ast.AST]]:
    """Yield each name or attribute that is bound, its value where one expression gives it, and the statement."""
    for node in nodes:
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    yield from _bound(target, value, node)
            case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
                yield from _bound(target, value, node)
            case (
                ast.For(target=target) | ast.AsyncFor(target=target) | ast.withitem(optional_vars=ast.expr() as target)
            ):
                yield from _bound(target, None, node)


def _bound(
    target: ast.expr, value: ast.expr | None, node: ast.AST
) -> Iterator[tuple[ast.expr, ast.expr | None, ast.AST]]:
    if isinstance(target, ast.Tuple | ast.List):
        parts = value.elts if isinstance(value, ast.Tuple | ast.List) and len(value.elts) == len(target.elts) else None
        for number, one in enumerate(target.elts):
            yield from _bound(one, parts[number] if parts else None, node)
    elif isinstance(target, ast.Starred):
        yield from _bound(target.value, None, node)
    elif isinstance(target, ast.Name | ast.Attribute):
        yield target, value, node


def _writes(nodes: Iterable[ast.AST]) -> Iterator[tuple[ast.expr, ast.AST]]:
    for node in nodes:
        match node:
            case ast.Subscript(ctx=ast.Store() | ast.Del(), value=value):
                yield root(value), node
            case ast.AugAssign(target=ast.Name() | ast.Attribute() as target):
                yield target, node
            case ast.Call(func=ast.Attribute(value=value, attr=attr)) if attr in MUTATORS:
                yield root(value), node


def _running(node: ast.AST) -> Iterator[ast.AST]:
    """Walk a node in the order of the text, without branches under ``render_mode == "human"``."""
    yield node
    if isinstance(node, ast.If) and _for_human(node.test):
        children: Iterable[ast.AST] = node.orelse
    else:
        children = ast.iter_child_nodes(node)
    for child in children:
        yield from _running(child)


def _for_human(test: ast.expr) -> bool:
    parts = test.values if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And) else [test]
    return any(
        isinstance(part, ast.Compare)
        and isinstance(part.ops[0], ast.Eq)
        and any(isinstance(side, ast.Constant) and side.value == "human" for side in (part.left, *part.comparators))
        for part in parts
    )


def outside(body: Iterable[ast.stmt]) -> Iterator[ast.AST]:
    """Walk the body of a module or a class without the functions and classes in it."""
    waiting: list[ast.AST] = list(body)
    while waiting:
        one = waiting.pop(0)
        if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda):
            yield one
            waiting += ast.iter_child_nodes(one)
