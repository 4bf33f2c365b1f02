"""Generators that reset() leaves behind or repeats, and those that step() seeds with a constant."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .generators import MAKERS, seeded_by_gymnasium
from .leftovers import by_name
from .program import Function, Program, Suspect, arguments, line, name_of
from .repeating import repeats

_SEEDS = frozenset({"_np_random_seed", "np_random_seed"})
_DISPLAYS = ast.List | ast.Tuple


def outdated_generators(program: Program) -> Iterator[Suspect]:
    """Find what keeps the constructor's ``self.np_random``, generators seeded with ``self.np_random_seed``, and
    constants by which step() seeds ``self.np_random``.
    """
    if program.method(program.env, "reset") is None or not seeded_by_gymnasium(program, "np_random"):
        return
    if any(by_name(node) for one in program.play for node in one.nodes):
        return
    yield from _kept(program)
    yield from _repeated(program)
    yield from _replaced(program)


def _kept(program: Program) -> Iterator[Suspect]:
    """Find attributes that the constructor alone sets, that hold its generator, and that play draws with."""
    play = set(program.play)
    for function in program.all:
        if function in play or program.bound_to(function) != program.env:
            continue
        for target, value, node in function.bindings:
            field = function.field(target)
            if not field or value is None or any(one in play for _, one in program.field_values(program.env)[field]):
                continue
            for given in ast.walk(value):
                if function.field(given) == "np_random" and (holder := _holder(program, function, given, field)):
                    words = f"gives {holder} the generator of the constructor, and reset(seed=...) makes another one"
                    yield Suspect(line(node), words)
                    break


def _holder(program: Program, function: Function, node: ast.AST, field: str) -> str:
    """What keeps a generator, "" if play does not draw with it or may give it another one."""
    parent = program.parents[node]
    if isinstance(parent, ast.Assign | ast.AnnAssign):
        return f"self.{field}" if _reads(program, program.env, field) else ""
    call = program.parents[parent] if isinstance(parent, ast.keyword) else parent
    if not isinstance(call, ast.Call) or call.func is node or name_of(call.func) not in program.classes:
        return ""
    owner = name_of(call.func)
    maker = program.method(owner, "__init__")
    if maker is None:
        return ""
    [parameter] = [name for name, value in arguments(call, maker) if value is node] or [""]
    kept = [
        maker.field(target)
        for target, value, _ in maker.bindings
        if isinstance(value, ast.Name) and value.id == parameter and maker.field(target)
    ]
    renewed = (
        target.attr
        for one in program.all
        if one is not maker
        for target, _, _ in one.bindings
        if isinstance(target, ast.Attribute)
    )
    drawn = len(kept) == 1 and kept[0] not in renewed and _reads(program, owner, kept[0])
    return owner if drawn and not _given_again(program, field) else ""


def _reads(program: Program, owner: str, field: str) -> bool:
    """Whether a method of a class uses what an attribute holds."""
    functions = program.play if owner == program.env else program.all
    return any(
        one.field(node) == field and isinstance(getattr(node, "ctx", None), ast.Load)
        for one in functions
        if program.bound_to(one) == owner and one.name != "__init__"
        for node in one.nodes
    )


def _given_again(program: Program, field: str) -> bool:
    """Whether a call of play may give the object in an attribute a generator."""
    for function in program.play:
        for node in function.nodes:
            if isinstance(node, ast.Call):
                inside = {function.field(one) for one in ast.walk(node)}
                if field in inside and any("random" in one or "rng" in one for one in inside - {field}):
                    return True
    return False


def _repeated(program: Program) -> Iterator[Suspect]:
    resetting = program.reached("reset")
    for function in program.reached("step"):
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            if not (isinstance(node, ast.Call) and program.path(node.func, function) in MAKERS):
                continue
            # One world for each seed, which reset() always makes, may be a design.
            if function in resetting and not any(_branches(program, function, node)):
                continue
            parts = [part for one in _given(node) for part in (one.elts if isinstance(one, _DISPLAYS) else [one])]
            seeds = [one for one in parts if function.field(one) in _SEEDS]
            others = [one for one in parts if one not in seeds]
            if only_if_seeded(program, function, node):
                continue
            if seeds and all(repeats(program, one, function) for one in others):
                words = f"seeds a generator with self.{function.field(seeds[0])}, which a reset() without a seed leaves"
                yield Suspect(line(node), f"{words} as it is: {ast.unparse(node)[:60]}")


def _replaced(program: Program) -> Iterator[Suspect]:
    """Find where step() replaces ``self.np_random`` by a generator that draws the same under every seed."""
    resetting = program.reached("reset")
    for function in program.reached("step"):
        bound = [target for target, _, _ in function.bindings if function.field(target) in ("_np_random", "np_random")]
        # A generator that is put back is no other one.
        for target, _, node in function.bindings if function not in resetting and len(bound) == 1 else ():
            if function.field(target) in ("_np_random", "np_random") and program.bound_to(function) == program.env:
                made = node.value if isinstance(node, ast.Assign) else None
                if not (isinstance(made, ast.Call) and program.path(made.func, function) in MAKERS):
                    continue
                if (seeds := _given(made)) and all(repeats(program, one, function) for one in seeds):
                    words = "replaces self.np_random by a generator that no seed of reset() changes"
                    yield Suspect(line(node), f"{words}: {ast.unparse(made)[:60]}")


def _given(call: ast.Call) -> list[ast.expr]:
    return [*call.args, *(keyword.value for keyword in call.keywords)]


def only_if_seeded(program: Program, function: Function, node: ast.AST) -> bool:
    """Whether a statement runs only under a test that asks for the seed."""
    return any("seed" in ast.unparse(each.test) for each in _branches(program, function, node))


def _branches(program: Program, function: Function, node: ast.AST) -> Iterator[ast.If | ast.IfExp]:
    """The branches around a statement."""
    return (each for each in program.around(node, function) if isinstance(each, ast.If | ast.IfExp))
