"""Play that a step limit does not end: what starts its counter again, skips it, or passes its number."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import NamedTuple

from .limits import RESULTS, TRUNCATED, adds_one, bound_of, conditions, counts_always, flag_tests, sets_back
from .program import Function, Program, Suspect, arguments, line, name_of

#: Words in names of what is so when an episode is over.
_OVER = re.compile(
    r"(?i:done|terminat|truncat|lost|dead(?!line)|died|success|victory|won\b|win\b|finish|(?<![a-z])(over|ended|lose))"
    r"|(game|match|round|level|is|has)(over|ended)|[a-z](Over|Ended|Lose)"
)
#: How often a limit that starts again must fit into the longest episode that is allowed: one event doubles it.
_TWICE = 2


class _Counter(NamedTuple):
    """The one attribute that counts steps and truncates an episode.

    Attributes:
        step: the method.
        play: all functions that a step runs.
        name: the attribute.
        most: the number that it is compared with.
        kind: the comparison.
        others: attributes that count steps, too, in the tests of the end.
    """

    step: Function
    play: list[Function]
    name: str
    most: float
    kind: type[ast.cmpop]
    others: list[str]


def unlimited(program: Program, limit: int) -> Iterator[Suspect]:
    """Find what lets an episode last longer than `limit` although the code counts its steps.

    The truncation must test one counter, and nothing else in the tests of the end may count steps. Then an episode may
    last longer if play sets the counter back, counts only some actions, or changes the counter past a number that it
    must equal.

    Args:
        program: the file.
        limit: the most steps of an episode that the contract allows.
    """
    counter = _only_counter(program)
    if counter is None:
        return
    step, play, name, most, kind, others = counter
    if others:
        # Unless a return comes before all of these counts.
        yield from _returned(program, step, play, [name, *others])
        return
    if most * _TWICE > limit:
        yield from _restarts(program, play, name)
    yield from _paused(program, step, play, name)
    if kind is ast.Eq:
        yield from _jumps(play, name)
        yield from _passed(program, step, play, name)


def restarted(program: Program, limit: int) -> tuple[str, int, Suspect] | None:
    """Find a counter of steps that play sets back, where one restart is not enough to outlast `limit`.

    Only play can show whether it starts again often enough.

    Returns:
        The attribute, the number at which it ends an episode, and the first place that sets it back; None if there is
        no such counter.
    """
    counter = _only_counter(program)
    if counter is None or counter.others or counter.most * _TWICE > limit:
        return None
    for suspect in _restarts(program, counter.play, counter.name):
        return counter.name, int(counter.most), suspect
    return None


def starts_again(program: Program) -> bool:
    """Whether play sets back the only counter of steps that truncates an episode."""
    counter = _only_counter(program)
    return counter is not None and any(_restarts(program, counter.play, counter.name))


def _only_counter(program: Program) -> _Counter | None:
    step = program.method(program.env, "step")
    play = program.reached("step")
    if step is None or any(function.name == "reset" for function in play):
        return None
    tests = list(flag_tests(program, step, TRUNCATED))
    bounds = [found for test, function in tests if (found := bound_of(program, test, function)) is not None]
    counted = [
        (name, most, kind)
        for name, most, kind in bounds
        if adds_one(play, name) or (kind is ast.Eq and _chosen(program, step, play, name))
    ]
    if len(counted) != 1 or len(bounds) != 1:
        return None
    name, most, kind = counted[0]
    ended = {name_of(node) for test, _ in flag_tests(program, step, TRUNCATED - 1) for node in ast.walk(test)}
    ended |= {name_of(node) for test, _ in tests for node in ast.walk(test)}
    others = [other for other in sorted(ended - {name, ""}) if counts_always(program, step, play, other)]
    return _Counter(step, play, name, most, kind, others)


def _chosen(program: Program, step: Function, play: list[Function], name: str) -> bool:
    """Whether the action decides how much a step adds to an attribute of this name, which nothing else changes."""
    sums = [node for node in step.nodes if isinstance(node, ast.AugAssign) and name_of(node.target) == name]
    decided = _decided(program, step, play)
    return len(sums) == 1 and bool(_names(sums[0].value) & decided) and counts_always(program, step, play, name)


def _restarts(program: Program, play: list[Function], name: str) -> Iterator[Suspect]:
    for statement, function in sets_back(play, name):
        beside = _suite(program, statement)
        tests = list(conditions(program, statement, function))
        words = [ast.unparse(test) for test in tests]
        words += [ast.unparse(target) for one in beside if isinstance(one, ast.Assign) for target in one.targets]
        if any(map(_OVER.search, words)) or any(isinstance(one, ast.Return | ast.Raise) for one in beside):
            # The episode may end there.
            continue
        if any(_is_early(node, name) for test in tests for node in ast.walk(test)):
            # It may start again only while few steps are counted.
            continue
        yield Suspect(line(statement), f"sets {ast.unparse(statement.targets[0])} back during play")


def _is_early(node: ast.AST, name: str) -> bool:
    """Whether a comparison holds only while an attribute of this name is small."""
    match node:
        case ast.Compare(left=ast.Attribute(attr=attr), ops=[ast.Lt() | ast.LtE()]):
            return attr == name
    return False


def _suite(program: Program, statement: ast.stmt) -> list[ast.stmt]:
    """The statements among which a statement stands, unless they are those of a whole function."""
    return [] if isinstance(program.parents[statement], ast.FunctionDef) else program.block(statement)


def _paused(program: Program, step: Function, play: list[Function], name: str) -> Iterator[Suspect]:
    """Find the test of an action under which a step does not count: around the sum, or around a return before it."""
    adds = adds_one(play, name)
    if len(adds) != 1 or adds[0][1] is not step or len(step.parameters) < _TWICE:
        return
    count = adds[0][0]
    decided = _decided(program, step, play)
    for test in conditions(program, count, step):
        if _names(test) & decided:
            yield Suspect(line(count), f"counts a step only if {ast.unparse(test)[:40]}")
            return
    yield from _returned(program, step, play, [name])


def _returned(program: Program, step: Function, play: list[Function], names: list[str]) -> Iterator[Suspect]:
    """Find the test under which step() returns, as long as the player wants, before any of these counts."""
    counts = [
        node
        for node in step.node.body
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Attribute) and node.target.attr in names
    ]
    if len(step.parameters) < _TWICE or not set(names) <= {name_of(node.target) for node in counts}:
        return
    first, decided = min(map(line, counts)), _decided(program, step, play)
    for node in _goes_on(step):
        tests = list(conditions(program, node, step)) if line(node) < first else []
        if tests and _lasts(program, step, node, tests[0], decided):
            yield Suspect(line(node), f"returns if {ast.unparse(tests[0])[:40]}, before the step is counted")
            return


def _goes_on(step: Function) -> list[ast.Return]:
    """The return statements whose flags are false."""
    return [
        node
        for node in step.nodes
        if isinstance(node, ast.Return)
        and isinstance(node.value, ast.Tuple)
        and len(node.value.elts) == RESULTS
        and all(
            isinstance(flag, ast.Constant) and flag.value is False
            for flag in node.value.elts[TRUNCATED - 1 : TRUNCATED + 1]
        )
    ]


def _lasts(program: Program, step: Function, end: ast.Return, test: ast.expr, decided: set[str]) -> bool:
    """Whether the player can keep a test true: by the action, in a state that the step leaves as it is."""
    if _names(test) <= decided or _stays(program, step, end, test, decided):
        return True
    parts = test.values if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And) else []
    states = [part for part in parts if not _names(part) <= decided]
    fields = {step.field(node) for part in states for node in ast.walk(part)} - {""}
    names = {node.id for part in states for node in ast.walk(part) if isinstance(node, ast.Name)}
    calls = any(isinstance(node, ast.Call) for part in states for node in ast.walk(part))
    if (
        len(states) == len(parts)
        or calls
        or not fields
        or names & step.local - {step.me}
        or any(map(_OVER.search, fields))
    ):
        return False
    branch = {node for statement in program.block(end) for node in ast.walk(statement)}
    if sum(isinstance(node, ast.Return) for node in branch) > 1:
        return False
    before = {node for node in step.nodes if 0 < line(node) < line(test)}
    called = [program.called(node, step) for node in branch | before if isinstance(node, ast.Call)]
    run = [(step, branch | before)]
    run += [(one, set(one.nodes)) for one in program.reached(*(each.name for each in called if each is not None))]
    return not any(_touches(function, nodes, fields) for function, nodes in run)


def _touches(function: Function, nodes: set[ast.AST], fields: set[str]) -> bool:
    """Whether some nodes may change what attributes of ``self`` hold: they store into it, or call its methods."""
    for node in nodes:
        match node:
            case ast.Name(id="setattr" | "vars") | ast.Attribute(attr="__dict__"):
                return True
            case ast.Attribute(ctx=ast.Store() | ast.Del()) | ast.Subscript(ctx=ast.Store() | ast.Del()):
                target: ast.AST = node
            case ast.Call(func=ast.Attribute(value=value)):
                target = value
            case _:
                continue
        while isinstance(target, ast.Attribute | ast.Subscript):
            if function.field(target) in fields:
                return True
            target = target.value
    return False


def _stays(program: Program, step: Function, end: ast.Return, test: ast.expr, decided: set[str]) -> bool:
    """Whether a state lasts as long as the player wants: one attribute, which its branch changes only for an action."""
    field = step.field(test)
    if not field or _OVER.search(field):
        return False
    inside = [node for statement in program.block(end) for node in ast.walk(statement)]
    written = [*((target, node) for target, _, node in step.bindings), *step.writes]
    changes = [node for target, node in written if step.field(target) == field and node in inside]
    chosen = all(
        any(_names(each) <= decided for each in conditions(program, node, step) if each in inside) for node in changes
    )
    return chosen and not _changed_by_calls(program, inside, step, field, decided)


def _changed_by_calls(
    program: Program, nodes: list[ast.AST], function: Function, field: str, decided: set[str]
) -> bool:
    """Whether a function that some nodes call, or one that it calls, changes an attribute, unless the action decides
    it: by an argument that it gets, in a test.
    """
    stored = [node for node in program.nodes if isinstance(node, ast.Attribute) and node.attr == field]
    outside = any(isinstance(node.ctx, ast.Store) and name_of(node.value) != "self" for node in stored)
    if outside or any(name_of(node) in ("setattr", "__dict__", "vars") for node in program.nodes):
        return True
    names = [name_of(target) for target, _, _ in function.bindings]
    waiting = [(node, function, {name for name in decided if names.count(name) < _TWICE}) for node in nodes]
    seen: set[tuple[Function, frozenset[str]]] = set()
    changes = 0
    while waiting:
        node, caller, known = waiting.pop()
        called = program.called(node, caller) if isinstance(node, ast.Call) else None
        if called is None or not isinstance(node, ast.Call):
            continue
        given = {name for name, value in arguments(node, called) if set() < _names(value) <= known}
        given -= {name_of(target) for target, _, _ in called.bindings}
        if (called, frozenset(given)) in seen:
            continue
        seen.add((called, frozenset(given)))
        written = [*((target, one) for target, _, one in called.bindings), *called.writes]
        for target, one in written:
            if called.field(target) == field:
                # Where several statements change it, one of them may do so in any case.
                changes += 1
                chosen = any(set() < _names(test) <= given for test in conditions(program, one, called))
                if not chosen or changes > 1:
                    return True
        waiting += [(one, called, given) for one in called.nodes]
    return False


def _decided(program: Program, step: Function, play: list[Function]) -> set[str]:
    """The names and attributes that the action alone decides in every step."""
    found = {step.parameters[1]}
    for target, part, statement in step.bindings:
        # `move, fire = (int(one) for one in action)` gives no name a value of its own.
        value = statement.value if part is None and isinstance(statement, ast.Assign) else part
        names = _names(value) if value is not None and program.parents[statement] is step.node else set()
        if names and value is not None and names - _running(value) <= found:
            found.add(name_of(target))
    kept = {target.attr for one in play for target, _, _ in one.bindings if isinstance(target, ast.Attribute)}
    changed = [target.attr for one in play for target, _, _ in one.bindings if isinstance(target, ast.Attribute)]
    return {one for one in found if one not in kept or changed.count(one) == 1}


def _running(value: ast.AST) -> set[str]:
    """The names that run through what a comprehension goes through."""
    loops = (node for node in ast.walk(value) if isinstance(node, ast.comprehension))
    return {name_of(node) for loop in loops for node in ast.walk(loop.target)}


def _names(test: ast.AST) -> set[str]:
    """The names and attributes of an expression, without ``self`` and what only converts a value."""
    attributes = {node.attr for node in ast.walk(test) if isinstance(node, ast.Attribute)}
    names = {node.id for node in ast.walk(test) if isinstance(node, ast.Name)}
    return attributes | (names - {"self", "int", "bool", "any", "np", "len", "float", "list", "map", "tuple"})


def _passed(program: Program, step: Function, play: list[Function], name: str) -> Iterator[Suspect]:
    """Find a return after the step is counted and before the limit is tested, so that play may never equal it."""
    counts = [node for node, one in adds_one(play, name) if one is step]
    tests = [
        node
        for node in step.nodes
        if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Eq) and name_of(node.left) == name
    ]
    for node in _goes_on(step):
        words = [ast.unparse(test) for test in conditions(program, node, step)]
        over = any(_OVER.search(test) or re.search(rf"\b{name}\b", test) for test in words)
        if len(counts) == 1 and len(tests) == 1 and line(counts[0]) < line(node) < line(tests[0]) and not over:
            test = ast.unparse(tests[0])[:40]
            yield Suspect(line(node), f"may return at the step of the limit, before line {line(tests[0])} tests {test}")
            return


def _jumps(play: list[Function], name: str) -> Iterator[Suspect]:
    for one in play:
        for node in one.nodes:
            if (
                isinstance(node, ast.AugAssign)
                and isinstance(node.target, ast.Attribute)
                and node.target.attr == name
                and not (isinstance(node.value, ast.Constant) and node.value.value == 1)
            ):
                yield Suspect(line(node), f"changes {ast.unparse(node.target)} by more than 1, past the limit")
