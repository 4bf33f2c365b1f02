"""Success that no episode can report."""

from __future__ import annotations

import ast
import itertools
from collections.abc import Callable, Iterator, Mapping

from .logic import is_false, names_success
from .program import Function, Program, Suspect, line, name_of

#: Calls that give the same value again at once, and those that only make a bool.
PURE = frozenset({"abs", "all", "any", "bool", "bool_", "float", "int", "len", "max", "min", "sum"})
_CASTS = frozenset({"bool", "bool_"})
#: The most conditions of a table of truth.
CONDITIONS = 10

#: The value of a condition, by the values of its atoms.
_Value = Callable[[Mapping[str, bool]], bool]


def unreachable_successes(program: Program) -> Iterator[Suspect]:
    """Find a report of success that is always False, and one that no flag of the end accompanies."""
    yield from _never_reported(program)
    yield from _never_at_the_end(program)


def _never_reported(program: Program) -> Iterator[Suspect]:
    decided = [
        target
        for function in program.reached("step")
        for target, value, _ in function.bindings
        if names_success(name_of(target)) and not is_false(value)
    ]
    for key, places in _reports(program).items():
        stepping = {node for function in program.reached("step") for node in function.nodes}
        lines = [line(value) for value in places if value in stepping]
        if decided and lines and all(is_false(value) for value in places):
            words = f"reports {key!r} as False, and no line as true, although line {line(decided[0])} decides success"
            yield Suspect(lines[0], words)


def _reports(program: Program) -> dict[str, list[ast.expr]]:
    """What the file stores under each key that stands for success; without keys that it uses in other ways."""
    stored: dict[str, list[ast.expr]] = {}
    known: set[ast.AST] = set()

    def store(key: ast.expr | str | None, value: ast.expr) -> None:
        known.update([key] if isinstance(key, ast.Constant) else [])
        name = key.value if isinstance(key, ast.Constant) else key
        if isinstance(name, str) and names_success(name):
            stored.setdefault(name, []).append(value)

    for node in program.nodes:
        match node:
            case ast.Dict(keys=keys, values=values):
                for key, value in zip(keys, values, strict=True):
                    store(key, value)
            case ast.Call(keywords=keywords) if keywords:
                for keyword in keywords:
                    store(keyword.arg, keyword.value)
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    if isinstance(target, ast.Subscript):
                        store(target.slice, value)
            case ast.Subscript(ctx=ast.Load(), slice=ast.Constant() as read):
                known.add(read)
            case ast.Call(func=ast.Attribute(attr="get"), args=[ast.Constant() as read, *_]):
                known.add(read)
    others = {node.value for node in program.nodes if isinstance(node, ast.Constant) and node not in known}
    return {key: values for key, values in stored.items() if key not in others}


def _never_at_the_end(program: Program) -> Iterator[Suspect]:
    step = program.method(program.env, "step")
    returns = [node for node in step.nodes if isinstance(node, ast.Return)] if step is not None else []
    suspects = []
    for node in returns:
        if step is None or not isinstance(node.value, ast.Tuple) or len(node.value.elts) != 5:
            return
        _, _, terminated, truncated, info = node.value.elts
        success = _success_in(info, step)
        if success is None:
            return
        conditions = Conditions(program, step, node)
        values = [conditions.of(each, node) for each in (success, terminated, truncated)]
        if len(conditions.atoms) > CONDITIONS:
            return
        rows = list(conditions.rows())
        told = [row for row in rows if values[0](row)]
        if not told:
            continue
        # Where the code never truncates, a wrapper may, and ends an episode that has succeeded.
        if any(values[1](row) or values[2](row) for row in told) or not any(values[2](row) for row in rows):
            return
        suspects.append(Suspect(line(node), "reports success only where terminated and truncated are False"))
    yield from suspects


def _success_in(info: ast.expr, step: Function) -> ast.expr | None:
    """What a dictionary has under a key that stands for success, False without one; None if the text does not say."""
    if isinstance(info, ast.Name):
        bound = [value for target, value, _ in step.bindings if name_of(target) == info.id]
        changed = any(name_of(target) == info.id for target, _ in step.writes)
        info = bound[0] if len(bound) == 1 and bound[0] is not None and not changed else info
    if not isinstance(info, ast.Dict) or None in info.keys:
        return None
    found = [
        value
        for key, value in zip(info.keys, info.values, strict=True)
        if isinstance(key, ast.Constant) and isinstance(key.value, str) and names_success(key.value)
    ]
    return None if len(found) > 1 else found[0] if found else ast.Constant(False)


class Conditions:
    """Conditions of one return statement as functions of atoms, which are tests that the text does not take apart.

    A name that one statement of the method's own block binds stands for its value. The same text is the same atom
    within one statement only, because its value may change between two.
    """

    def __init__(self, program: Program, step: Function, end: ast.Return) -> None:
        self._program = program
        self._step = step
        self._end = end
        self.atoms: dict[str, tuple[ast.expr, ast.AST]] = {}

    def rows(self) -> Iterator[dict[str, bool]]:
        """All values of the atoms."""
        for values in itertools.product((False, True), repeat=len(self.atoms)):
            yield dict(zip(self.atoms, values, strict=True))

    def of(self, node: ast.expr, place: ast.AST) -> _Value:
        """The value of an expression in a statement."""
        match node:
            case ast.Constant(value=bool() as value):
                return lambda _: value
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                inner = self.of(operand, place)
                return lambda row: not inner(row)
            case ast.BoolOp(op=op, values=parts):
                values, decide = [self.of(each, place) for each in parts], all if isinstance(op, ast.And) else any
                return lambda row: decide(value(row) for value in values)
            case ast.Call(args=[ast.expr() as operand], keywords=[]) if name_of(node) in _CASTS:
                return self.of(operand, place)
            case ast.Name() if (bound := self._binding(node)) is not None:
                return self.of(*bound)
        again = all(name_of(each) in PURE for each in ast.walk(node) if isinstance(each, ast.Call))
        atom = f"{ast.unparse(node)} @{id(place)}{'' if again else f' {id(node)}'}"
        self.atoms.setdefault(atom, (node, place))
        return lambda row: row[atom]

    def _binding(self, name: ast.Name) -> tuple[ast.expr, ast.AST] | None:
        """The value and the statement of a name that only one statement, before the return, binds or changes."""
        stores = [
            node
            for node in self._step.nodes
            if isinstance(node, ast.Name) and node.id == name.id and not isinstance(node.ctx, ast.Load)
        ]
        bound = [(value, place) for target, value, place in self._step.bindings if target in stores]
        if len(stores) != 1 or len(bound) != 1 or name.id in self._step.parameters:
            return None
        value, place = bound[0]
        before = place in self._step.node.body and _position(place) < _position(self._end)
        return (value, place) if value is not None and before else None


def _position(node: ast.AST) -> tuple[int, int]:
    return line(node), getattr(node, "col_offset", 0)
