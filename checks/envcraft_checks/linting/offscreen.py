"""Things that play changes, drawn where the picture ends."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator

from .program import Function, Program, Suspect, arguments, line, name_of
from .ranges import Ranges

_ARRAYS = frozenset({"numpy.empty", "numpy.full", "numpy.ones", "numpy.zeros"})
_SURFACES = frozenset({"pygame.Surface", "pygame.display.set_mode"})
#: The functions of pygame.draw whose third argument is a rectangle.
_RECTANGLES = frozenset({"pygame.draw.arc", "pygame.draw.ellipse", "pygame.draw.rect"})
_NOWHERE = (math.inf, math.inf)
_DEPTH = 4


def offscreen_drawings(program: Program) -> Iterator[Suspect]:
    """Find what is drawn beyond the right or the lower edge of a picture of known size, and shows what play changes.

    Shapes on a surface of pygame and areas of an array count, if each has one known size.
    """
    drawings = _Drawings(program)
    for function in program.reached("reset", "step", "render"):
        for node in function.nodes:
            starts, size = drawings.corner(node, function)
            for start, end, edge in zip(starts, size, ("right", "lower"), strict=False):
                if start is None or drawings.least(start, function) < end:
                    continue
                if drawings.shows(node, start, function):
                    yield Suspect(line(node), f"draws beyond the {edge} edge: {ast.unparse(node)[:60]}")
                break


class _Drawings:
    """The drawing calls of a file, and the pictures that they draw on."""

    def __init__(self, program: Program) -> None:
        self._program, self._ranges = program, Ranges(program)
        self._changing = program.changed("step")

    def corner(self, node: ast.AST, function: Function) -> tuple[list[ast.expr | None], tuple[float, float]]:
        """The smallest x and y that a node draws at, and the width and the height of the picture; no x if unknown."""
        place: ast.expr | None = None
        match node:
            case ast.Call(func=ast.Attribute(attr="blit", value=picture), args=[_, place, *_]):
                pass
            case ast.Call(args=[picture, _, place, *_]):
                if self._program.path(node.func, function) not in _RECTANGLES:
                    return [], _NOWHERE
            case ast.Subscript(ctx=ast.Store(), value=picture, slice=index):
                axes = [*index.elts] if isinstance(index, ast.Tuple) else [index]
                plain = all(isinstance(axis, ast.Slice | ast.Constant) and _is_plain(axis) for axis in axes)
                size = self._size_of(picture, function, _ARRAYS) if plain and axes else None
                starts = [axis.lower if isinstance(axis, ast.Slice) else None for axis in axes]
                # Rows come first.
                return ([*starts[1::-1]] if starts[1:] else [None, *starts], size[::-1]) if size else ([], _NOWHERE)
            case _:
                return [], _NOWHERE
        size = self._size_of(picture, function, _SURFACES)
        corner: list[ast.expr | None] = []
        if isinstance(place, ast.Call) and self._program.path(place.func, function) == "pygame.Rect":
            corner = [*place.args[:2]]
        elif isinstance(place, ast.Tuple | ast.List):
            corner = [*place.elts[:2]]
        return (corner, size) if size and len(corner) > 1 else ([], _NOWHERE)

    def shows(self, node: ast.AST, start: ast.expr, function: Function) -> bool:
        """Whether play decides what a node draws, or how often; else it is an ornament.

        Args:
            node: the call or the area.
            start: the coordinate beyond the edge, such as that of a background that moves along.
            function: its function.
        """
        around = [*self._program.around(node, function)]
        parts = [one.test for one in around if isinstance(one, ast.If)]
        parts += [one.iter for one in around if isinstance(one, ast.For)]
        parts += [one.value for one in around if isinstance(one, ast.Assign)]
        apart = {*ast.walk(start), *ast.walk(_picture(node))}
        return any(
            function.field(one) in self._changing
            for part in (node, *parts)
            for one in ast.walk(part)
            if one not in apart
        )

    def least(self, node: ast.expr, function: Function, depth: int = _DEPTH) -> float:
        """The lowest value of an expression, as far as it is known."""
        numbers = self._ranges.numbers(node, function)
        if numbers or depth == 0:
            return min(numbers, default=-math.inf)
        match node:
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return self.least(left, function, depth - 1) + self.least(right, function, depth - 1)
            case ast.BinOp(left=left, op=ast.Sub(), right=right):
                most = self._ranges.constant(right, function)
                return -math.inf if most is None else self.least(left, function, depth - 1) - most
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                least = self.least(left, function, depth - 1), self.least(right, function, depth - 1)
                return least[0] * least[1] if min(least) >= 0 else -math.inf
            case ast.Name(id=name) if name in function.local:
                if self._counts(name, function):
                    return 0.0
                values = [value for value, _ in self._program.values(node, function)]
                written = name in function.parameters or any(name_of(target) == name for target, _ in function.writes)
                match values:
                    case [ast.expr() as value] if not written:
                        return self.least(value, function, depth - 1)
                return -math.inf
        return self._ranges.range(node, function)[0]

    def _counts(self, name: str, function: Function) -> bool:
        """Whether a name only counts the rounds of loops."""
        targets = [target for target, _, _ in function.bindings if isinstance(target, ast.Name) and target.id == name]
        loops = 0
        for node in function.nodes:
            match node:
                case (
                    ast.For(target=ast.Name(id=counter), iter=ast.Call(func=ast.Name(id="range"), args=[_]))
                    | ast.For(
                        target=ast.Tuple(elts=[ast.Name(id=counter), _]),
                        iter=ast.Call(func=ast.Name(id="enumerate"), args=[_]),
                    )
                ):
                    loops += counter == name
        return loops == len(targets) > 0

    def _size(self, node: ast.expr | None, function: Function | None) -> tuple[float, float] | None:
        if not isinstance(node, ast.Tuple | ast.List) or len(node.elts) < 2:
            return None
        first, second = (self._ranges.constant(one, function) for one in node.elts[:2])
        return None if first is None or second is None else (first, second)

    def _size_of(
        self, node: ast.expr | None, function: Function | None, makers: frozenset[str], depth: int = _DEPTH
    ) -> tuple[float, float] | None:
        """The two numbers of the only size that a picture is made with; None if it may have another one."""
        if depth == 0 or function is None:
            return None
        made: list[tuple[ast.expr | None, Function | None]] = []
        match node:
            case ast.Call() if self._program.path(node.func, function) in makers:
                return self._size(node.args[0] if node.args else None, function)
            case ast.Call(func=ast.Attribute(attr="convert" | "convert_alpha", value=surface)):
                made = [(surface, function)]
            case ast.Name(id=name) if name in function.parameters:
                if not any(name_of(target) == name for target, _, _ in function.bindings):
                    made = [*self._given(function, name)]
            case ast.Name(id=name) if name in function.local:
                made = [*self._program.values(node, function)]
            case ast.Attribute() if field := function.field(node):
                unset = (value for value, _ in self._program.values(node, function) if not _is_none(value))
                owners = dict(self._program.field_values(self._program.bound_to(function)).get(field, ()))
                made = [(value, owners.get(value)) for value in unset]
        sizes = {self._size_of(value, owner, makers, depth - 1) for value, owner in made}
        return sizes.pop() if len(sizes) == 1 else None

    def _given(self, function: Function, name: str) -> Iterator[tuple[ast.expr | None, Function | None]]:
        """What each call gives a parameter; None for a default and for a call that is not known."""
        optional = function.node.args.args[::-1][: len(function.node.args.defaults)]
        if name in (one.arg for one in optional):
            yield None, None
        for caller in self._program.reached("reset", "step", "render", "__init__"):
            for node in caller.nodes:
                if isinstance(node, ast.Call) and name_of(node.func) == function.name:
                    known = self._program.called(node, caller) is function
                    given = dict(arguments(node, function)) if known else {}
                    yield given.get(name), caller


def _is_none(node: ast.expr | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _is_plain(axis: ast.expr) -> bool:
    """Whether an index is a whole number, or a slice that goes up."""
    if isinstance(axis, ast.Slice):
        return axis.step is None
    return isinstance(axis, ast.Constant) and isinstance(axis.value, int)


def _picture(node: ast.AST) -> ast.AST:
    """What a node draws on."""
    match node:
        case ast.Call(func=ast.Attribute(attr="blit", value=picture)) | ast.Subscript(value=picture):
            return picture
        case ast.Call(args=[picture, *_]):
            return picture
    return node
