"""Times that are kept of a clock which starts again, and compared with it as if it had gone on."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of


def stale_times(program: Program) -> Iterator[Suspect]:
    """Find where play sets a counter of steps to zero, and leaves a time of that counter which it compares it with."""
    step = program.method(program.env, "step")
    if step is None:
        return
    # Methods of objects that reset() makes are played, too.
    stepping = [*program.reached("step"), *(one for one in program.play if program.bound_to(one) != program.env)]
    stepping = list(dict.fromkeys(stepping))
    for clock in _clocks(program, stepping):
        times = _Times(program, stepping, clock)
        for function in stepping:
            for target, value, statement in function.bindings:
                if function.field(target) != clock or not isinstance(value, ast.Constant) or value.value != 0:
                    continue
                renewed = times.renewed(function, statement)
                for kept, test in times.compared():
                    if kept not in renewed:
                        yield Suspect(
                            line(statement),
                            f"sets self.{clock} back during play, but not {kept}: line {line(test)} compares them",
                        )


def _clocks(program: Program, stepping: list[Function]) -> list[str]:
    """The attributes of the environment to which play adds 1, and nothing else."""
    added: dict[str, list[ast.AugAssign]] = {}
    for function in stepping:
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            if isinstance(node, ast.AugAssign) and (field := function.field(node.target)):
                added.setdefault(field, []).append(node)
    return [
        field
        for field, sums in added.items()
        if len(sums) == 1
        and isinstance(sums[0].op, ast.Add)
        and isinstance(sums[0].value, ast.Constant)
        and sums[0].value.value == 1
    ]


class _Times:
    """The attributes that are set to a clock, or to some steps after it."""

    def __init__(self, program: Program, stepping: list[Function], clock: str) -> None:
        self._program, self._stepping, self._clock = program, stepping, clock
        self._given = self._parameters()
        self._kept = self._stamps()

    def _parameters(self) -> set[tuple[Function, str]]:
        """The parameters to which each call gives the clock."""
        calls: dict[str, list[tuple[ast.Call, Function]]] = {}
        for function in self._stepping:
            for node in function.nodes:
                if isinstance(node, ast.Call):
                    calls.setdefault(name_of(node.func), []).append((node, function))
        found = set()
        for function in self._stepping:
            names = function.parameters[1 if function.me else 0 :]
            for number, name in enumerate(names):
                given = [call.args[number : number + 1] for call, _ in calls.get(function.name, ())]
                callers = [caller for _, caller in calls.get(function.name, ())]
                pairs = zip(given, callers, strict=True)
                if given and all(one and caller.field(one[0]) == self._clock for one, caller in pairs):
                    found.add((function, name))
        return found

    def _is_clock(self, node: ast.AST, function: Function) -> bool:
        own = self._program.bound_to(function) == self._program.env and function.field(node) == self._clock
        return own or (isinstance(node, ast.Name) and (function, node.id) in self._given)

    def _stamps(self) -> set[str]:
        """The names of attributes that play only sets to the clock, or to it and something."""
        found: dict[str, bool] = {}
        for function in self._stepping:
            for target, value, _ in function.bindings:
                if isinstance(target, ast.Attribute) and target.attr != self._clock and value is not None:
                    part = value.left if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add) else value
                    stamped = self._is_clock(part, function)
                    found[target.attr] = found.get(target.attr, True) and stamped
            for target, _ in function.writes:
                if isinstance(target, ast.Attribute):
                    found[target.attr] = False
        return {name for name, stamped in found.items() if stamped}

    def compared(self) -> Iterator[tuple[str, ast.AST]]:
        """Yield the kept times that a test compares with the clock, each with its first test."""
        seen: set[str] = set()
        for function in self._stepping:
            for test in function.nodes:
                sides = [test.left, *test.comparators] if isinstance(test, ast.Compare) else []
                parts = [part for side in sides for part in ast.walk(side)]
                if not any(self._is_clock(part, function) for part in parts):
                    continue
                for part in parts:
                    if isinstance(part, ast.Attribute) and part.attr in self._kept - seen:
                        seen.add(part.attr)
                        yield part.attr, test

    def renewed(self, function: Function, statement: ast.AST) -> set[str]:
        """The attributes that are set where the clock starts again: beside that statement, beside the calls of its
        function, or in what these places call, new objects included.
        """
        beside = [part for one in self._program.block(statement) for part in ast.walk(one)]
        waiting: list[tuple[ast.AST, Function]] = [(node, function) for node in beside]
        # Elsewhere in the function, what is set to the counter is set for its own reason.
        found = {
            name_of(target)
            for target, value, _ in function.bindings
            if value is None or not any(self._is_clock(part, function) for part in ast.walk(value))
        }
        for caller in self._stepping:
            for node in caller.nodes:
                if isinstance(node, ast.Call) and name_of(node.func) == function.name:
                    whole = next((one for one in self._program.around(node, caller) if isinstance(one, ast.stmt)), node)
                    block = self._program.block(whole)
                    waiting += [(part, caller) for one in block for part in ast.walk(one)]
        seen: set[str] = set()
        while waiting:
            node, caller = waiting.pop()
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                found.add(node.attr)
            if isinstance(node, ast.Call) and (name := name_of(node.func)) not in seen:
                seen.add(name)
                classes = self._program.lineage(name)
                for one in self._program.all:
                    if one.name == name or one.owner in classes:
                        waiting += [(part, one) for part in one.nodes]
                # The body of a dataclass sets its fields.
                for owner in classes:
                    found |= {
                        name_of(part.target)
                        for part in self._program.classes[owner].body
                        if isinstance(part, ast.AnnAssign)
                    }
        return found
