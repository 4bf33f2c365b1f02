"""Tables of the module into whose items play writes, which all instances share."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import MUTATORS, Function, Program, Suspect, line, name_of


def shared_items(program: Program) -> Iterator[Suspect]:
    """Find where play counts on in an item of a table of the module, such as ``for each in KINDS: each["speed"] *= 2``,
    unless a reset may write to such an item, too, or steps clear a local name, which may be the item.
    """
    stepping = set(program.reached("step"))
    others = [one for one in program.all if one not in stepping or program.bound_to(one) != program.env]
    resetting = [node for one in (*others, *program.reached("reset")) for _, node in one.writes]
    if any(isinstance(node, ast.Call) and name_of(node) == "update" for node in resetting):
        return
    playing = [write for one in stepping for write in one.writes]
    if any(name_of(node) == "clear" and isinstance(target, ast.Name) for target, node in playing):
        return
    renewed = {_place_in_item(node) for node in resetting}
    renewed |= {_place_in_item(node) for _, node in playing if not _counts_on(program, node)} - {""}
    for function in program.reached("step"):
        tables = _tables_of_items(program, function)
        for target, node in function.writes:
            table = tables.get(target.id, "") if isinstance(target, ast.Name) else ""
            match node:
                case ast.Subscript(value=ast.Subscript(value=copied)) if copied is target and function.field(target):
                    table = _table(program, function, target)
            kept = _holds_containers(program, table) and _place_in_item(node) not in renewed
            if kept and _counts_on(program, node) and not _is_taken_back(program, node, function):
                words = f"writes into an item of {table} of the module, which all instances share"
                yield Suspect(line(node), words)


def _counts_on(program: Program, write: ast.AST) -> bool:
    """Whether a write depends on what the place had before."""
    if isinstance(write, ast.Call):
        return name_of(write) not in ("clear", "setdefault", "sort", "update")
    match program.parents[write]:
        case ast.AugAssign():
            return True
        case ast.Assign(value=value):
            old = ast.unparse(write)
            sums = (node for node in ast.walk(value) if isinstance(node, ast.BinOp))
            return any(ast.unparse(side) == old for one in sums for side in (one.left, one.right))
    return False


def _is_taken_back(program: Program, write: ast.AST, function: Function) -> bool:
    """Whether the function also undoes what it does to a place, or only fills an empty list."""
    if isinstance(write, ast.Call) and isinstance(write.func, ast.Attribute):
        filled = ast.unparse(write.func.value)
        tests = [one.test for one in program.around(write, function) if isinstance(one, ast.If)]
        others = [
            name_of(node) for target, node in function.writes if ast.unparse(target) == filled and node is not write
        ]
        return any(filled in ast.unparse(test) for test in tests) or any(name in ("pop", "remove") for name in others)
    outer = program.parents[write]
    return isinstance(outer, ast.AugAssign) and any(
        isinstance(node, ast.AugAssign)
        and node is not outer
        and type(node.op) is not type(outer.op)
        and ast.unparse(node.target) == ast.unparse(outer.target)
        for node in function.nodes
    )


def _place_in_item(node: ast.AST) -> str:
    """The key at which a statement writes, "" for any other change of an item."""
    return ast.unparse(node.slice) if isinstance(node, ast.Subscript) else ""


def _tables_of_items(program: Program, function: Function) -> dict[str, str]:
    """The table of the module of which each local name is an item, as far as its items are lists or dictionaries."""
    found: dict[str, str] = {}
    for node in function.nodes:
        items: ast.expr | None = None
        match node:
            case ast.For(target=target, iter=items) | ast.comprehension(target=target, iter=items):
                match target, items:
                    case ast.Tuple(elts=[_, target]), (
                        ast.Call(func=ast.Attribute(value=items, attr="items"))
                        | ast.Call(func=ast.Name(id="enumerate"), args=[items, *_])
                    ):
                        pass
                    case _, ast.Call(func=ast.Attribute(value=items, attr="values")):
                        pass
            case ast.Assign(targets=[target], value=ast.Subscript(value=items, slice=index)):
                if isinstance(index, ast.Slice):
                    items = None
            case _:
                continue
        table = _table(program, function, items)
        if isinstance(target, ast.Name) and _holds_containers(program, table):
            found[target.id] = table
    counts = [node.id for node in function.nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    counts += [node.name or "" for node in function.nodes if isinstance(node, ast.MatchAs | ast.MatchStar)]
    counts += [node.arg for node in function.nodes if isinstance(node, ast.arg)] + function.parameters
    return {name: table for name, table in found.items() if counts.count(name) == 1}


def _table(program: Program, function: Function, node: ast.AST | None) -> str:
    """The table of the module that a node names, or whose items an attribute of ``self`` holds; "" if it is neither."""
    if isinstance(node, ast.Name):
        inner = {one.arg for one in function.nodes if isinstance(one, ast.arg)}
        return "" if node.id in function.local | inner else node.id
    if not (field := function.field(node)) or program.bound_to(function) != program.env:
        return ""
    if _is_changed(program, field):
        return ""
    values = program.field_values(program.env).get(field, ())
    tables = [(_copied(value) if value is not None else None, method) for value, method in values]
    names = {_table(program, method, table) if isinstance(table, ast.Name) else "" for table, method in tables}
    return names.pop() if len(names) == 1 else ""


def _is_changed(program: Program, field: str) -> bool:
    """Whether the code may give an attribute other items than those of a table: by an item, or under another name."""
    methods = program.methods(program.env)
    own = {node for one in methods for node in one.nodes if one.field(node) == field}
    for node in program.nodes:
        match node:
            case ast.Attribute(attr=attr, ctx=ast.Store()) if attr == field and node not in own:
                return True
            case ast.Attribute(attr=attr) if attr == field:
                outer = program.parents[node]
                if isinstance(outer, ast.Subscript) and not isinstance(outer.ctx, ast.Load):
                    return True
                if isinstance(outer, ast.Attribute) and outer.attr in MUTATORS:
                    return True
        if name_of(node) in ("__dict__", "setattr", "vars"):
            return True
    return False


def _copied(value: ast.expr) -> ast.expr:
    """The table of which an expression is a copy with the same items; the expression itself if it is none."""
    match value:
        case ast.Call(func=ast.Name(id="dict" | "list" | "tuple"), args=[table], keywords=[]):
            return table
        case ast.Call(func=ast.Attribute(value=ast.Name(id="copy"), attr="copy"), args=[table]):
            return table
        case ast.Call(func=ast.Attribute(value=table, attr="copy"), args=[], keywords=[]):
            return table
        case ast.Dict(keys=[None], values=[table]) | ast.List(elts=[ast.Starred(value=table)]):
            return table
        case ast.ListComp(elt=ast.Name(id=item), generators=[ast.comprehension(target=ast.Name(id=each), iter=table)]):
            return table if item == each else value
        case ast.DictComp(
            value=ast.Name(id=item),
            generators=[
                ast.comprehension(
                    target=ast.Tuple(elts=[_, ast.Name(id=each)]),
                    iter=ast.Call(func=ast.Attribute(value=table, attr="items")),
                )
            ],
        ):
            return table if item == each else value
    return value


def _holds_containers(program: Program, name: str) -> bool:
    """Whether a name of the module is a list or a dictionary of lists or dictionaries, written out."""
    match program.module_values.get(name):
        case ast.List(elts=items) | ast.Tuple(elts=items) | ast.Dict(values=items):
            return bool(items) and all(isinstance(item, ast.List | ast.Dict) for item in items)
    return False
