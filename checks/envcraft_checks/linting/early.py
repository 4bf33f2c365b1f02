"""Successes that info reports before the step decides them."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import MUTATORS, Function, Program, Suspect, line, name_of, root
from .reported import reported, statement_of, stored

_FLAGS = 5
_DEPTH = 4
#: The comparisons that an addition to the left side, or a subtraction from it, may make true.
_ADDS: dict[type[ast.operator], tuple[type[ast.cmpop], ...]] = {
    ast.Add: (ast.Gt, ast.GtE, ast.Eq),
    ast.Sub: (ast.Lt, ast.LtE, ast.Eq),
}
_SHRINKS = frozenset({"clear", "discard", "pop", "popitem", "popleft", "remove"})
_COMPOUND = (ast.If, ast.For, ast.While, ast.Try, ast.With, ast.Match)
_SEVERAL = ast.Tuple | ast.List
_LEAVES = ast.Return | ast.Raise | ast.Continue | ast.Break


def early_successes(program: Program) -> Iterator[Suspect]:
    """Find what decides success and the end, and changes after info has been made from it."""
    step = program.method(program.env, "step")
    if step is None or not reported(program, step):
        return
    order = _Order(program, step)
    for end in step.nodes:
        if isinstance(end, ast.Return) and isinstance(end.value, ast.Tuple) and len(end.value.elts) == _FLAGS:
            for key, value, function, made in stored(program, end, step):
                if function is step and (order.shares_name(value, end) or order.is_event(value, end)):
                    continue
                for name, read in order.readings(value, function, made):
                    change = order.change(name, read, end, value)
                    if change is not None:
                        words = (
                            f"takes {key!r} from {name} before line {line(change)} changes it and may end the episode,"
                            " so that info does not report the last change"
                        )
                        yield Suspect(line(read), words)
                        return


class _Order:
    """What the statements of step() read and change, one after the other."""

    def __init__(self, program: Program, step: Function) -> None:
        self.program = program
        self.step = step

    def readings(self, value: ast.expr, function: Function, made: ast.stmt) -> Iterator[tuple[str, ast.stmt]]:
        """The attributes and names that decide a value, as texts, each with the statement of step() that reads it."""
        waiting = [(value, made)]
        seen: set[str] = set()
        while waiting:
            one, place = waiting.pop()
            for name in self._read(one, function, _DEPTH):
                if name in seen:
                    continue
                seen.add(name)
                bound = self._bound(name) if function is self.step else []
                if len(bound) == 1 and isinstance(bound[0][0], ast.Assign) and bound[0][1] is not None:
                    waiting.append((bound[0][1], bound[0][0]))
                else:
                    yield name, place

    def shares_name(self, value: ast.expr, end: ast.Return) -> bool:
        """Whether success and a flag of the end are made of one local value, so that they agree."""
        assert isinstance(end.value, ast.Tuple)
        flags = {each for flag in end.value.elts[_FLAGS - 3 : _FLAGS - 1] for each in self._names(flag)}
        return not flags.isdisjoint(self._names(value))

    def is_event(self, value: ast.expr, end: ast.Return) -> bool:
        """Whether a value stands for an event of the game: where it is true, step() changes what the end depends on.

        A bid that is won costs money, for example, and the game ends without money.
        """
        assert isinstance(end.value, ast.Tuple)
        flags = end.value.elts[_FLAGS - 3 : _FLAGS - 1]
        deciding = {
            each for flag in flags for one in (flag, *self._sources(flag)) for each in self._read(one, self.step, 1)
        }
        return isinstance(value, ast.Name) and any(
            f"self.{self.step.field(target)}" in deciding
            for target, node in [*((one, node) for one, _, node in self.step.bindings), *self.step.writes]
            for around in self.program.around(node, self.step)
            if isinstance(around, ast.If) and isinstance(around.test, ast.Name) and around.test.id == value.id
        )

    def _sources(self, value: ast.expr) -> list[ast.expr]:
        """The values that step() binds to the names of an expression."""
        names = self._names(value)
        return [bound for name in names for _, bound in self._bound(name) if bound is not None]

    def _names(self, value: ast.expr) -> set[str]:
        """The names of which step() makes an expression."""
        found: set[str] = set()
        waiting = [value]
        while waiting:
            for node in ast.walk(waiting.pop()):
                if isinstance(node, ast.Name) and node.id in self.step.local and node.id not in found:
                    found.add(node.id)
                    waiting += [bound for _, bound in self._bound(node.id) if bound is not None]
        return found - {self.step.me}

    def _bound(self, name: str) -> list[tuple[ast.stmt, ast.expr | None]]:
        """The statements of step() that bind a name, with the values."""
        return [
            (statement_of(self.program, node), value)
            for target, value, node in [
                *self.step.bindings,
                *((node.target, None, node) for node in self.step.nodes if isinstance(node, ast.AugAssign)),
            ]
            if isinstance(target, ast.Name) and target.id == name
        ]

    def change(self, name: str, read: ast.stmt, end: ast.Return, value: ast.expr) -> ast.stmt | None:
        """The first statement between two that may make success true by a name, and on which the end depends."""
        if not self._leads(read, end):
            return None
        for node in self.step.nodes:
            if isinstance(node, ast.stmt) and node is not read and not isinstance(node, _COMPOUND):
                leads = self._leads(read, node) and (node is end or self._leads(node, end, through=True))
                wins = self._winning(node, name, value) if leads else []
                if wins and self._decides(name, node, end, wins):
                    return node
        return None

    def _leads(self, one: ast.stmt, two: ast.stmt, through: bool = False) -> bool:
        """Whether a later statement follows one: always, or with `through` if the branch of the first runs."""
        first, second = self._blocks(one), self._blocks(two)
        for block, place in first:
            for other, later in second:
                if block is other:
                    return place < later
            # The rest of this block comes before what stands behind it.
            if not through or any(isinstance(each, _LEAVES) for each in block[place:]):
                return False
        return False

    def _blocks(self, node: ast.AST) -> list[tuple[list[ast.stmt], int]]:
        """The blocks around a statement, innermost first, with its place in each."""
        found = []
        while node is not self.step.node:
            if block := self.program.block(node):
                found.append((block, next(at for at, each in enumerate(block) if each is node)))
            node = self.program.parents[node]
        return found

    def _read(self, value: ast.AST | None, function: Function, depth: int) -> set[str]:
        """The attributes of self, as texts, and the names of step() that an expression reads, also in what it calls."""
        found: set[str] = set()
        for node in ast.walk(value) if value is not None else ():
            if isinstance(node, ast.Name) and node.id in function.local:
                if function is self.step:
                    found.add(node.id)
                elif depth:
                    for bound, _ in self.program.values(node, function):
                        found |= self._read(bound, function, depth - 1)
            elif field := function.field(node):
                method = self.program.method(self.program.bound_to(function), field)
                if method is None:
                    found.add(f"self.{field}")
                elif depth:
                    for inner in method.nodes:
                        if isinstance(inner, ast.Return | ast.If):
                            part = inner.value if isinstance(inner, ast.Return) else inner.test
                            found |= self._read(part, method, depth - 1)
        return found

    def _writes(self, node: ast.AST, name: str, function: Function, depth: int) -> Iterator[tuple[ast.AST, Function]]:
        """The statements that a statement runs, and that bind or change a name or an attribute."""
        for one in ast.walk(node):
            match one:
                case ast.Assign(targets=targets) | ast.Delete(targets=targets):
                    if any(self._is(root(target), name, function) for each in targets for target in _parts(each)):
                        yield one, function
                case ast.Call(func=ast.Attribute(attr=attr, value=owner)) if attr in MUTATORS and not function.field(
                    one.func
                ):
                    if self._is(root(owner), name, function):
                        yield one, function
                case ast.AugAssign(target=target) | ast.AnnAssign(target=target):
                    if self._is(root(target), name, function):
                        yield one, function
                case ast.Call() if depth and (called := self.program.called(one, function)) is not None:
                    if called.me and called is not function:
                        for statement in called.node.body:
                            yield from self._writes(statement, name, called, depth - 1)

    def _is(self, target: ast.AST, name: str, function: Function) -> bool:
        if field := function.field(target):
            return f"self.{field}" == name
        return isinstance(target, ast.Name) and target.id == name and function is self.step

    def _winning(self, node: ast.stmt, name: str, value: ast.expr) -> list[tuple[ast.AST, Function]]:
        """The statements that a statement runs, and that may make an expression true by changing a name."""
        writes = self._writes(node, name, self.step, _DEPTH)
        return [(one, function) for one, function in writes if _may_become_true(one, name, value)]

    def _decides(self, name: str, change: ast.stmt, end: ast.Return, wins: list[tuple[ast.AST, Function]]) -> bool:
        """Whether a flag of the end depends on a name as it is after a change, or on what changes beside it."""
        assert isinstance(end.value, ast.Tuple)
        names, returns = {name}, False
        for win, function in wins:
            for one in self._beside(win):
                match one:
                    case ast.Assign(targets=[target], value=ast.Constant(value=True)) if function.field(target):
                        names.add(f"self.{function.field(target)}")
                    case ast.Return(value=ast.Tuple(elts=[ast.Constant() as value, *_]) | (ast.Constant() as value)):
                        returns |= _is_true(value) is True and function is not self.step
        flags = end.value.elts[_FLAGS - 3 : _FLAGS - 1]
        returned = returns and any(
            statement is change for flag in flags if isinstance(flag, ast.Name) for statement, _ in self._bound(flag.id)
        )
        return returned or any(self._follows(flag, end, each, change, _DEPTH) for flag in flags for each in names)

    def _beside(self, node: ast.AST) -> list[ast.stmt]:
        """The statements of the branch in which a node stands."""
        node = statement_of(self.program, node)
        return [] if isinstance(self.program.parents[node], ast.FunctionDef) else self.program.block(node)

    def _follows(self, flag: ast.expr, place: ast.stmt, name: str, change: ast.stmt, depth: int) -> bool:
        if not isinstance(flag, ast.Constant):
            read = self._read(flag, self.step, _DEPTH)
            if name in read:
                return True
        elif flag.value is not True:
            return False
        if place is not change and (self._is_after(place, change) or place in self._beside(change)):
            # Where the change has been made, or by what it has made.
            near = self._blocks(change)[0][0]
            if isinstance(flag, ast.Constant) and any(block is near for block, _ in self._blocks(place)):
                return near is not self.step.node.body
            if any(name in self._read(test, self.step, _DEPTH) for test in self._tests_after(place, change)):
                return True
        if depth == 0 or isinstance(flag, ast.Constant):
            return False
        names = {node.id for node in ast.walk(flag) if isinstance(node, ast.Name)}
        return any(
            self._follows(value if value is not None else _whole(statement), statement, name, change, depth - 1)
            for each in names
            for statement, value in self._bound(each)
            if self._is_after(statement, change) or statement in [change, *self._beside(change)]
        )

    def _is_after(self, one: ast.AST, two: ast.AST) -> bool:
        return (line(one), getattr(one, "col_offset", 0)) > (line(two), getattr(two, "col_offset", 0))

    def _tests_after(self, node: ast.AST, change: ast.stmt) -> Iterator[ast.expr]:
        """The tests around a node that are made after a change."""
        while node is not self.step.node:
            parent = self.program.parents[node]
            if isinstance(parent, ast.If) and node is not parent.test and self._is_after(parent, change):
                yield parent.test
            node = parent


def _parts(target: ast.expr) -> list[ast.expr]:
    """The targets of an assignment that may bind several."""
    return [each for one in target.elts for each in _parts(one)] if isinstance(target, _SEVERAL) else [target]


def _whole(statement: ast.stmt) -> ast.expr:
    """The value of a statement that binds several names at once."""
    value = getattr(statement, "value", None)
    return value if isinstance(value, ast.expr) else ast.Constant(None)


def _may_become_true(write: ast.AST, name: str, value: ast.expr) -> bool:
    """Whether a change of a name may make an expression true, as far as constants and directions show."""
    stored = isinstance(write, ast.Assign) and any(isinstance(target, ast.Subscript) for target in write.targets)
    if stored and not isinstance(getattr(write, "value", None), ast.Constant):
        return False
    if ast.unparse(value) == name:
        # A container that info holds shows its changes.
        rebinds = isinstance(write, ast.Assign | ast.AnnAssign | ast.AugAssign) and not stored
        return rebinds and _is_true(getattr(write, "value", None)) is not False
    compares = [node for node in ast.walk(value) if isinstance(node, ast.Compare) and len(node.ops) == 1]
    about = [node for node in compares if name in map(ast.unparse, ast.walk(node.left))]
    inverted = any(isinstance(node, ast.Not) for node in ast.walk(value))
    if isinstance(write, ast.Call | ast.Delete):
        empties = isinstance(write, ast.Delete) or name_of(write) in _SHRINKS
        kinds = _ADDS[ast.Sub if empties else ast.Add]
        zero = any(_is_true(node.comparators[0]) is False for node in about)
        fits = any(isinstance(node.ops[0], kinds) for node in about) and (empties or not zero)
        return fits or (empties and inverted) or (not about and not inverted)
    if not about or inverted:
        return _is_true(getattr(write, "value", None)) is not False
    for compare in about:
        kind, new = compare.ops[0], getattr(write, "value", ast.Constant(None))
        if isinstance(write, ast.AugAssign):
            fits = isinstance(kind, _ADDS.get(type(write.op), (ast.cmpop,)))
        else:
            other = not isinstance(new, ast.Constant) or not isinstance(kind, ast.Eq)
            fits = other or ast.dump(compare.comparators[0]) == ast.dump(new)
        if fits:
            return True
    return False


def _is_true(value: ast.expr | None) -> bool | None:
    """Whether a constant counts as true; None for another expression."""
    return bool(value.value) if isinstance(value, ast.Constant) else None
