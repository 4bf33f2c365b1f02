"""Orders that depend on PYTHONHASHSEED or on addresses in memory."""

from __future__ import annotations

import ast
from collections.abc import Callable, Collection, Iterable, Iterator

from .program import Function, Program, Suspect, arguments, line, name_of

#: A file without these has no set, and no hash that it uses itself.
_WORDS = frozenset({"frozenset", "hash", "id", "set"})
#: Functions and methods whose result does not depend on the order of their argument.
_ORDERLESS = frozenset({
    "Counter", "all", "any", "dict", "difference", "difference_update", "frozenset", "fromkeys", "fsum", "intersection",
    "isdisjoint", "issubset", "issuperset", "len", "max", "min", "set", "sorted", "sum", "symmetric_difference",
    "union", "update",
})  # fmt: skip
#: Functions that make a list or a tuple of what an iterable gives.
_LISTS = frozenset({"list", "sorted", "tuple"})
_COPIES = frozenset({"copy", "difference", "intersection", "symmetric_difference", "union"})
_ENUMS = frozenset({"Enum", "Flag", "StrEnum"})
_TEXT = frozenset({"capitalize", "format", "join", "lower", "replace", "repr", "str", "strip", "title", "upper"})
#: Calls of a loop's body that make the order of its turns matter.
_ORDERED = frozenset({"append", "appendleft", "blit", "extend", "insert", "put"})


def orders(program: Program) -> Iterator[Suspect]:
    """Find sets of strings or objects whose order play uses, and hash() or id() as a number."""
    if not any(
        isinstance(node, ast.Set | ast.SetComp) or (isinstance(node, ast.Name) and node.id in _WORDS)
        for node in program.nodes
    ):
        return
    sets = _Sets(program)
    places: list[tuple[Function | None, list[ast.AST]]] = [(None, program.module_nodes)]
    for function, nodes in [*places, *((function, function.nodes) for function in program.all)]:
        for node in nodes:
            if (
                isinstance(node, ast.expr)
                and (kind := sets.holds(node, function))
                and _ordered(program, function, node)
            ):
                yield Suspect(line(node), f"uses the order of a set of {kind}: {ast.unparse(node)[:40]}")
            elif (
                isinstance(node, ast.Call)
                and len(node.args) == 1
                and not (function and function.name in ("__eq__", "__hash__"))
            ):
                name = program.path(node.func, function)
                if name == "builtins.hash" and (kind := sets.element(node.args[0], function)):
                    yield Suspect(line(node), f"uses the hash of {kind} as a number: {ast.unparse(node)[:40]}")
            elif (
                isinstance(node, ast.keyword)
                and node.arg == "key"
                and program.path(node.value, function) == "builtins.hash"
            ):
                yield Suspect(line(node.value), "sorts by hash()")
    yield from addresses(program)


def addresses(program: Program) -> Iterator[Suspect]:
    """Find uses of id() as a number or an order."""
    places: list[tuple[Function | None, list[ast.AST]]] = [(None, program.module_nodes)]
    for function, nodes in [*places, *((function, function.nodes) for function in program.all)]:
        for node in nodes if function is None or function.name not in ("__eq__", "__hash__") else ():
            match node:
                case ast.Call(func=func, args=[_]) if program.path(func, function) == "builtins.id":
                    if isinstance(program.parents[node], ast.BinOp):
                        yield Suspect(line(node), f"calculates with an address in memory: {ast.unparse(node)[:40]}")
                case ast.keyword(arg="key", value=value) if program.path(value, function) == "builtins.id":
                    yield Suspect(line(value), "sorts by id()")


def turns(program: Program, kinds: Collection[str]) -> Iterator[Suspect]:
    """Find every use of a set that may depend on its order, once play has shown that some order matters.

    Args:
        program: the file.
        kinds: what the sets hold. Sets of what the file does not tell count if there are no others.
    """
    sets = _Sets(program)
    known, unknown = [], []
    for function in (None, *program.all):
        for node in function.nodes if function is not None else program.module_nodes:
            if isinstance(node, ast.expr) and _in_order(program, node):
                kind = sets.holds(node, function)
                if kind in kinds:
                    known.append(Suspect(line(node), f"may use the order of a set of {kind}: {ast.unparse(node)[:40]}"))
                elif not kind and _may_vary(program, node, function):
                    unknown.append(Suspect(line(node), f"may use the order of a set: {ast.unparse(node)[:40]}"))
    yield from known or unknown


class _Sets:
    """Which expressions are sets whose order varies, because they hold strings, or objects hashed by address."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self._open: set[ast.AST] = set()
        self._parameters: dict[tuple[str, Function], str] = {}
        self._keys: dict[str, str] = {}

    def holds(self, node: ast.AST | None, function: Function | None) -> str:
        """What a set holds: "strings", "objects" or "members of an enumeration"; "" for another order or no set."""
        match node:
            case ast.Set(elts=elts):
                return self._first(elts, function)
            case ast.SetComp(elt=elt):
                return self.element(elt, function)
            case ast.Call(func=ast.Name(id="set" | "frozenset"), args=[one]):
                return self.items(one, function)
            case ast.Call(func=ast.Attribute(attr=attr, value=value)) if attr in _COPIES:
                return self.holds(value, function)
            case ast.BinOp(op=ast.BitOr() | ast.BitAnd() | ast.Sub() | ast.BitXor(), left=left):
                return self.holds(left, function)
            case ast.Name(ctx=ast.Load()) | ast.Attribute(ctx=ast.Load()):
                return self._of_values(node, function)
        return ""

    def _of_values(self, node: ast.AST, function: Function | None) -> str:
        values = self.program.values(node, function)
        empty = [value for value, _ in values if _empty_set(value)]
        kinds = [self._once(value, one, self.holds) for value, one in values if not _empty_set(value)]
        if not values or "" in kinds:
            return ""
        return kinds[0] if kinds else self._once(empty[0], function, lambda _, one: self._added(node, one))

    def _added(self, node: ast.AST, function: Function | None) -> str:
        """What add() puts into a set."""
        if function is None:
            return ""
        field = function.field(node)
        places = self.program.methods(self.program.bound_to(function)) if field else [function]
        for one in places:
            for call in one.nodes:
                match call:
                    case ast.Call(func=ast.Attribute(attr="add", value=value), args=[item]):
                        same = (
                            one.field(value) == field
                            if field
                            else name_of(value) == name_of(node) and isinstance(value, ast.Name)
                        )
                        if same and (kind := self.element(item, one)):
                            return kind
        return ""

    def element(self, node: ast.AST | None, function: Function | None) -> str:
        """The kind of one value, if its hash varies."""
        match node:
            case ast.Constant(value=str()) | ast.JoinedStr():
                return "strings"
            case ast.Tuple(elts=elts):
                return self._first(elts, function)
            case ast.Call(func=ast.Name(id=name)) if name in self.program.classes:
                return "objects" if self._hashed_by_address(name) else ""
            case ast.Call() if name_of(node) in _TEXT:
                return "strings"
            case ast.Attribute(value=ast.Name(id=name)) if name in self.program.classes and node.attr.isupper():
                return self._members(name)
            case ast.Name(ctx=ast.Load()):
                kinds = [
                    self._once(value, one, self.element)
                    for value, one in self.program.values(node, function)
                    if value is not None
                ]
                loops = [
                    loop.iter
                    for loop in (function.nodes if function else ())
                    if isinstance(loop, ast.For | ast.comprehension) and name_of(loop.target) == node.id
                ]
                kinds += [self._once(one, function, self.items) for one in loops]
                if function is not None and node.id in function.parameters:
                    kinds.append(self._given(node.id, function))
                return kinds[0] if kinds and all(kinds) else ""
            case ast.Subscript(value=value, ctx=ast.Load()):
                values = self.program.values(value, function)
                items = [self._item(one, where, node.slice) for one, where in values]
                return items[0] if items and all(items) else ""
        return ""

    def _item(self, node: ast.AST | None, function: Function | None, index: ast.expr) -> str:
        """The kind of an item of a list: by its index, if the list is written out, or of any."""
        if isinstance(index, ast.Slice):
            return ""
        match node:
            case ast.Call(func=ast.Name(id="list" | "tuple"), args=[ast.List() | ast.Tuple() as written]):
                return self._item(written, function, index)
            case ast.Call(func=ast.Name(id=name)) if name in _LISTS:
                return self._once(node, function, self.items)
        if not isinstance(node, ast.List | ast.Tuple):
            return ""
        items = node.elts
        if isinstance(index, ast.Constant):
            known = isinstance(index.value, int) and index.value < len(items)
            items = [items[index.value]] if known and isinstance(index.value, int) else []
        kinds = [self._once(one, function, self.element) for one in items]
        return kinds[0] if kinds and all(kinds) else ""

    def _given(self, parameter: str, function: Function) -> str:
        """The kind of what the calls of a function give for one of its parameters."""
        if (parameter, function) not in self._parameters:
            # A function may call itself.
            self._parameters[parameter, function] = ""
            kinds = [self._once(one, caller, self.element) for one, caller in self._passed(parameter, function)]
            self._parameters[parameter, function] = kinds[0] if kinds and all(kinds) else ""
        return self._parameters[parameter, function]

    def _passed(self, parameter: str, function: Function) -> Iterator[tuple[ast.expr, Function]]:
        """What the calls of a function give for one of its parameters, and where."""
        for caller in self.program.all:
            for node in caller.nodes:
                if isinstance(node, ast.Call) and self.program.called(node, caller) is function:
                    yield from ((value, caller) for name, value in arguments(node, function) if name == parameter)

    def items(self, node: ast.AST | None, function: Function | None) -> str:
        """The kind of what an iterable gives."""
        match node:
            case ast.Constant(value=str()):
                return "strings"
            case ast.List(elts=elts) | ast.Tuple(elts=elts):
                return self._first(elts, function)
            case ast.Dict(keys=keys):
                return self._first([key for key in keys if key is not None], function)
            case ast.ListComp(elt=elt) | ast.GeneratorExp(elt=elt):
                return self.element(elt, function)
            case ast.Call(func=ast.Attribute(attr="keys", value=value)):
                return self.items(value, function)
            case ast.Call(func=ast.Name(id=name), args=[one]) if name in _LISTS:
                return self.items(one, function)
            case ast.Subscript(slice=ast.Constant(value=str() as key)):
                return self._under(key)
            case ast.Subscript(value=value, slice=ast.Slice()):
                return self.items(value, function)
            case ast.Name(id=name) if name in self.program.classes:
                return self._members(name)
            case ast.Name() | ast.Attribute():
                kinds = [self._once(value, one, self.items) for value, one in self.program.values(node, function)]
                if kinds and all(kinds):
                    return kinds[0]
        return self.holds(node, function)

    def _under(self, key: str) -> str:
        """The kind of the items that the dicts of this file hold under a key; "" unless all hold the same kind."""
        if key not in self._keys:
            given = list(self._given_under(key))
            # A value may depend on another value of the key.
            self._keys[key] = ""
            known = [kind for value, function in given if (kind := self._once(value, function, self.items))]
            if known:
                self._keys[key] = known[0]
                if any(self._once(value, function, self.items) != known[0] for value, function in given):
                    self._keys[key] = ""
        return self._keys[key]

    def _given_under(self, key: str) -> Iterator[tuple[ast.expr, Function | None]]:
        """The values that the file stores under a key of any dict, and where."""
        for function in (None, *self.program.all):
            for node in function.nodes if function is not None else self.program.module_nodes:
                match node:
                    case ast.Dict(keys=keys, values=values):
                        for one, value in zip(keys, values, strict=True):
                            if isinstance(one, ast.Constant) and one.value == key:
                                yield value, function
                    case ast.Assign(targets=targets, value=value):
                        for target in targets:
                            match target:
                                case ast.Subscript(slice=ast.Constant(value=stored)) if stored == key:
                                    yield value, function

    def _members(self, name: str) -> str:
        """The kind of the members of a class, if that is an enumeration whose members are hashed by their names."""
        bases = {name_of(base) for one in self.program.lineage(name) for base in self.program.classes[one].bases}
        return "members of an enumeration" if bases & _ENUMS and "int" not in bases else ""

    def _first(self, nodes: Iterable[ast.AST], function: Function | None) -> str:
        """One value whose hash varies is enough to vary the order of all."""
        return next((kind for node in nodes if (kind := self.element(node, function))), "")

    def _once(
        self, node: ast.AST | None, function: Function | None, look: Callable[[ast.AST, Function | None], str]
    ) -> str:
        """Look at a value, unless this value is being looked at: names may be bound to each other."""
        if node is None or node in self._open:
            return ""
        self._open.add(node)
        try:
            return look(node, function)
        finally:
            self._open.remove(node)

    def _hashed_by_address(self, name: str) -> bool:
        lineage = self.program.lineage(name)
        nodes = [self.program.classes[one] for one in lineage]
        known = all(name_of(base) in (*lineage, "object", "ABC") for node in nodes for base in node.bases)
        own = any(self.program.method(name, one) for one in ("__hash__", "__eq__"))
        return known and not own and not any(node.decorator_list for node in nodes)


def _empty_set(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "set" and not node.args


def _may_vary(program: Program, node: ast.AST, function: Function | None, depth: int = 4) -> bool:
    """Whether an expression may be a set, other than one of numbers."""
    match node:
        case ast.Set(elts=elts):
            return not all(isinstance(one, ast.Constant) and not isinstance(one.value, str) for one in elts)
        case ast.SetComp() | ast.Call(func=ast.Name(id="set" | "frozenset")):
            return True
        case ast.Call(func=ast.Attribute(attr=attr, value=inner)) if attr in _COPIES:
            return depth > 0 and _may_vary(program, inner, function, depth - 1)
        case ast.BinOp(op=ast.BitOr() | ast.BitAnd() | ast.Sub() | ast.BitXor(), left=inner):
            return depth > 0 and _may_vary(program, inner, function, depth - 1)
        case ast.Name(ctx=ast.Load()) | ast.Attribute(ctx=ast.Load()):
            known = [(value, one) for value, one in program.values(node, function) if value is not None]
            return depth > 0 and any(_may_vary(program, value, one, depth - 1) for value, one in known)
    return False


def _in_order(program: Program, node: ast.AST) -> bool:
    """Whether the code around an expression takes its items one after the other."""
    parent = program.parents[node]
    match parent:
        case ast.For(iter=iterated) | ast.comprehension(iter=iterated):
            return iterated is node
        case ast.Call(args=args, keywords=keywords) if node in args:
            # The first of equal items depends on the order.
            return name_of(parent) not in _ORDERLESS or any(one.arg == "key" for one in keywords)
        case ast.Attribute(attr="pop"):
            return isinstance(program.parents[parent], ast.Call)
    return isinstance(parent, ast.Starred)


def _ordered(program: Program, function: Function | None, node: ast.AST) -> bool:
    """Whether the code around an expression uses the order of its items."""
    parent = program.parents[node]
    match parent:
        case ast.For(iter=iterated) if iterated is node:
            return _order_of_turns(parent, _sorted_names(program, function))
        case ast.comprehension(iter=iterated) if iterated is node:
            whole = program.parents[parent]
            if not _uses_items(parent, [whole]):
                return False
            if any(map(_draws, ast.walk(whole))):
                return True
            return isinstance(whole, ast.ListComp | ast.GeneratorExp) and _matters(program, function, whole)
        case ast.Call(func=ast.Name(id="list" | "tuple" | "iter" | "enumerate")):
            return node in parent.args and _matters(program, function, parent)
        case ast.Call(func=ast.Name(id="zip"), args=args):
            # Each item belongs to the one at the same place of another iterable.
            return node in args and any(name_of(one) != "repeat" for one in args if one is not node)
        case ast.Call(func=ast.Attribute(attr="choice" | "shuffle" | "join" | "sample")):
            return node in parent.args
        case ast.Attribute(attr="pop") if isinstance(program.parents[parent], ast.Call):
            return True
        case ast.Starred():
            return isinstance(program.parents[parent], ast.List | ast.Tuple)
    return False


def _matters(program: Program, function: Function | None, node: ast.AST) -> bool:
    """Whether the order of a list, a tuple or an iterator matters where it is used."""
    parent = program.parents[node]
    match parent:
        case ast.Call() if node in parent.args:
            return name_of(parent) not in _ORDERLESS
        case ast.For():
            return _order_of_turns(parent, _sorted_names(program, function))
        case ast.Compare():
            return False
        case ast.comprehension():
            whole = program.parents[parent]
            return _uses_items(parent, [whole]) and _matters(program, function, whole)
        case ast.Assign(targets=[ast.Name(id=name)]):
            return name not in _sorted_names(program, function)
    return True


def _sorted_names(program: Program, function: Function | None) -> set[str]:
    """The names of lists that a function, or the module, sorts in place."""
    nodes = function.nodes if function else program.module_nodes
    return {name_of(node.value) for node in nodes if isinstance(node, ast.Attribute) and node.attr == "sort"}


def _order_of_turns(loop: ast.For, sorted_names: set[str]) -> bool:
    """Whether the order of a loop's turns matters; not to what is put into a list that is sorted."""
    if not _uses_items(loop, loop.body):
        return False
    if _numbers(loop):
        return True
    for node in (inner for statement in loop.body for inner in ast.walk(statement)):
        if isinstance(node, ast.Break | ast.Return | ast.Yield):
            return True
        if _draws(node):
            return True
        if isinstance(node, ast.Call) and name_of(node) in _ORDERED:
            target = node.func.value if isinstance(node.func, ast.Attribute) else None
            if not (isinstance(target, ast.Name) and target.id in sorted_names):
                return True
        if isinstance(node, ast.Call) and not node.args and name_of(node) in ("pop", "popleft"):
            # Each turn takes the next item of another collection.
            return True
    return False


def _numbers(loop: ast.For) -> bool:
    """Whether a loop numbers its turns and uses the numbers."""
    match loop:
        case ast.For(iter=ast.Call(func=ast.Name(id="enumerate")), target=ast.Tuple(elts=[ast.Name(id=number), _])):
            read = (one for part in loop.body for one in ast.walk(part) if isinstance(one, ast.Name))
            return any(one.id == number and isinstance(one.ctx, ast.Load) for one in read)
    return False


def _uses_items(loop: ast.For | ast.comprehension, body: Iterable[ast.AST]) -> bool:
    """Whether the body of a loop uses the items, and not only their number."""
    target = loop.target
    if isinstance(loop.iter, ast.Call) and name_of(loop.iter) == "enumerate" and isinstance(target, ast.Tuple):
        target = target.elts[-1]
    names = {one.id for one in ast.walk(target) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
    read = (
        one for part in body for one in ast.walk(part) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load)
    )
    # What is no plain name, such as self.x, may be read anywhere.
    return not isinstance(target, ast.Name | ast.Tuple) or any(one.id in names for one in read)


def _draws(node: ast.AST) -> bool:
    """Whether a call draws from what is named like a generator."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
        return False
    owner = name_of(node.func.value).lower()
    return "random" in owner or "rng" in owner
