"""Time that play reads and uses, and calls that wait."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Undecided
from envcraft.text import one_line

from .flow import Flow
from .program import Function, Program, Suspect, helpers, in_words, line, name_of, program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

_CLOCKS = frozenset({
    "datetime.date.today", "datetime.datetime.now", "datetime.datetime.today", "datetime.datetime.utcnow",
    "pygame.time.get_ticks", "time.monotonic", "time.monotonic_ns", "time.perf_counter", "time.perf_counter_ns",
    "time.process_time", "time.time", "time.time_ns",
})  # fmt: skip
#: The readings of a file that are followed.
_READINGS = 10
_WAITS = frozenset({"pygame.time.delay", "pygame.time.wait", "time.sleep"})
_OF_PYGAME = frozenset({"get_fps", "get_rawtime", "get_time", "tick", "tick_busy_loop"})


def clocks(program: Program) -> Iterator[Suspect]:
    """Find readings of the clock that reach a decision, a picture or a result of play."""
    for read in itertools.islice(_readings(program), _READINGS):
        if (used := next(Flow(program, program.play, read).uses(), None)) is not None:
            words = (
                f"reads the clock, {ast.unparse(read)[:40]}, and line {line(used)} uses it: {ast.unparse(used)[:60]}"
            )
            yield Suspect(line(read), words)


def timed(subject: Subject) -> None:
    """Leave undecided how easy a game is that reads the clock.

    Raises:
        Undecided: what play comes to depends on the speed of the machine.
    """
    program = program_of(subject)
    if program is None:
        return
    words = next((in_words([found])[0] for found in clocks(program)), "")
    if not words and (project := subject.target.project) is not None:
        files = helpers(program, project)
        found_in = (
            (path, each) for path, helper in files for each in itertools.chain(clocks(helper), _told(program, helper))
        )
        words = next((f"in {one_line(path)} {in_words([each])[0]}" for path, each in found_in), "")
    if words:
        raise Undecided(f"how often play wins depends on the speed of the machine: {words}")


def _told(program: Program, helper: Program) -> Iterator[Suspect]:
    """Find readings of the clock in a helper file that its functions return to play, which uses them."""
    for read in itertools.islice(_readings(helper), _READINGS):
        names = {function.name for function in Flow(helper, helper.play, read).results}
        calls = (
            node
            for function in program.play
            for node in function.nodes
            if isinstance(node, ast.Call) and name_of(node) in names and program.called(node, function) is None
        )
        for call in itertools.islice(calls, _READINGS):
            if (used := next(Flow(program, program.play, call).uses(), None)) is not None:
                where = f"line {line(used)} of the environment uses it: {ast.unparse(used)[:60]}"
                yield Suspect(line(read), f"reads the clock, {ast.unparse(read)[:40]}, and {where}")


def readings(program: Program) -> Iterator[Suspect]:
    """Find all readings of the clock during play, of which play has shown that some matter."""
    for read in _readings(program):
        yield Suspect(line(read), f"reads the clock, {ast.unparse(read)[:40]}")


def _readings(program: Program) -> Iterator[ast.Call]:
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Attribute(value=owner, attr=attr)) if attr in _OF_PYGAME:
                    if _is_clock(program, owner, function):
                        yield node
                case ast.Call(func=called) if program.path(called, function) in _CLOCKS:
                    yield node


def waits(program: Program, method: str) -> Iterator[Suspect]:
    """Find calls of a method, or of what it calls, that wait for the clock."""
    for function in program.reached(method):
        for node in function.nodes:
            if not isinstance(node, ast.Call):
                continue
            match node.func:
                case ast.Attribute(attr="tick" | "tick_busy_loop", value=owner) if node.args or node.keywords:
                    found = _is_clock(program, owner, function)
                case called:
                    found = program.path(called, function) in _WAITS
            if found:
                yield Suspect(line(node), f"waits: {ast.unparse(node)[:60]}")


def _is_clock(program: Program, node: ast.AST, function: Function) -> bool:
    """Whether an expression is a clock of pygame."""
    made = ((value.func, one) for value, one in program.values(node, function) if isinstance(value, ast.Call))
    return "pygame.time.Clock" in [program.path(called, one) for called, one in made]
