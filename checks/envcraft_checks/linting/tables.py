"""Tables of the module into whose items play writes, which all instances share."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line


def shared_items(program: Program) -> Iterator[Suspect]:
    """Find where play counts on in an item of a table of the module, such as ``for each in KINDS: each["speed"] *= 2``,
    unless a reset may write to such an item, too.
    """
    stepping = set(program.reached("step"))
    others = [one for one in program.all if one not in stepping or program.bound_to(one) != program.env]
    renewed = {_place_in_item(node) for one in (*others, *program.reached("reset")) for _, node in one.writes}
    for function in program.reached("step"):
        tables = _tables_of_items(program, function)
        for target, node in function.writes:
            if not isinstance(target, ast.Name) or target.id not in tables or _place_in_item(node) in renewed:
                continue
            if isinstance(node, ast.Call) or _counts_on(program.parents[node], node):
                words = f"writes into an item of {tables[target.id]} of the module, which all instances share"
                yield Suspect(line(node), words)


def _counts_on(statement: ast.AST, place: ast.AST) -> bool:
    """Whether a statement computes the new value of a place from the old one."""
    match statement:
        case ast.AugAssign():
            return True
        case ast.Assign(value=value):
            old = ast.unparse(place)
            return any(isinstance(node, ast.Subscript) and ast.unparse(node) == old for node in ast.walk(value))
    return False


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
    return {name: table for name, table in found.items() if counts.count(name) == 1}


def _table(program: Program, function: Function, node: ast.AST | None) -> str:
    """The table of the module that a node names, or whose items an attribute of ``self`` holds; "" if it is neither."""
    if isinstance(node, ast.Name):
        return "" if node.id in function.local else node.id
    if not (field := function.field(node)) or program.bound_to(function) != program.env:
        return ""
    values = program.field_values(program.env).get(field, ())
    tables = [(_copied(value) if value is not None else None, method) for value, method in values]
    names = {_table(program, method, table) if isinstance(table, ast.Name) else "" for table, method in tables}
    return names.pop() if len(names) == 1 else ""


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
