"""Pictures of pygame that keep the order of its surfaces: x before y."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .flow import Flow
from .program import Program, Suspect, line, name_of

_PIXELS = frozenset({"pygame.surfarray.array3d", "pygame.surfarray.pixels3d"})
#: What turns a picture or a surface, or reads its bytes in another order.
_TURNS = frozenset({
    "T", "einsum", "flip", "frombuffer", "fromarray", "moveaxis", "permute", "rearrange", "reshape", "rollaxis",
    "rot90", "rotate", "swapaxes", "tobytes", "tostring", "transpose",
})  # fmt: skip


def transposed_pictures(program: Program) -> Iterator[Suspect]:
    """Find pixels of a surface that reset(), step() or render() returns, in a file that turns no picture."""
    if any(isinstance(node, ast.Attribute | ast.Name) and _turns(node) for node in program.nodes):
        return
    functions = program.reached("reset", "step", "render")
    for function in functions:
        for node in function.nodes:
            if isinstance(node, ast.Call) and program.path(node.func, function) in _PIXELS:
                flow = Flow(program, functions, node)
                shown = any(isinstance(program.parents[program.parents[use]], ast.Return) for use in flow.uses())
                if shown or any(one.name == "render" for one in flow.results):
                    yield Suspect(line(node), f"returns pixels with x as the first axis: {ast.unparse(node)[:60]}")


def _turns(node: ast.Attribute | ast.Name) -> bool:
    # pygame.display.flip() only shows a window.
    window = isinstance(node, ast.Attribute) and name_of(node.value) == "display"
    return name_of(node) in _TURNS and not window
