"""Time that play reads and uses."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator

from .flow import Flow
from .program import Function, Program, Suspect, line

_CLOCKS = frozenset({
    "datetime.date.today", "datetime.datetime.now", "datetime.datetime.today", "datetime.datetime.utcnow",
    "pygame.time.get_ticks", "time.monotonic", "time.monotonic_ns", "time.perf_counter", "time.perf_counter_ns",
    "time.process_time", "time.time", "time.time_ns",
})  # fmt: skip
#: The readings of a file that are followed.
_READINGS = 10
_OF_PYGAME = frozenset({"get_fps", "get_rawtime", "get_time", "tick", "tick_busy_loop"})


def clocks(program: Program) -> Iterator[Suspect]:
    """Find readings of the clock that reach a decision, a picture or a result of play."""

    def reads(node: ast.AST, function: Function) -> bool:
        if not isinstance(node, ast.Call):
            return False
        if isinstance(node.func, ast.Attribute) and node.func.attr in _OF_PYGAME:
            owner = node.func.value
            made = [
                program.path(value.func, one)
                for value, one in program.values(owner, function)
                if isinstance(value, ast.Call)
            ]
            return "pygame.time.Clock" in made
        return program.path(node.func, function) in _CLOCKS

    found = (node for function in program.play for node in function.nodes if reads(node, function))
    for read in itertools.islice(found, _READINGS):
        if (used := next(Flow(program, program.play, read).uses(), None)) is not None:
            words = (
                f"reads the clock, {ast.unparse(read)[:40]}, and line {line(used)} uses it: {ast.unparse(used)[:60]}"
            )
            yield Suspect(line(read), words)
