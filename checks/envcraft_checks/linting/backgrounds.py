"""Things that are drawn in the colour that the background has in some levels."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import NamedTuple

from .program import Function, Program, Suspect, line, name_of

_Colour = tuple[float, ...]
#: The colours of one level, by the key of a table; "" where a level has only one.
_Row = dict[str, _Colour]
_CHANNELS = 3
_DEPTH = 4
#: Names of what shows the background, or is to look like it.
_MEANT = re.compile(r"air|back|bg|black|dark|erase|floor|hole|night|pit|pupil|shadow|sky|void|water|window", re.I)


def background_colours(program: Program) -> Iterator[Suspect]:
    """Find loops and functions that draw what play moves in one colour only, which is the background's in one level.

    The background is what a whole picture is filled with: a colour of a table in the file, chosen by the level.
    """
    palettes = _Palettes(program)
    functions = program.reached("reset", "step", "render")
    fills = {(part, entry) for one in functions for part in palettes.filled(one) for entry in palettes.entry(part, one)}
    filled, tables = {part for part, _ in fills}, sorted({entry for _, entry in fills})
    for function in functions if fills else ():
        groups: dict[ast.AST, list[_Drawing]] = {}
        for node in function.nodes:
            if isinstance(node, ast.Assign | ast.Call) and (drawing := palettes.drawing(node, function)):
                groups.setdefault(palettes.group(node, function), []).append(drawing)
        for group, drawn in groups.items():
            colours = {ast.unparse(one.colour) if one.colour is not None else "" for one in drawn}
            if len(colours) > 1 or not all(one.moves for one in drawn) or any(one in filled for one in ast.walk(group)):
                continue
            for table, key in tables:
                colour = drawn[0].colour
                rows = palettes.same(colour, function, table, key) if colour is not None else []
                if colour is not None and rows and not palettes.is_chosen(function, table):
                    shown = f"{table}[{rows[0]}]" + (f"[{key!r}]" if key else "")
                    words = f"draws in {ast.unparse(colour)}, the colour of the background {shown}"
                    yield Suspect(line(drawn[0].node), words)


class _Drawing(NamedTuple):
    """A statement or a call that draws, its colour if that is one of the file, and whether play moves it."""

    node: ast.AST
    colour: ast.expr | None
    moves: bool


class _Palettes:
    """The colours of a file, and its tables of colours."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._changing = program.changed("step")
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

    def entry(self, node: ast.expr, function: Function, depth: int = _DEPTH) -> Iterator[tuple[str, str]]:
        """The table and the key of which an expression is a colour, such as ``THEMES[self.level]["air"]``."""
        if isinstance(node, ast.Name) and node.id in function.local:
            values = self._program.values(node, function)
            if depth and len(values) == 1 and values[0][0] is not None and node.id not in function.parameters:
                yield from self.entry(values[0][0], function, depth - 1)
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
        """Whether an expression is a colour with a name of its own: a constant, or an entry of a table."""
        if isinstance(node, ast.Name | ast.Attribute) and name_of(node) in self._colours:
            return not _MEANT.search(name_of(node))
        entries = [*self.entry(node, function)] if isinstance(node, ast.Name | ast.Subscript) else []
        return bool(entries) and not _MEANT.search(entries[0][1])

    def filled(self, function: Function) -> Iterator[ast.expr]:
        """The colours with which a function fills whole pictures, except in loops, as for sprites."""
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Attribute(attr="fill"), args=[colour]):
                    pass
                case ast.Call(args=[ast.Tuple(), colour, *_]) if (
                    self._program.path(node.func, function) == "numpy.full"
                ):
                    pass
                case ast.Assign(targets=[ast.Subscript(slice=index)], value=colour) if _is_whole(index):
                    pass
                case _:
                    continue
            if not any(isinstance(one, ast.For) for one in self._program.around(node, function)):
                yield colour

    def drawing(self, node: ast.Assign | ast.Call, function: Function) -> _Drawing | None:
        """What a statement or a call draws: a write to an area, or a call with a colour."""
        match node:
            case ast.Assign(targets=[ast.Subscript(slice=ast.Tuple() as place)], value=value):
                colour = value if self.is_colour(value, function) else None
                return _Drawing(node, colour, self._moves(place, function))
            case ast.Call(args=[_, _, *_] as parts):
                known = [part for part in parts if self.is_colour(part, function)]
                if known or self._program.path(node.func, function).startswith("pygame.draw."):
                    others = ast.Tuple([part for part in parts if part not in known])
                    return _Drawing(node, known[0] if known else None, self._moves(others, function))
        return None

    def _moves(self, place: ast.expr, function: Function) -> bool:
        """Whether a place has a name of a loop or a parameter in it, or an attribute that play changes."""
        return any(
            (isinstance(one, ast.Name) and one.id in function.local and one.id != function.me)
            or function.field(one) in self._changing
            for one in ast.walk(place)
        )

    def is_chosen(self, function: Function, table: str) -> bool:
        """Whether a test in a function reads what also chooses the row of a table."""
        chosen = {
            field
            for one in self._program.reached("reset", "step", "render")
            for node in one.nodes
            if isinstance(node, ast.Subscript) and name_of(node.value) == table
            for part in ast.walk(node.slice)
            if (field := one.field(part))
        }
        tests = (node.test for node in function.nodes if isinstance(node, ast.If | ast.IfExp))
        return any(function.field(part) in chosen for test in tests for part in ast.walk(test))

    def group(self, node: ast.AST, function: Function) -> ast.AST:
        """The innermost loop around a node, or its function."""
        return next((one for one in self._program.around(node, function) if isinstance(one, ast.For)), function.node)

    def same(self, node: ast.expr, function: Function, table: str, key: str) -> list[int]:
        """The rows of a table of backgrounds that have the colour of an expression, unless all have."""
        entries = list(self.entry(node, function))
        if entries and (entries[0][0] != table or entries[0][1] == key):
            return []
        rows = self.tables[table]
        own = self._colours.get(name_of(node), ())
        found = [at for at, row in enumerate(rows) if row[key] == (row[entries[0][1]] if entries else own)]
        return found if len(found) < len(rows) else []


def _is_whole(index: ast.expr) -> bool:
    parts = index.elts if isinstance(index, ast.Tuple) else [index]
    return all(
        (isinstance(part, ast.Slice) and part.lower is part.upper is None)
        or (isinstance(part, ast.Constant) and part.value is ...)
        for part in parts
    )
