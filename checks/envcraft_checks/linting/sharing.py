"""Objects that episodes, instances or the caller share although each needs its own."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, arguments, line, name_of, root
from .usage import Usage

_CONTAINERS = frozenset({
    "Counter", "OrderedDict", "array", "bytearray", "defaultdict", "deque", "dict", "empty", "full", "list", "ones",
    "set", "zeros",
})  # fmt: skip
_CACHES = frozenset({"cache", "cached_property", "lru_cache"})
#: Methods that run once, on a new object.
_CONSTRUCTORS = frozenset({"__init__", "__post_init__"})
_VIEWS = frozenset({"asarray", "ravel", "reshape", "squeeze", "swapaxes", "transpose", "view"})


def shared(program: Program) -> Iterator[Suspect]:
    """Find default arguments, class attributes, globals of the module and caches that play writes."""
    usage = Usage(program)
    for function in program.all:
        yield from _defaults(program, function)
        yield from _class_level(program, function, usage)
        yield from _module_level(program, function, usage)
    yield from _caches(program)
    yield from _serial_numbers(program)


def _mutable(node: ast.AST | None) -> bool:
    if isinstance(node, ast.Call):
        return name_of(node) in _CONTAINERS
    return isinstance(node, ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp | ast.SetComp)


def _defaults(program: Program, function: Function) -> Iterator[Suspect]:
    arguments = function.node.args
    positional = [*arguments.posonlyargs, *arguments.args]
    pairs = [
        *zip(positional[::-1], arguments.defaults[::-1], strict=False),
        *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True),
    ]
    for parameter, default in pairs:
        name = parameter.arg
        if not _mutable(default) or any(
            name_of(target) == name and isinstance(target, ast.Name) for target, _, _ in function.bindings
        ):
            continue
        written = [
            node
            for target, node in function.writes
            if isinstance(target, ast.Name) and target.id == name and not _caches_alone(program, function, name, node)
        ]
        for target, value, _ in function.bindings:
            field = function.field(target)
            if (
                field
                and isinstance(value, ast.Name)
                and value.id == name
                and len(program.values(target, function)) == 1
            ):
                written += [node for one in program.all for place, node in one.writes if one.field(place) == field]
        if any(isinstance(node, ast.Return) and _is_same(node.value, name) for node in function.nodes):
            written += _writes_to_result(program, function)
        if written:
            yield Suspect(
                line(parameter), f"creates the default of {name} once, and line {line(written[0])} writes to it"
            )


def _caches_alone(program: Program, function: Function, name: str, node: ast.AST) -> bool:
    """Whether a write only fills a table, with what is calculated and not drawn."""
    drawn = (name_of(one).lower() for one in ast.walk(function.node) if isinstance(one, ast.Name | ast.Attribute))
    return only_remembers(program, function, name, node) and not any("random" in one or "rng" in one for one in drawn)


def _writes_to_result(program: Program, function: Function) -> list[ast.AST]:
    """Where play writes to an attribute that holds the result of a function."""
    fields = {
        field
        for one in program.all
        for target, value, _ in one.bindings
        if isinstance(value, ast.Call) and name_of(value) == function.name and (field := one.field(target))
    }
    return [node for one in program.all for target, node in one.writes if one.field(target) in fields]


def _serial_numbers(program: Program) -> Iterator[Suspect]:
    """Find ``next()`` of a count of a class or of the module by whose remainders play decides something."""
    counts = {name for name, value in program.module_values.items() if _is_count(program, value)}
    for owner in program.classes:
        counts |= {
            f"{owner}.{name}" for name, (_, value) in program.class_values(owner).items() if _is_count(program, value)
        }
    divided = {
        name_of(node.left)
        for node in program.nodes
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mod | ast.BitAnd)
    } - {""}
    renewed = {name_of(target) for one in program.reached("reset") for target, _, _ in one.bindings}
    counts = {name for name in counts if name.rpartition(".")[2] not in renewed}
    for function in program.all:
        for target, value, node in function.bindings:
            match value:
                case ast.Call(func=ast.Name(id="next"), args=[count]) if name_of(target) in divided:
                    text = ast.unparse(count).replace("self.", f"{program.bound_to(function)}.")
                    text = text.replace("cls.", f"{program.bound_to(function)}.")
                    if text in counts:
                        yield Suspect(
                            line(node), f"takes numbers of {text}, which goes on in later episodes and instances"
                        )


def _is_count(program: Program, value: ast.expr | None) -> bool:
    return isinstance(value, ast.Call) and program.path(value.func) == "itertools.count"


def _class_level(program: Program, function: Function, usage: Usage) -> Iterator[Suspect]:
    for target, node in function.writes:
        field, owner = _attribute(program, function, target)
        defined, value = program.class_values(owner).get(field, ("", None))
        if not owner or not _mutable(value) or is_bookkeeping(field) or only_remembers(program, function, field, node):
            continue
        through_self = bool(function.field(target)) and function.me != "cls"
        if not through_self or not _rebound(program, owner, field):
            yield Suspect(
                line(node),
                f"writes to {defined}.{field}, which line {line(value) if value else 0} creates once for all instances",
            )
    # What only the constructor assigns is mostly a constant.
    assigned = [*function.bindings, *_augmented(function)] if function in program.play else []
    for target, _, node in assigned:
        field, owner = _attribute(program, function, target)
        if function.field(target) and function.me != "cls":
            continue
        if not owner or is_bookkeeping(field):
            continue
        read = any(_reads(usage, one, owner, field, node) for one in program.play)
        if read and not only_remembers(program, function, field, node):
            yield Suspect(line(node), f"assigns {owner}.{field}, which all instances share")


def _attribute(program: Program, function: Function, node: ast.AST) -> tuple[str, str]:
    """The attribute and the class of ``self.x``, ``Class.x``, ``type(self).x`` or ``self.__class__.x``."""
    if field := function.field(node):
        return field, program.bound_to(function)
    match node:
        case ast.Attribute(value=ast.Name(id=name), attr=attr) if (
            name in program.classes and name not in function.local
        ):
            return attr, name
        case ast.Attribute(value=ast.Call(func=ast.Name(id="type"), args=[ast.Name(id=name)]), attr=attr) if (
            name == function.me
        ):
            return attr, program.bound_to(function)
        case ast.Attribute(value=ast.Attribute(attr="__class__", value=ast.Name(id=name)), attr=attr) if (
            name == function.me
        ):
            return attr, program.bound_to(function)
    return "", ""


def _augmented(function: Function) -> Iterator[tuple[ast.expr, ast.expr | None, ast.AST]]:
    for node in function.nodes:
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Attribute):
            yield node.target, node.value, node


def _reads(usage: Usage, function: Function, owner: str, field: str, written: ast.AST) -> bool:
    own = set(ast.walk(written))
    return any(
        isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Load)
        and node not in own
        and _attribute(usage.program, function, node) == (field, owner)
        and usage.is_used(node, function)
        for node in function.nodes
    )


def is_bookkeeping(name: str) -> bool:
    """Whether a name says that its value is not the game's state: a cache, or a supply of identifiers."""
    words = name.lower().strip("_").split("_")
    return name == "metadata" or not {"cache", "cached", "id", "ids", "memo", "uid"}.isdisjoint(words)


def only_remembers(program: Program, function: Function, name: str, node: ast.AST) -> bool:
    """Whether a write only fills a table or a name that has no value yet."""
    for each in program.around(node, function):
        if isinstance(each, ast.If):
            match each.test:
                case ast.Compare(left=left, ops=[ast.Is() | ast.Eq()], comparators=[ast.Constant(value=None)]) if (
                    name in _names(left)
                ):
                    return True
                case ast.Compare(ops=[ast.NotIn()], comparators=[table]) if name_of(table) == name:
                    return not any(_adds_elsewhere(one, function) for one in ast.walk(each))
                case ast.UnaryOp(op=ast.Not(), operand=operand) if name_of(operand) == name or _has(operand, name):
                    return True
        if isinstance(each, ast.ExceptHandler):
            return True
    return False


def _adds_elsewhere(node: ast.AST, function: Function) -> bool:
    """Whether a call adds an item to what outlasts the function."""
    match node:
        case ast.Call(func=ast.Attribute(value=held, attr="add" | "append")):
            return name_of(root(held)) not in function.local or isinstance(root(held), ast.Attribute)
    return False


def _has(node: ast.AST, name: str) -> bool:
    """Whether a test asks for an attribute by ``hasattr``."""
    match node:
        case ast.Call(func=ast.Name(id="hasattr"), args=[_, ast.Constant(value=str(asked))]):
            return asked == name
    return False


def _names(node: ast.AST) -> set[str]:
    return {name_of(one) for one in ast.walk(node)}


def _rebound(program: Program, owner: str, field: str) -> bool:
    return field in program.field_values(owner)


def _module_level(program: Program, function: Function, usage: Usage) -> Iterator[Suspect]:
    for target, node in function.writes:
        if isinstance(target, ast.Name) and target.id not in function.local and not is_bookkeeping(target.id):
            value = program.module_values.get(target.id)
            if _mutable(value) and not only_remembers(program, function, target.id, node):
                yield Suspect(line(node), f"writes to {target.id} of the module, which all instances share")
    declared = {name for node in function.nodes if isinstance(node, ast.Global) for name in node.names}
    for node in function.nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in declared:
            read = any(
                isinstance(one, ast.Name)
                and one.id == node.id
                and isinstance(one.ctx, ast.Load)
                and one.id not in other.local
                and usage.is_used(one, other)
                for other in program.play
                for one in other.nodes
            )
            if read and not is_bookkeeping(node.id) and not only_remembers(program, function, node.id, node):
                yield Suspect(line(node), f"assigns {node.id} of the module, which all instances share")


def _caches(program: Program) -> Iterator[Suspect]:
    """Find methods whose cached result depends on attributes that play changes while the result is kept."""
    resetting, stepping = program.reached("reset"), program.reached("step")
    parts = (resetting, [one for one in program.play if one in stepping or one not in resetting])
    for function in program.play:
        if not function.me or not any(name_of(one) in _CACHES for one in function.node.decorator_list):
            continue
        kept = [part for part in parts if not any(_forgets(one, function.name) for one in part)]
        changed = {field for part in kept for one in part for field in _changed(program, one, function)}
        read = [field for node in function.nodes if (field := function.field(node)) in changed]
        if read:
            yield Suspect(
                line(function.node),
                f"caches {function.name}(), whose result depends on self.{read[0]}, which play changes",
            )


def _changed(program: Program, function: Function, cached: Function) -> set[str]:
    """The attributes of the object with the cached result that a function changes; a new object has no result yet."""
    owner = program.bound_to(function)
    if owner != program.bound_to(cached) or (owner != program.env and function.name in _CONSTRUCTORS):
        return set()
    targets = [*(one for one, _, _ in function.bindings), *(one for one, _ in function.writes)]
    return {function.field(target) for target in targets} - {""}


def _forgets(function: Function, name: str) -> bool:
    """Whether a function drops the cached result of a method."""
    for node in function.nodes:
        match node:
            case ast.Delete(targets=targets) if any(function.field(root(one)) == name for one in targets):
                return True
            case ast.Subscript(ctx=ast.Del(), slice=ast.Constant(value=key)) if key == name:
                return True
            case ast.Call(func=ast.Name(id="delattr"), args=[_, ast.Constant(value=key)]) if key == name:
                return True
            case ast.Call(func=ast.Attribute(attr="pop"), args=[ast.Constant(value=key), *_]) if key == name:
                return True
            case ast.Call(func=ast.Attribute(attr="clear", value=table)) if _is_attributes(table):
                return True
            case ast.Call(func=ast.Attribute(attr="cache_clear", value=ast.Attribute(attr=attr))) if attr == name:
                return True
    return False


def _is_attributes(node: ast.expr) -> bool:
    """Whether an expression is the table of an object's attributes."""
    match node:
        case ast.Attribute(attr="__dict__") | ast.Call(func=ast.Name(id="vars")):
            return True
    return False


def aliases(program: Program) -> Iterator[Suspect]:
    """Find buffers that are returned and written later, and actions that step() writes to or reads a step later."""
    stepping = program.reached("step")
    written: dict[str, int] = {}
    for function in stepping:
        if program.bound_to(function) == program.env:
            for target, node in function.writes:
                for field in same_objects(program, function, target):
                    written.setdefault(field, line(node))
    kept = {
        field
        for function in stepping
        for target, _, node in function.bindings
        if (field := function.field(target)) and not only_remembers(program, function, field, node)
    }
    for name in ("step", "reset"):
        if (method := program.method(program.env, name)) is not None:
            for node in method.nodes:
                if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and node.value.elts:
                    for field in sorted(same_objects(program, method, node.value.elts[0])):
                        if field in written and field not in kept and _buffer(program, method, field):
                            yield Suspect(
                                line(node),
                                f"returns self.{field} itself, and line {written[field]} writes to it in later steps",
                            )
    yield from _live_infos(program, stepping, written, kept)
    step = program.method(program.env, "step")
    if step is not None and len(step.node.args.args) > 1:
        yield from _action(step, step.node.args.args[1].arg)


def _live_infos(
    program: Program, stepping: list[Function], written: dict[str, int], kept: set[str]
) -> Iterator[Suspect]:
    """Find lists and the like that info gives as they are, although later steps change them."""
    for function in stepping:
        for node in function.nodes if program.bound_to(function) == program.env else ():
            for value in _infos(function, node):
                if (field := function.field(value)) in written and field not in kept:
                    values = program.field_values(program.env).get(field, ())
                    if values and all(_mutable(one) for one, _ in values):
                        words = f"gives self.{field} itself in info, and line {written[field]} changes it later"
                        yield Suspect(line(value), words, certain=False)


def _infos(function: Function, node: ast.AST) -> list[ast.expr]:
    """The values of a dict that is the info of a step, or what a method returns that is named for it."""
    match node:
        case ast.Return(value=ast.Tuple(elts=[_, _, _, _, ast.Dict(values=values)])) if function.name == "step":
            return values
        case ast.Return(value=ast.Dict(values=values)) if "info" in function.name:
            return values
        case ast.Assign(targets=[ast.Name(id="info")], value=ast.Dict(values=values)):
            return values
    return []


def kept_actions(program: Program) -> Iterator[Suspect]:
    """Find where step() keeps its action without a copy, once play has shown that this matters."""
    step = program.method(program.env, "step")
    if step is None or len(step.node.args.args) < 2:
        return
    action = step.node.args.args[1].arg
    others = [
        line(node)
        for target, value, node in step.bindings
        if isinstance(target, ast.Name) and target.id == action and not _is_same(value, action)
    ]
    kept = [(node, value) for target, value, node in step.bindings if step.field(root(target))]
    for node in step.nodes:
        match node:
            case ast.Call(func=ast.Attribute(attr="append" | "appendleft" | "insert", value=owner), args=[*_, value]):
                kept += [(node, value)] if step.field(root(owner)) else []
            case ast.Assign(targets=[ast.Subscript(value=owner)], value=value):
                kept += [(node, value)] if step.field(root(owner)) else []
    for node, given in kept:
        if _is_same(given, action) and line(node) <= min(others, default=line(node)):
            yield Suspect(line(node), f"keeps the caller's action without a copy: {ast.unparse(node)[:60]}")


def action_writes(program: Program, step: Function) -> list[int]:
    """Return the lines that write into the action, once play has shown that step() does, in order.

    Args:
        program: the file.
        step: its method step().
    """
    parameters = [one.arg for one in [*step.node.args.posonlyargs, *step.node.args.args]][bool(step.me) :]
    return sorted(writes_into(program, step, parameters[0], set())) if parameters else []


def writes_into(program: Program, function: Function, name: str, seen: set[tuple[Function, str]]) -> set[int]:
    """The lines that write into the object that a parameter names, here and in the functions that it is given to.

    Args:
        program: the file.
        function: the function with this parameter.
        name: the parameter.
        seen: functions and parameters that are known, to which these are added.
    """
    if (function, name) in seen:
        return set()
    seen.add((function, name))
    # A name that stands for another object is no longer the caller's.
    taken = [
        line(node)
        for target, value, node in function.bindings
        if isinstance(target, ast.Name) and target.id == name and not _is_same(value, name)
    ]
    before = min(taken, default=None)
    found = set()
    for target, node in function.writes:
        if isinstance(target, ast.Name) and target.id == name and (before is None or line(node) < before):
            found.add(line(node))
    for node in function.nodes:
        if not isinstance(node, ast.Call) or (before is not None and line(node) >= before):
            continue
        if any(each.arg == "out" and _is_same(each.value, name) for each in node.keywords):
            found.add(line(node))
        elif (called := program.called(node, function)) is not None:
            for parameter, value in arguments(node, called):
                if _is_same(value, name):
                    found |= writes_into(program, called, parameter, seen)
    return found


def _is_same(node: ast.AST | None, name: str) -> bool:
    """Whether an expression is the object of a name, which asarray() does not copy."""
    match node:
        case ast.Call(args=[inner, *_]) if name_of(node) == "asarray":
            return _is_same(inner, name)
    return isinstance(node, ast.Name) and node.id == name


def same_objects(program: Program, function: Function, node: ast.AST, depth: int = 4) -> set[str]:
    """Return the attributes whose objects, or views of them, an expression may be.

    Args:
        program: the file.
        function: in which the expression is.
        node: the expression.
        depth: the most names and calls that it may go through.
    """
    if depth == 0:
        return set()
    if field := function.field(node):
        return {field}
    match node:
        case ast.Name():
            values = program.values(node, function)
            return (
                same_objects(program, function, values[0][0], depth - 1)
                if len(values) == 1 and values[0][0] is not None
                else set()
            )
        case ast.Call(func=ast.Attribute() as called) if field := function.field(called):
            method = program.method(program.bound_to(function), field)
            if method is None:
                return set()
            results = [one.value for one in method.nodes if isinstance(one, ast.Return) and one.value is not None]
            return {one for result in results for one in same_objects(program, method, result, depth - 1)}
        case ast.Call(func=ast.Attribute(attr=attr) as called, args=args, keywords=[]) if attr in _VIEWS:
            whole = (
                args[0]
                if program.path(called, function).startswith("numpy.")
                and args
                and (attr != "asarray" or len(args) == 1)
                else called.value
            )
            return same_objects(program, function, whole, depth - 1)
        case ast.Subscript(value=value, slice=ast.Constant() | ast.UnaryOp() | ast.Slice()):
            return same_objects(program, function, value, depth - 1)
        case ast.Subscript(value=value, slice=ast.Tuple(elts=elts)) if any(isinstance(one, ast.Slice) for one in elts):
            return same_objects(program, function, value, depth - 1)
        case ast.Dict(values=values):
            return {one for value in values for one in same_objects(program, function, value, depth - 1)}
    return set()


def _buffer(program: Program, method: Function, field: str) -> bool:
    """Whether an attribute holds an array."""
    owner = program.bound_to(method)
    for value, one in program.field_values(owner).get(field, ()):
        item = value.elt if isinstance(value, ast.ListComp) else value
        if isinstance(item, ast.Call) and program.path(item.func, one).startswith("numpy."):
            return True
    return False


def _action(step: Function, action: str) -> Iterator[Suspect]:
    taken = any(isinstance(target, ast.Name) and target.id == action for target, _, _ in step.bindings)
    array = any(isinstance(node, ast.Subscript) and name_of(node.value) == action for node in step.nodes)
    if taken or not array:
        return
    for target, node in step.writes:
        if isinstance(target, ast.Name) and target.id == action:
            yield Suspect(line(node), "writes to the action, which belongs to the caller")
    for target, value, node in step.bindings:
        field = step.field(target)
        if field and isinstance(value, ast.Name) and value.id == action:
            read = [
                line(one)
                for one in step.nodes
                if step.field(one) == field
                and isinstance(getattr(one, "ctx", None), ast.Load)
                and line(one) < line(node)
            ]
            if read:
                yield Suspect(
                    line(node),
                    f"keeps the caller's action without a copy, and line {read[0]} reads it in the next step",
                )
