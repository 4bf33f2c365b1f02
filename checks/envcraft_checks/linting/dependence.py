"""What the values of an environment depend on in play: data, and the tests around it."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator

from .program import Function, Program, arguments, line, name_of, root

#: An attribute of any object, by its name; the result of a function; a name in a function, or of the module.
Node = str | Function | tuple[Function | None, str]

#: A node, and the function that contains it.
Place = tuple[ast.AST, Function]

#: A statement or a call, the value that it assigns, and the function that contains it.
Write = tuple[ast.AST, ast.expr | None, Function]

#: Methods that only read what they belong to.
_READERS = frozenset({
    "all", "any", "astype", "copy", "count", "endswith", "flatten", "format", "get", "index", "intersection",
    "isdisjoint", "issubset", "items", "join", "keys", "max", "mean", "min", "nonzero", "ravel", "startswith", "sum",
    "tolist", "union", "values",
})  # fmt: skip
#: Built-in functions whose result is, or gives, what they are given; and those of libraries.
_GIVING = frozenset({
    "enumerate", "filter", "getattr", "iter", "list", "max", "min", "next", "reversed", "sorted", "zip",
})  # fmt: skip
_VIEWS = frozenset({"asarray", "atleast_1d", "atleast_2d", "ravel", "reshape", "transpose"})
#: Functions that take something from their first argument.
_TAKING = frozenset({"heappop", "heappushpop", "heapreplace", "next", "setdefault"})
#: Functions that take the environment and do not change it.
_HARMLESS = frozenset({"isinstance", "super"})
#: Names that reach attributes which the text does not show.
_HIDING = frozenset({"__dict__", "delattr", "eval", "exec", "setattr", "vars"})


class Dependence:
    """What depends on what in the functions that step() may call.

    Attributes of the same name are taken for one, whatever their object, and so are methods. The order of statements
    does not count. So this finds too many dependencies rather than too few.
    """

    def __init__(self, program: Program, step: Function, functions: list[Function]) -> None:
        self.program = program
        self.step = step
        self.functions = functions
        self._named: dict[str, list[Function]] = defaultdict(list)
        for function in functions:
            self._named[function.name].append(function)
        self._needs: dict[Node, set[Node]] = defaultdict(set)
        self._aliases: dict[Node, set[Node]] = defaultdict(set)
        self._calls: dict[Function, list[tuple[ast.AST, Function]]] = defaultdict(list)
        self._writes: dict[Node, list[Write]] = defaultdict(list)
        self._changed: list[tuple[Node, set[Node], Write]] = []
        self.is_known = all(map(self._is_known, functions))
        if self.is_known:
            for function in functions:
                for node in function.nodes:
                    self._add(node, function)

    def _is_known(self, function: Function) -> bool:
        """Whether all calls and attributes of a function are known."""
        for node in function.nodes:
            match node:
                case ast.FunctionDef() | ast.ClassDef() | ast.AsyncFunctionDef() | ast.Yield() | ast.Await():
                    return False
                case ast.Name(id=name) | ast.Attribute(attr=name) if name in _HIDING:
                    return False
                case ast.Name(id=name) if name == function.me:
                    if not self._is_seen(node, function):
                        return False
                case ast.Call(func=ast.Attribute(attr=attr) as called) if function.field(called):
                    owner = self.program.bound_to(function)
                    if not self.program.method(owner, attr) and attr not in self.program.field_values(owner):
                        return False
        return True

    def _is_seen(self, node: ast.Name, function: Function) -> bool:
        """Whether a mention of ``self`` only reads or sets an attribute, or goes to a function of the file."""
        parent = self.program.parents[node]
        if isinstance(parent, ast.Attribute):
            return True
        if isinstance(parent, ast.keyword):
            parent = self.program.parents[parent]
        return isinstance(parent, ast.Call) and (name_of(parent) in _HARMLESS or bool(self._called(parent)))

    def _called(self, call: ast.Call) -> list[Function]:
        """The functions of the file that a call may mean, by the name alone."""
        name = name_of(call.func) if isinstance(call.func, ast.Name | ast.Attribute) else ""
        if name in self.program.classes:
            return [one for one in self._named["__init__"] if one.owner in self.program.lineage(name)]
        return self._named.get(name, [])

    # What an expression reads.

    def _reads(self, node: ast.AST | None, function: Function) -> set[Node]:
        found: set[Node] = set()
        waiting = [node] if node is not None else []
        while waiting:
            one = waiting.pop()
            if isinstance(one, ast.Name):
                if one.id != function.me:
                    found.add(self._name(one.id, function))
            elif isinstance(one, ast.Attribute):
                if self.program.path(one, function):
                    continue
                found.add(f".{one.attr}")
                found.update(self._named.get(one.attr, ()))
                waiting.append(one.value)
            else:
                waiting += ast.iter_child_nodes(one)
        return found

    def _name(self, name: str, function: Function) -> Node:
        if name in function.local:
            return function, name
        return self.program.functions.get(name) or (None, name)

    def _objects(self, node: ast.expr | None, function: Function) -> set[Node]:
        """The names and attributes whose object, or a part of it, an expression may be."""
        match node:
            case ast.Name():
                return {self._name(node.id, function)} if node.id != function.me else set()
            case ast.Attribute():
                return {f".{node.attr}"} if not self.program.path(node, function) else set()
            case ast.Subscript(value=value) | ast.Starred(value=value) | ast.NamedExpr(value=value):
                return self._objects(value, function)
            case ast.Call(func=func, args=args):
                if called := self._called(node):
                    return set(called)
                path = self.program.path(func, function)
                if path.startswith("builtins.") and name_of(func) not in _GIVING:
                    return set()
                if path and not path.startswith("builtins.") and name_of(func) not in _VIEWS:
                    return set()
                inner = [func.value] if isinstance(func, ast.Attribute) and not path else []
                return {each for one in [*inner, *args] for each in self._objects(one, function)}
            case ast.BoolOp(values=values) | ast.Tuple(elts=values) | ast.List(elts=values):
                return {each for one in values for each in self._objects(one, function)}
            case ast.IfExp(body=one, orelse=two) | ast.BinOp(op=ast.Add(), left=one, right=two):
                return self._objects(one, function) | self._objects(two, function)
            case ast.ListComp(generators=generators) | ast.GeneratorExp(generators=generators):
                return {each for one in generators for each in self._objects(one.iter, function)}
        return set()

    # What statements write.

    def _add(self, node: ast.AST, function: Function) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._set(target, value, node, function)
            case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
                self._set(target, value, node, function)
            case ast.AugAssign(target=target, value=value):
                self._set(target, value, node, function)
            case ast.For(target=target, iter=value) | ast.comprehension(target=target, iter=value):
                self._set(target, value, node, function)
            case ast.withitem(context_expr=value, optional_vars=ast.expr() as target):
                self._set(target, value, node, function)
            case ast.Delete(targets=targets):
                for target in targets:
                    self._set(target, None, node, function)
            case ast.Return(value=value):
                needed = self._reads(value, function) | self._around(node, function)
                self._needs[function] |= needed
                self._writes[function].append((node, value, function))
                self._aliases[function] |= self._objects(value, function)
            case ast.Call():
                self._call(node, function)

    def _set(self, target: ast.expr, value: ast.expr | None, node: ast.AST, function: Function) -> None:
        if isinstance(target, ast.Tuple | ast.List):
            parts = value.elts if isinstance(value, ast.Tuple | ast.List) else []
            pairs = parts if len(parts) == len(target.elts) else [value] * len(target.elts)
            for one, each in zip(target.elts, pairs, strict=True):
                self._set(one, each, node, function)
            return
        if isinstance(target, ast.Starred):
            target = target.value
        needed = self._reads(value, function) | self._around(node, function)
        if isinstance(target, ast.Subscript):
            needed |= self._reads(target.slice, function)
            self._change(root(target), needed, value, node, function)
        elif isinstance(target, ast.Name):
            name = self._name(target.id, function)
            self._needs[name] |= needed
            self._aliases[name] |= self._objects(value, function)
            self._writes[name].append((node, value, function))
            if isinstance(node, ast.AugAssign):
                self._change(target, needed, value, node, function)
        elif isinstance(target, ast.Attribute):
            self._needs[f".{target.attr}"] |= needed | self._reads(target.value, function)
            self._aliases[f".{target.attr}"] |= self._objects(value, function)
            self._writes[f".{target.attr}"].append((node, value, function))

    def _change(
        self, changed: ast.expr, needed: set[Node], value: ast.expr | None, node: ast.AST, function: Function
    ) -> None:
        """Note that an object changes in place."""
        for each in self._objects(changed, function):
            self._needs[each] |= needed
            self._writes[each].append((node, value, function))
            self._changed.append((each, needed, (node, value, function)))

    def _call(self, call: ast.Call, function: Function) -> None:
        given = [*call.args, *(keyword.value for keyword in call.keywords)]
        around = self._around(call, function)
        called = self._called(call)
        for one in called:
            self._calls[one].append((call, function))
            self._needs[one, ""] |= around
            known = dict(arguments(call, one))
            for name in one.parameters:
                values = [known[name]] if name in known else given if call.keywords or call.args else []
                for value in values:
                    self._needs[one, name] |= self._reads(value, function)
                    self._aliases[one, name] |= self._objects(value, function)
        if called:
            return
        needed = around | {each for one in given for each in self._reads(one, function)}
        owner = call.func.value if isinstance(call.func, ast.Attribute) else None
        path = self.program.path(call.func, function)
        if owner is not None and not path:
            draws = "random" in name_of(owner).lower() or "rng" in name_of(owner).lower()
            if name_of(call) not in _READERS and not draws:
                self._change(root(owner), needed, call, call, function)
        if (
            call.args
            and (owner is None or path or name_of(call) == "shuffle")
            and (isinstance(self.program.parents[call], ast.Expr) or name_of(call) in _TAKING)
        ):
            # Functions of libraries change their first argument, if any.
            self._change(root(call.args[0]), needed, call, call, function)

    def _around(self, node: ast.AST, function: Function) -> set[Node]:
        """What decides whether a node runs."""
        found: set[Node] = {(function, "")}
        for test, _ in self._guards(node, function):
            found |= self._reads(test, function)
        for loop in self._loops(node, function):
            found |= self._reads(loop.iter, function) if isinstance(loop, ast.For) else set()
        loops = set(self._loops(node, function))
        for leave in self._exits(function):
            if line(leave) < line(node) or not loops.isdisjoint(self._loops(leave, function)):
                for test, _ in self._guards(leave, function):
                    found |= self._reads(test, function)
        return found

    def _exits(self, function: Function) -> list[ast.AST]:
        leaving = (ast.Return, ast.Raise, ast.Break, ast.Continue)
        return [node for node in function.nodes if isinstance(node, leaving)]

    def _loops(self, node: ast.AST, function: Function) -> Iterator[ast.AST]:
        while node is not function.node:
            if isinstance(node, ast.For | ast.While):
                yield node
            node = self.program.parents[node]

    def _guards(self, node: ast.AST, function: Function) -> Iterator[tuple[ast.expr, bool]]:
        return guards(self.program, node, function)

    def _spread_changes(self) -> None:
        """A change in place reaches each name of the object."""
        for start, needed, write in self._changed:
            seen: set[Node] = {start}
            waiting = [start]
            while waiting:
                for other in self._aliases.get(waiting.pop(), ()):
                    if other not in seen:
                        seen.add(other)
                        waiting.append(other)
                        self._needs[other] |= needed
                        self._writes[other].append(write)

    def _closure(self, nodes: Iterable[Node]) -> set[Node]:
        found = set(nodes)
        waiting = list(found)
        while waiting:
            one = waiting.pop()
            needed = self._needs.get(one, set())
            if isinstance(one, tuple) and one[0] is not None:
                needed = needed | {(one[0], "")}
            new = needed - found
            found |= new
            waiting += new
        return found

    def _direct(self, places: Iterable[tuple[ast.expr | None, Function]], fixed: bool = False) -> set[str]:
        """The attributes of which expressions are made, through names and results: with or without fixed ones."""
        found: set[Node] = {each for value, function in places for each in self._reads(value, function)}
        waiting = [each for each in found if not isinstance(each, str)]
        while waiting:
            new = {each for each in self._needs.get(waiting.pop(), ()) if not runs(each)} - found
            found |= new
            waiting += [each for each in new if not isinstance(each, str)]
        return {each for each in found if isinstance(each, str) and (fixed or each in self._needs)}


def guards(program: Program, node: ast.AST, function: Function) -> Iterator[tuple[ast.expr, bool]]:
    """The tests around a node, and whether they hold there."""
    while node is not function.node:
        parent = program.parents[node]
        match parent:
            case ast.If(test=test, orelse=orelse) if test is not node:
                yield test, node not in orelse
            case ast.While(test=test) if test is not node:
                yield test, True
            case ast.IfExp(test=test, orelse=orelse) if test is not node:
                yield test, node is not orelse
            case ast.Match(subject=subject) if subject is not node:
                yield subject, True
            case ast.match_case(guard=ast.expr() as test) if test is not node:
                yield test, True
        node = parent


def is_local(node: Node) -> bool:
    return isinstance(node, tuple) and node[0] is not None


def runs(node: Node) -> bool:
    return isinstance(node, tuple) and node[1] == ""
