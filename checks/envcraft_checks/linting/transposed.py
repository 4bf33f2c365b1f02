"""Pictures of pygame that keep the order of its surfaces: x before y."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .flow import Flow
from .program import Program, Suspect, line, name_of

_PIXELS = frozenset({"pygame.surfarray.array3d", "pygame.surfarray.pixels3d"})
#: What turns a picture or a surface, or reads its bytes in another order.
_TURNS = frozenset({
    "einsum", "frombuffer", "fromarray", "moveaxis", "permute", "rearrange", "reshape", "rollaxis", "rot90", "swapaxes",
    "tobytes", "tostring", "transpose",
})  # fmt: skip


def transposed_pictures(program: Program) -> Iterator[Suspect]:
    """Find pixels of a surface that reset(), step() or render() returns, in a file that turns no picture."""
    if any(isinstance(node, ast.Attribute | ast.Name) and _turns(program, node) for node in program.nodes):
        return
    functions = program.reached("reset", "step", "render")
    for function in functions:
        for node in function.nodes:
            if isinstance(node, ast.Call) and program.path(node.func, function) in _PIXELS:
                flow = Flow(program, functions, node)
                if any(one.name == "render" for one in flow.results) or any(
                    _is_observation(program, use) for use in flow.uses()
                ):
                    yield Suspect(line(node), f"returns pixels with x as the first axis: {ast.unparse(node)[:60]}")


def _is_observation(program: Program, node: ast.AST) -> bool:
    """Whether a node is the first of the values that step() or reset() returns."""
    whole = program.parents[node]
    returned = isinstance(whole, ast.Tuple) and isinstance(program.parents[whole], ast.Return)
    return returned and isinstance(whole, ast.Tuple) and whole.elts[0] is node


def _turns(program: Program, node: ast.Attribute | ast.Name) -> bool:
    if isinstance(node, ast.Attribute) and node.attr == "T":
        return not (isinstance(node.value, ast.Name) and node.value.id in {"self", *program.classes})
    return name_of(node) in _TURNS or program.path(node) in ("cv2.rotate", "pygame.transform.rotate")
