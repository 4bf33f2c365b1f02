"""Whether play uses a value: the value decides something, is a result, or goes where the file does not show it.

Flow finds what a value surely reaches. Here a value counts as used unless all that becomes of it is known.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cached_property

from .flow import KEEPS, NEUTRAL
from .program import MUTATORS, Function, Program, arguments, name_of, root

#: Attributes that Gymnasium reads.
_READ_BY_GYMNASIUM = frozenset({
    "_np_random", "action_space", "metadata", "np_random", "observation_space", "render_mode", "reward_range", "spec",
})  # fmt: skip
#: Libraries whose calls, if nothing takes their result, write files or log.
_LOGGING = ("logging.", "os.", "warnings.")
_CONTAINERS = frozenset({
    "Counter", "OrderedDict", "defaultdict", "deque", "dict", "empty", "full", "list", "ones", "set", "zeros",
})  # fmt: skip
#: Calls that take the environment and do not keep it. What getattr() reads is known.
_HARMLESS = frozenset({"__init__", "getattr", "hasattr", "id", "isinstance", "print", "setattr", "super", "type"})
#: A node, and the function that it is in; None for the module.
_Place = tuple[ast.AST, Function | None]


class Usage:
    """Follows values of a file.

    Args:
        program: the file.
        told: whether a value that only ``info`` tells is used.
    """

    def __init__(self, program: Program, *, told: bool = True) -> None:
        self.program = program
        self._told = told
        self._waiting: list[_Place] = []
        self._followed: set[object] = set()

    def is_used(self, node: ast.AST, function: Function | None) -> bool:
        """Whether play may use the value of a node.

        Args:
            node: an expression.
            function: which contains it; None for the module.
        """
        if not self.program.env:
            # Another file uses what this one defines.
            return True
        self._waiting, self._followed = [(node, function)], set()
        while self._waiting:
            if self._ends_in_use(*self._waiting.pop()):
                return True
        return False

    @cached_property
    def _loads(self) -> dict[str, list[tuple[ast.Name | ast.Attribute, Function | None]]]:
        """The places that read a name or an attribute."""
        found = defaultdict(list)
        for node, function in self._places:
            if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
                found[node.id if isinstance(node, ast.Name) else node.attr].append((node, function))
        return found

    @cached_property
    def _places(self) -> list[_Place]:
        functions = self.program.all
        inner = [(node, function) for function in functions for node in function.nodes]
        return [*((node, None) for node in self.program.module_nodes), *inner]

    @cached_property
    def _given_away(self) -> tuple[bool, bool]:
        """Whether the environment itself is known under another name in the file, and whether another file knows it."""
        inside = outside = False
        for node, function in self._places:
            if function is None or not isinstance(node, ast.Name) or node.id != function.me:
                continue
            parent = self.program.parents[node]
            if isinstance(parent, ast.Attribute) or self.program.bound_to(function) != self.program.env:
                continue
            call = self.program.parents[parent] if isinstance(parent, ast.keyword) else parent
            if not isinstance(call, ast.Call):
                inside = True
            elif name_of(call) not in _HARMLESS and not self.program.path(call.func, function).startswith("gym"):
                known = self.program.called(call, function) is not None or name_of(call) in self.program.classes
                inside, outside = inside or known, outside or not known
        return inside, outside

    @cached_property
    def _read_by_name(self) -> set[str]:
        """The attributes that play reads by ``getattr``; "" stands for those whose names the code does not show."""
        found = set()
        for node, _ in self._places:
            match node:
                case ast.Call(func=ast.Name(id="getattr"), args=[_, name, *_]):
                    found.add(str(name.value) if isinstance(name, ast.Constant) else "")
                case ast.Call(func=ast.Name(id="vars")) | ast.Attribute(attr="__dict__"):
                    found.add("")
        return found

    @cached_property
    def _set_by_reset(self) -> set[str]:
        """The attributes that every reset() sets before anything may read them."""
        found: set[str] = set()
        read: set[str] = set()
        if (reset := self.program.method(self.program.env, "reset")) is None:
            return found
        for statement in reset.node.body:
            nodes = list(ast.walk(statement))
            if any(isinstance(one, ast.Call) and self.program.called(one, reset) is not None for one in nodes):
                break
            read |= {reset.field(one) for one in nodes if isinstance(getattr(one, "ctx", None), ast.Load)}
            if isinstance(statement, ast.Assign):
                found |= {reset.field(target) for target in statement.targets} - read
        return found - {""}

    def _ends_in_use(self, node: ast.AST, function: Function | None) -> bool:
        """Whether the statement around a value uses it. Where it goes on from there is put on the waiting list."""
        while True:
            parent = self.program.parents[node]
            match parent:
                case ast.Expr():
                    return not isinstance(node, ast.Attribute | ast.Call | ast.Name | ast.NamedExpr)
                case ast.Call(func=func) if func is node:
                    if name_of(func) == "shuffle" or any(keyword.arg == "out" for keyword in parent.keywords):
                        return True
                case ast.Call():
                    if (used := self._is_used_by(parent, node, function)) is not None:
                        return used
                case ast.Subscript(ctx=ast.Store() | ast.Del(), value=value):
                    # A drawn place in a container.
                    return value is not node and self._is_kept(value, function)
                case ast.Attribute(ctx=ast.Store() | ast.Del()):
                    return False
                case ast.Assign(targets=targets):
                    return self._is_used_from(ast.Tuple(targets), function)
                case ast.AnnAssign(target=target) | ast.AugAssign(target=target):
                    return self._is_used_from(target, function)
                case ast.NamedExpr(target=target):
                    if self._is_used_from(target, function):
                        return True
                case ast.Return():
                    return self._is_used_after(parent, function)
                case ast.Tuple(elts=[*_, info]) if info is node and self._is_result(parent, function):
                    return self._told
                case ast.If(test=test, body=body, orelse=orelse) if test is node:
                    return not all(map(_only_logs, [*body, *orelse]))
                case ast.comprehension(target=target):
                    if self._is_used_from(target, function):
                        return True
                    node = parent
                    continue
                case ast.BoolOp() | ast.IfExp() | ast.ListComp() | ast.SetComp() | ast.GeneratorExp() | ast.DictComp():
                    if self._acts(parent, function):
                        return True
                case (
                    ast.Attribute() | ast.BinOp() | ast.Compare() | ast.Dict() | ast.FormattedValue() | ast.JoinedStr()
                    | ast.List() | ast.Set() | ast.Slice() | ast.Starred() | ast.Subscript() | ast.Tuple()
                    | ast.UnaryOp() | ast.keyword()
                ):  # fmt: skip
                    pass
                case _:
                    return True
            node = parent

    def _is_result(self, node: ast.Tuple, function: Function | None) -> bool:
        """Whether a tuple is what step() or reset() returns."""
        returned = isinstance(self.program.parents[node], ast.Return)
        return returned and function is not None and function.name in ("reset", "step")

    def _is_used_by(self, call: ast.Call, given: ast.AST, function: Function | None) -> bool | None:
        """Whether a call uses what it is given; None if only its result may hold it."""
        called = self.program.called(call, function) if function is not None else None
        name, alone = name_of(call), isinstance(self.program.parents[call], ast.Expr)
        if name == "reset" and function not in self.program.play:
            # Whoever plays calls reset() again.
            return False
        if called is not None:
            parameters = [parameter for parameter, value in arguments(call, called) if value in ast.walk(given)]
            for parameter in parameters:
                self._follow_name(parameter, called)
            return not parameters or called not in self.program.all
        if isinstance(call.func, ast.Attribute) and name in KEEPS:
            return self._is_kept(call.func.value, function)
        path = self.program.path(call.func, function)
        if alone:
            own = any(self.program.method(owner, name) for owner in self.program.classes)
            return own or not (name in NEUTRAL or path.startswith(_LOGGING))
        text = isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Constant | ast.JoinedStr)
        return None if path or text else True

    def _is_used_from(self, target: ast.AST, function: Function | None) -> bool:
        """Whether a value is used that a target takes, as far as that shows here."""
        match target:
            case ast.Tuple(elts=elts) | ast.List(elts=elts):
                return any(self._is_used_from(one, function) for one in elts)
            case ast.Starred(value=value):
                return self._is_used_from(value, function)
            case ast.Subscript(value=value):
                return self._is_kept(value, function)
            case ast.Name(id=name):
                if function is not None and name not in function.local:
                    return True
                self._follow_name(name, function)
                return False
        if function is None or not (field := function.field(target)):
            return True
        if field in self._set_by_reset and function not in self.program.play:
            return False
        return self._is_read_elsewhere(field, function)

    def _is_kept(self, container: ast.expr, function: Function | None) -> bool:
        """Whether a value is used that goes into a container: only one that nothing else refers to is known."""
        held = root(container)
        if not self._told and name_of(held) == "info":
            return False
        if function is None or not (isinstance(held, ast.Name) or function.field(held)):
            return True
        values = self.program.values(held, function)
        if not values or not all(creates(value) for value, _ in values):
            return True
        return self._is_used_from(held, function)

    def _is_read_elsewhere(self, field: str, function: Function) -> bool:
        """Whether an attribute may be read in a way that is not followed; all other reads are."""
        program, owner = self.program, self.program.bound_to(function)
        if (owner, field) in self._followed:
            return False
        self._followed.add((owner, field))
        own = owner == program.env
        inside, outside = self._given_away if own else (True, False)
        if outside or program.has_unknown_base(owner) or not self._read_by_name.isdisjoint(("", field)):
            return True
        if program.method(owner, field) is not None or (own and field in _READ_BY_GYMNASIUM):
            return True
        for node, reader in self._loads[field]:
            if not isinstance(node, ast.Attribute):
                continue
            if reader is None or not reader.field(node):
                if inside:
                    return True
            elif self._same(program.bound_to(reader), owner):
                self._waiting.append((node, reader))
        return False

    def _is_used_after(self, node: ast.Return, function: Function | None) -> bool:
        """Whether the result of a function is used, as far as that shows here."""
        inner: ast.AST = node
        while not isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            inner = self.program.parents[inner]
        if function is None or inner is not function.node or function.name in ("reset", "step", "__init__"):
            return True
        if function.owner and function.owner not in self.program.lineage(self.program.env):
            return True
        if function in self._followed:
            return False
        self._followed.add(function)
        for reference, reader in self._loads[function.name]:
            if isinstance(reference, ast.Name) == bool(function.owner):
                continue
            if isinstance(reference, ast.Attribute) and not (reader is not None and reader.field(reference)):
                return True
            self._waiting.append((reference, reader))
        return False

    def _follow_name(self, name: str, function: Function | None) -> None:
        if (name, function) in self._followed:
            return
        self._followed.add((name, function))
        for node, reader in self._loads[name]:
            reads = reader is function or (function is None and reader is not None and name not in reader.local)
            if isinstance(node, ast.Name) and reads:
                self._waiting.append((node, reader))

    def _same(self, one: str, two: str) -> bool:
        return one in self.program.lineage(two) or two in self.program.lineage(one)

    def _acts(self, node: ast.AST, function: Function | None) -> bool:
        """Whether an expression calls what may do more than calculate."""
        return any(
            isinstance(one, ast.Call)
            and (name_of(one) in MUTATORS or function is None or self.program.called(one, function) is not None)
            for one in ast.walk(node)
        )


def creates(node: ast.expr | None) -> bool:
    """Whether an expression creates a container."""
    if isinstance(node, ast.Call):
        return name_of(node) in _CONTAINERS
    if isinstance(node, ast.BinOp):
        return creates(node.left) or creates(node.right)
    return isinstance(node, ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp | ast.SetComp)


def _only_logs(node: ast.stmt) -> bool:
    match node:
        case ast.If(body=body, orelse=orelse):
            return all(map(_only_logs, [*body, *orelse]))
        case ast.Expr(value=ast.Call() as call):
            return name_of(call) in NEUTRAL
    return isinstance(node, ast.Pass)
