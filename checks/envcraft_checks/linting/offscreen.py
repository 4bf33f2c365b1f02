"""Things that play changes, drawn where the picture ends."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges

_ARRAYS = frozenset({"numpy.empty", "numpy.full", "numpy.ones", "numpy.zeros"})
_SURFACES = frozenset({"pygame.Surface", "pygame.display.set_mode"})
#: The functions of pygame.draw whose third argument is a rectangle.
_RECTANGLES = frozenset({"pygame.draw.arc", "pygame.draw.ellipse", "pygame.draw.rect"})
_NOWHERE = (math.inf, math.inf)
_DEPTH = 4


def offscreen_drawings(program: Program) -> Iterator[Suspect]:
    """Find what is drawn beyond the right or the lower edge of a picture of known size, and shows what play changes.

    Shapes of pygame count if all surfaces of the file have a known size, and areas of an array if it has one.
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
        self._surface = self._largest_surface()
        self._changing = {
            function.field(target)
            for function in program.reached("step")
            for target in [*(target for target, _ in function.writes), *(target for target, _, _ in function.bindings)]
        } - {""}

    def corner(self, node: ast.AST, function: Function) -> tuple[list[ast.expr | None], tuple[float, float]]:
        """The smallest x and y that a node draws at, and the width and the height of the picture; no x if unknown."""
        place: ast.expr | None = None
        match node:
            case ast.Call(func=ast.Attribute(attr="blit"), args=[_, place, *_]) if self._surface:
                pass
            case ast.Call(args=[_, _, place, *_]) if self._surface:
                if self._program.path(node.func, function) not in _RECTANGLES:
                    return [], _NOWHERE
            case ast.Subscript(ctx=ast.Store(), value=array, slice=index):
                size = self._size_of_array(array, function)
                axes = index.elts if isinstance(index, ast.Tuple) else [index]
                rows, columns = [axis.lower if isinstance(axis, ast.Slice) else None for axis in [*axes, None][:2]]
                return ([columns, rows], size) if size else ([], _NOWHERE)
            case _:
                return [], _NOWHERE
        if isinstance(place, ast.Call) and self._program.path(place.func, function) == "pygame.Rect":
            return [*place.args[:2]], self._surface or _NOWHERE
        return ([*place.elts[:2]] if isinstance(place, ast.Tuple | ast.List) else []), self._surface or _NOWHERE

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

    def _largest_surface(self) -> tuple[float, float] | None:
        """The width and the height of the largest surface of a file; None if it has none, or one of unknown size."""
        sizes = []
        for function in self._program.all:
            for node in function.nodes:
                if isinstance(node, ast.Call) and self._program.path(node.func, function) in _SURFACES:
                    sizes.append(self._size(node.args[0] if node.args else None, function))
        known = [size for size in sizes if size is not None]
        if not known or len(known) < len(sizes):
            return None
        return max(width for width, _ in known), max(height for _, height in known)

    def _size(self, node: ast.expr | None, function: Function | None) -> tuple[float, float] | None:
        if not isinstance(node, ast.Tuple | ast.List) or len(node.elts) < 2:
            return None
        first, second = (self._ranges.constant(one, function) for one in node.elts[:2])
        return None if first is None or second is None else (first, second)

    def _size_of_array(self, node: ast.expr, function: Function) -> tuple[float, float] | None:
        """The width and the height of an array that is only ever made by one call of NumPy with a known shape."""
        made = self._program.values(node, function) if isinstance(node, ast.Name | ast.Attribute) else []
        if len(made) != 1 or made[0][1] is None:
            return None
        value, owner = made[0]
        if not isinstance(value, ast.Call) or self._program.path(value.func, owner) not in _ARRAYS or not value.args:
            return None
        size = self._size(value.args[0], owner)
        return None if size is None else (size[1], size[0])


def _picture(node: ast.AST) -> ast.AST:
    """What a node draws on."""
    match node:
        case ast.Call(func=ast.Attribute(attr="blit", value=picture)) | ast.Subscript(value=picture):
            return picture
        case ast.Call(args=[picture, *_]):
            return picture
    return node
