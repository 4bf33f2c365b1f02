"""The step limit as the code states it: the number, and the attribute that counts."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

#: The place of `truncated` in what step() returns, and how many values it returns.
TRUNCATED, RESULTS = 3, 5
#: Names of what limits the time of an episode. A number of moves or of turns may be a rule of the game.
_LIMIT = re.compile(r"max_?(episode_?)?(steps?|len|frames)|(steps?|time|episode|frames?)_?(limit|length)|horizon", re.I)
#: Names of what limits the steps of an episode, and nothing else.
_STEP_LIMIT = re.compile(
    r"_*max_?(episode_?)?(steps|frames)|_*(episode_|step_|steps_)limit|_*episode_length|_*horizon", re.I
)
_BOUNDS = (ast.GtE, ast.Gt, ast.Eq)


def terminates_at(program: Program) -> tuple[int, Suspect] | None:
    """The steps after which an episode is terminated by what its name says is a time limit, while nothing truncates it.

    Returns:
        The number of steps and the test; None if there is none.
    """
    step = program.method(program.env, "step")
    if step is None:
        return None
    flags = [
        node.value.elts[TRUNCATED]
        for node in step.nodes
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == RESULTS
    ]
    if not flags or not all(_is_false(program, flag, step) for flag in flags):
        return None
    play = program.reached("step")
    for test, function in flag_tests(program, step, TRUNCATED - 1):
        bound = bound_of(program, test, function)
        if bound is None or not isinstance(test, ast.Compare) or not adds_one(play, bound[0]):
            continue
        # A plain LIMIT is one of time if the counter is one of steps.
        if _LIMIT.search(f"{bound[0]}_{name_of(test.comparators[0])}"):
            steps = int(bound[1]) + (bound[2] is ast.Gt)
            return steps, Suspect(line(test), f"ends it if {ast.unparse(test)}")
    return None


def other_limits(program: Program) -> Iterator[Suspect]:
    """Find a number of steps that ends the episode, and that is not the one which the code declares as its limit.

    The declared limit has a name such as MAX_STEPS. A test of a step counter with it may be one of several limits.
    """
    counted = _counted(program)
    if len(counted) != 1:
        return
    [(test, most, _)] = counted
    if isinstance(test, ast.Compare) and isinstance(test.comparators[0], ast.Constant):
        for name, value in _declared(program).items():
            if value != most and _reads(program, name):
                yield Suspect(line(test), f"ends the episode if {ast.unparse(test)}, but {name} is {value:g}")


def step_limit(program: Program) -> float | None:
    """The number of steps after which the code ends an episode; None if it has no such number, or several."""
    counted = _counted(program)
    return counted[0][1] if len(counted) == 1 else None


def time_limit(program: Program) -> tuple[str, float] | None:
    """The attribute that counts steps and the number that ends an episode; None if there is not exactly one."""
    counted = _counted(program)
    bound = bound_of(program, counted[0][0], counted[0][2]) if len(counted) == 1 else None
    return (bound[0], bound[1]) if bound is not None else None


def _counted(program: Program) -> list[tuple[ast.AST, float, Function]]:
    """The tests that end an episode by a count of its steps, each with the number and the function."""
    step = program.method(program.env, "step")
    if step is None:
        return []
    play = program.reached("step")
    tests = {
        node: function for place in (TRUNCATED - 1, TRUNCATED) for node, function in flag_tests(program, step, place)
    }
    return [
        (node, found[1], function)
        for node, function in tests.items()
        if (found := bound_of(program, node, function))
        and adds_one(play, found[0])
        and counts_always(program, step, play, found[0])
    ]


def _declared(program: Program) -> dict[str, float]:
    """The numbers that the module, the class or its constructor binds once to the name of a step limit."""
    bound: dict[str, list[ast.expr | None]] = {}
    for name, value in program.module_values.items():
        bound.setdefault(name, []).append(value)
    for name, (_, value) in program.class_values(program.env).items():
        bound.setdefault(name, []).append(value)
    for name, values in program.field_values(program.env).items():
        bound.setdefault(name, []).extend(value for value, _ in values)
    found = {name: _constant(program, values[0], None) for name, values in bound.items() if len(values) == 1}
    return {name: value for name, value in found.items() if value is not None and _STEP_LIMIT.fullmatch(name)}


def _reads(program: Program, name: str) -> bool:
    """Whether play or the picture uses a name or an attribute."""
    return any(
        isinstance(node, ast.Name | ast.Attribute) and name_of(node) == name and isinstance(node.ctx, ast.Load)
        for function in program.reached("reset", "step", "render")
        for node in function.nodes
    )


def _is_false(program: Program, flag: ast.expr, step: Function) -> bool:
    """Whether a flag that step() returns is false, or a name for it."""
    values = [value for value, _ in program.values(flag, step)] if isinstance(flag, ast.Name) else [flag]
    return bool(values) and all(isinstance(value, ast.Constant) and value.value is False for value in values)


def flag_tests(program: Program, step: Function, place: int) -> Iterator[tuple[ast.AST, Function]]:
    """The comparisons that decide a flag which step() returns, through names, attributes and methods."""
    waiting: list[tuple[ast.AST, Function]] = [
        (node.value.elts[place], step)
        for node in step.nodes
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == RESULTS
    ]
    seen: set[ast.AST] = set()
    while waiting:
        value, function = waiting.pop()
        for node in _deciding(value):
            if node in seen:
                continue
            seen.add(node)
            if isinstance(node, ast.Compare):
                yield node, function
            elif isinstance(node, ast.Call) and (field := function.field(node.func)):
                called = program.method(program.bound_to(function), field)
                if called is not None:
                    waiting += [(one, called) for one in called.node.body]
            elif isinstance(node, ast.Name) or function.field(node):
                waiting += _assigned(program, node, function)


def _deciding(node: ast.AST) -> Iterator[ast.AST]:
    """Walk a tree without the sides of comparisons, and without what a ``not`` negates: that the episode goes on."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return
    yield node
    for child in ast.iter_child_nodes(node) if not isinstance(node, ast.Compare) else ():
        yield from _deciding(child)


def _assigned(program: Program, node: ast.AST, function: Function) -> Iterator[tuple[ast.AST, Function]]:
    """The values that a name or an attribute of ``self`` has, and the conditions under which play assigns them."""
    field = function.field(node)
    for one in program.play if field else [function]:
        for target, value, statement in one.bindings:
            same = (
                one.field(target) == field
                if field
                else isinstance(target, ast.Name) and name_of(target) == name_of(node)
            )
            if same:
                if value is not None:
                    yield value, one
                yield from ((test, one) for test in conditions(program, statement, one))


def conditions(program: Program, node: ast.AST, function: Function) -> Iterator[ast.expr]:
    """The tests of the statements that hold a node."""
    for each in program.around(node, function):
        if isinstance(each, ast.If | ast.While | ast.IfExp):
            yield each.test


def bound_of(program: Program, test: ast.AST, function: Function) -> tuple[str, float, type[ast.cmpop]] | None:
    """The attribute that a test compares with an upper bound, the bound, and the comparison; None for another test."""
    if not isinstance(test, ast.Compare) or len(test.ops) != 1 or not isinstance(test.left, ast.Attribute):
        return None
    most = _constant(program, test.comparators[0], function)
    kind = type(test.ops[0])
    return (test.left.attr, most, kind) if most is not None and kind in _BOUNDS else None


def _constant(program: Program, node: ast.AST | None, function: Function | None) -> float | None:
    """The value of a number, of a name that is bound to one number, or of an option with a default."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return value
        case ast.Name() | ast.Attribute():
            values = program.values(node, function)
            if len(values) == 1 and isinstance(values[0][0], ast.Name) and values[0][1] is not None:
                return _default(values[0][0].id, values[0][1])
            return _constant(program, *values[0]) if len(values) == 1 and values[0][0] is not node else None
    return None


def _default(name: str, function: Function) -> float | None:
    """The default of a parameter, if it is a number."""
    arguments = function.node.args
    every = [*arguments.posonlyargs, *arguments.args]
    named = dict(zip(reversed([one.arg for one in every]), reversed(arguments.defaults), strict=False))
    named |= {
        one.arg: value
        for one, value in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
        if value is not None
    }
    value = named.get(name)
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, int | float) else None


def adds_one(play: list[Function], name: str) -> list[tuple[ast.AugAssign, Function]]:
    """Where play adds one to an attribute of this name."""
    return [
        (node, one)
        for one in play
        for node in one.nodes
        if isinstance(node, ast.AugAssign)
        and isinstance(node.target, ast.Attribute)
        and node.target.attr == name
        and isinstance(node.op, ast.Add)
        and isinstance(node.value, ast.Constant)
        and node.value.value == 1
    ]


def counts_always(program: Program, step: Function, play: list[Function], name: str) -> bool:
    """Whether every step changes an attribute of this name, and play never sets it back."""
    changed = any(
        isinstance(node, ast.AugAssign)
        and isinstance(node.target, ast.Attribute)
        and node.target.attr == name
        and program.parents[node] is step.node
        for node in step.nodes
    )
    return changed and not any(True for _ in sets_back(play, name))


def sets_back(play: list[Function], name: str) -> Iterator[tuple[ast.Assign, Function]]:
    """Where play assigns a number to an attribute of this name."""
    for one in play:
        for target, value, statement in one.bindings:
            if (
                isinstance(target, ast.Attribute)
                and target.attr == name
                and isinstance(statement, ast.Assign)
                and isinstance(value, ast.Constant)
            ):
                yield statement, one
