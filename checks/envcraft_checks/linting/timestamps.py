"""Times that are kept of a clock which starts again, and compared with it as if it had gone on."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

#: Names by which code gives an attribute a value that is not written as an assignment.
_INDIRECT = frozenset({"__dict__", "deepcopy", "delattr", "setattr", "vars"})
#: What makes an object in a way that names no class.
_COPIES = frozenset({"copy", "copy.copy", "dataclasses.replace"})


def stale_times(program: Program) -> Iterator[Suspect]:
    """Find where play sets a counter of steps to zero, and leaves a time of that counter which it compares it with."""
    step = program.method(program.env, "step")
    copied = not _COPIES.isdisjoint(program.imports.values())
    if step is None or copied or any(name_of(node) in _INDIRECT for node in program.nodes):
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
        self._sums: set[str] = set()
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

    def _holder(self, owner: str) -> str:
        """The attribute of the environment that holds the only instance of a class, "" if there may be others."""
        made = [
            node for node in self._program.nodes if isinstance(node, ast.Call) and name_of(node.func) == owner and owner
        ]
        parent = self._program.parents[made[0]] if len(made) == 1 else None
        match parent:
            case ast.Assign(targets=[ast.Attribute(attr=name)]):
                return name
        return ""

    def _stamps(self) -> set[str]:
        """The names of attributes that play only sets to the clock, or to it and something."""
        found: dict[str, bool] = {}
        for function in self._stepping:
            for target, value, _ in function.bindings:
                if isinstance(target, ast.Attribute) and target.attr != self._clock and value is not None:
                    added = isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add)
                    part = value.left if isinstance(value, ast.BinOp) and added else value
                    stamped = self._is_clock(part, function)
                    # Of other objects, those that are known by one name, which the restart may set.
                    owner = self._program.bound_to(function)
                    stamped &= bool(function.field(target))
                    stamped &= owner == self._program.env or bool(self._holder(owner))
                    found[target.attr] = found.get(target.attr, True) and stamped
                    self._sums |= {target.attr} if added else set()
            for target, _ in function.writes:
                if isinstance(target, ast.Attribute):
                    found[target.attr] = False
        return {name for name, stamped in found.items() if stamped}

    def compared(self) -> Iterator[tuple[str, ast.AST]]:
        """Yield the kept times that tests take for earlier or later than the clock, each with its first test.

        These are ``clock - time >= number``, and ``clock >= time`` or ``clock < time`` for a time that is set to a sum.
        A time that another test compares in a different way may be kept for another reason, such as a record.
        """
        found: dict[str, ast.AST] = {}
        others: set[str] = set()
        for function in self._stepping:
            for node in function.nodes:
                parts = [*ast.walk(node)] if isinstance(node, ast.Compare) else []
                named = {part.attr for part in parts if isinstance(part, ast.Attribute) and part.attr in self._kept}
                if not named or not any(self._is_clock(part, function) for part in parts):
                    continue
                name = self._compares(node, function)
                alone = not any(
                    isinstance(one, ast.BoolOp) and _has_flag(one, node, function)
                    for one in self._program.around(node, function)
                )
                if name and alone:
                    found.setdefault(name, node)
                    named -= {name}
                others |= named
        yield from ((name, node) for name, node in found.items() if name not in others)

    def _compares(self, test: ast.AST, function: Function) -> str:
        """The time of a test that goes wrong when the clock starts again, "" if it is another test."""
        match test:
            case ast.Compare(
                left=ast.BinOp(left=clock, op=ast.Sub(), right=ast.Attribute(attr=name)), ops=[ast.Gt() | ast.GtE()]
            ) if self._is_clock(clock, function) and name in self._kept:
                return name
            case ast.Compare(left=clock, ops=[ast.Lt() | ast.GtE()], comparators=[ast.Attribute(attr=name)]) if (
                self._is_clock(clock, function) and name in self._sums
            ):
                return name
        return ""

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
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del):
                found.add(node.attr)
                for one in self._stepping:
                    if self._holder(one.owner) == node.attr:
                        found |= {name_of(target) for target, _, _ in one.bindings}
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


def _has_flag(test: ast.BoolOp, node: ast.AST, function: Function) -> bool:
    """Whether another part of a test is an attribute, which may say that the time does not count."""
    return any(function.field(one) for part in test.values if part is not node for one in ast.walk(part))
