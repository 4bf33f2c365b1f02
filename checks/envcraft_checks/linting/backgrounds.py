"""Things that are drawn in the colour that the background has in some levels."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges

_Colour = tuple[float, ...]
#: The colours of one level, by the key of a table; "" where a level has only one.
_Row = dict[str, _Colour]
_CHANNELS = 3


def background_colours(program: Program) -> Iterator[Suspect]:
    """Find loops and functions that draw in one colour only, which is the background's in one level and not in others.

    The background is what a whole picture is filled with: a colour of a table in the file, chosen by the level.
    """
    palettes = _Palettes(program)
    functions = program.reached("reset", "step", "render")
    filled = {part for function in functions for part in palettes.filled(function)}
    fills = {
        entry
        for function in functions
        for part in palettes.filled(function)
        for entry in palettes.entry(part, function)
    }
    for function in functions if fills else ():
        groups: dict[ast.AST, list[ast.expr]] = {}
        for node in function.nodes:
            if isinstance(node, ast.expr) and node not in filled and palettes.is_colour(node, function):
                groups.setdefault(palettes.group(node, function), []).append(node)
        for group, drawn in groups.items():
            if len({ast.unparse(one) for one in drawn}) > 1 or palettes.fills_in(group, filled):
                continue
            for table, key in sorted(fills):
                rows = palettes.same(drawn[0], function, table, key)
                if rows:
                    shown = f"{table}[{rows[0]}]" + (f"[{key!r}]" if key else "")
                    yield Suspect(
                        line(drawn[0]), f"draws in {ast.unparse(drawn[0])}, the colour of the background {shown}"
                    )


class _Palettes:
    """The colours of a file, and its tables of colours."""

    def __init__(self, program: Program) -> None:
        self._program, self._ranges = program, Ranges(program)
        values = {
            **program.module_values,
            **{name: value for name, (_, value) in program.class_values(program.env).items()},
        }
        self._colours = {name: colour for name, value in values.items() if (colour := self._colour(value))}
        self.tables = {name: rows for name, value in values.items() if (rows := self._rows(value))}

    def _colour(self, node: ast.expr | None) -> _Colour:
        """The colour that a tuple of three numbers, or of four with the opacity, is; () for anything else."""
        if not isinstance(node, ast.Tuple | ast.List) or len(node.elts) not in (_CHANNELS, _CHANNELS + 1):
            return ()
        parts = [one.value for one in node.elts if isinstance(one, ast.Constant) and isinstance(one.value, int)]
        return tuple(parts[:_CHANNELS]) if len(parts) == len(node.elts) else ()

    def _rows(self, node: ast.expr | None) -> list[_Row]:
        items: list[ast.expr] = []
        match node:
            case ast.List(elts=items) | ast.Tuple(elts=items) | ast.Dict(values=items):
                pass
        rows = []
        for item in items:
            row: _Row = {"": colour} if (colour := self._colour(item)) else {}
            if isinstance(item, ast.Dict):
                for key, value in zip(item.keys, item.values, strict=True):
                    if isinstance(key, ast.Constant) and isinstance(key.value, str) and (colour := self._colour(value)):
                        row[key.value] = colour
            rows.append(row)
        return rows if len(rows) > 1 and all(rows) else []

    def entry(self, node: ast.expr, function: Function) -> Iterator[tuple[str, str]]:
        """The table and the key of which an expression is a colour, such as ``THEMES[self.level]["air"]``."""
        if isinstance(node, ast.Name) and node.id in function.local:
            values = self._program.values(node, function)
            if len(values) == 1 and values[0][0] is not None and values[0][1] is function:
                yield from self.entry(values[0][0], function)
            return
        key = ""
        match node:
            case ast.Subscript(value=row, slice=ast.Constant(value=str(key))):
                if isinstance(row, ast.Name) and row.id in function.local:
                    values = self._program.values(row, function)
                    once = len(values) == 1 and values[0][1] is function
                    node = values[0][0] if once and values[0][0] is not None else row
                else:
                    node = row
        match node:
            case ast.Subscript(value=table, slice=index) if not isinstance(index, ast.Constant | ast.Slice):
                name = name_of(table)
                if name in self.tables and all(key in row for row in self.tables[name]):
                    yield name, key

    def is_colour(self, node: ast.expr, function: Function) -> bool:
        parent = self._program.parents[node]
        if isinstance(parent, ast.Subscript | ast.Tuple) or not isinstance(getattr(node, "ctx", None), ast.Load):
            return False
        match node:
            case ast.Tuple():
                return bool(self._colour(node))
            case ast.Name() | ast.Attribute() if name_of(node) in self._colours:
                return True
        return isinstance(node, ast.Name | ast.Subscript) and any(self.entry(node, function))

    def filled(self, function: Function) -> Iterator[ast.expr]:
        """The colours with which a function fills whole pictures."""
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Attribute(attr="fill"), args=[colour]):
                    yield colour
                case ast.Call(args=[ast.Tuple(), colour, *_]) if (
                    self._program.path(node.func, function) == "numpy.full"
                ):
                    yield colour
                case ast.Assign(targets=[ast.Subscript(slice=index)], value=colour) if _is_whole(index):
                    yield colour

    def group(self, node: ast.AST, function: Function) -> ast.AST:
        """The innermost loop around a node, or its function."""
        return next((one for one in self._program.around(node, function) if isinstance(one, ast.For)), function.node)

    def fills_in(self, group: ast.AST, filled: set[ast.expr]) -> bool:
        return any(one in filled for one in ast.walk(group))

    def same(self, node: ast.expr, function: Function, table: str, key: str) -> list[int]:
        """The rows of a table of backgrounds that have the colour of an expression, unless all have."""
        entries = list(self.entry(node, function))
        if entries and (entries[0][0] != table or entries[0][1] == key):
            return []
        rows = self.tables[table]
        own = self._colour(node) or self._colours.get(name_of(node), ())
        found = [at for at, row in enumerate(rows) if row[key] == (row[entries[0][1]] if entries else own)]
        return found if len(found) < len(rows) else []


def _is_whole(index: ast.expr) -> bool:
    parts = index.elts if isinstance(index, ast.Tuple) else [index]
    return all(
        (isinstance(part, ast.Slice) and part.lower is part.upper is None)
        or (isinstance(part, ast.Constant) and part.value is ...)
        for part in parts
    )
