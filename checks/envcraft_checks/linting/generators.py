"""Random numbers that no seed of reset() controls."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Undecided

from .program import Function, Program, Suspect, bindings, in_words, line, name_of, program_of
from .usage import Usage

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

#: The functions of the module random that draw from its global generator.
_DRAWS = frozenset({
    "betavariate", "binomialvariate", "choice", "choices", "expovariate", "gammavariate", "gauss", "getrandbits",
    "lognormvariate", "normalvariate", "paretovariate", "randbytes", "randint", "random", "randrange", "sample",
    "shuffle", "triangular", "uniform", "vonmisesvariate", "weibullvariate",
})  # fmt: skip
#: What of numpy.random draws nothing.
_NO_DRAWS = frozenset({"default_rng", "get_bit_generator", "get_state", "seed", "set_bit_generator", "set_state"})
#: The functions of torch that draw from its global generator, unless they are given another one.
_TORCH = frozenset({
    "bernoulli", "multinomial", "normal", "poisson", "rand", "rand_like", "randint", "randint_like", "randn",
    "randn_like", "randperm",
})  # fmt: skip
_ENTROPY = frozenset({"os.getpid", "os.urandom", "random.SystemRandom", "uuid.uuid1", "uuid.uuid4"})
MAKERS = frozenset({
    "gymnasium.utils.seeding.np_random", "numpy.random.RandomState", "numpy.random.default_rng", "random.Random",
})  # fmt: skip


def generators(program: Program) -> Iterator[Suspect]:
    """Find draws from global generators that the file never seeds, and generators that are created without a seed."""
    play, every, usage = program.play, program.all, Usage(program)
    seeded = {
        path.rpartition(".")[0]
        for function in every
        for node in function.nodes
        if isinstance(node, ast.Call) and node.args
        if (path := program.path(node.func, function)).endswith((".seed", ".manual_seed"))
    }
    aliases = _aliases(program)
    for function in every:
        for node in function.nodes:
            if not isinstance(node, ast.Call):
                continue
            path = _path(program, node, function, aliases)
            if draws(path) and path.rpartition(".")[0] not in seeded:
                words = f"takes a number that no seed of reset() controls: {path}()"
            elif function in play and _draws_from_space(program, node, function) and not _seeds_space(every):
                words = "samples a space, whose generator reset() does not seed"
            elif path in MAKERS and _unseeded(node) and _is_drawn_from(program, function, node):
                words = f"creates a generator without a seed: {path}()"
            else:
                continue
            if path.endswith(".shuffle") or usage.is_used(node, function):
                yield Suspect(line(node), words)
    yield from _own(program, usage)
    yield from _of_module(program, usage)
    yield from _ignored_seed(program)
    yield from _constant_seed(program)


def seeded_draws(program: Program) -> Iterator[Suspect]:
    """Find draws of play from global generators, once play has shown that seeding these in reset() is not enough."""
    aliases = _aliases(program)
    # What reset() draws after it has seeded a generator depends on the seed alone.
    for functions in (program.reached("step"), program.play):
        found = [
            Suspect(line(node), f"draws from a generator that other code may use, too: {path}()")
            for function in functions
            for node in function.nodes
            if isinstance(node, ast.Call) and draws(path := _path(program, node, function, aliases))
        ]
        if found:
            yield from found
            return


def kept_generators(program: Program) -> Iterator[Suspect]:
    """Find generators of an instance that outlive its episodes, once play has shown that something does."""
    yield from (suspect._replace(certain=False) for suspect in _own(program, Usage(program)))


def drawn_alike(subject: Subject) -> None:
    """Leave undecided how easy a game is that draws the same numbers in the first episode of each instance.

    Raises:
        Undecided: all fresh episodes are the same under every seed.
    """
    program = program_of(subject)
    if program is not None and (found := next(_seeded_once(program), None)) is not None:
        raise Undecided(f"the first episode of each instance draws the same numbers: {in_words([found])[0]}")


def _seeded_once(program: Program) -> Iterator[Suspect]:
    """Find generators with a fixed seed that the constructor, the class or the module creates, and play draws from."""
    yield from kept_generators(program)
    read = {name_of(node) for one in program.play for node in one.nodes if isinstance(node, ast.Name | ast.Attribute)}
    bodies = (node for owner in program.lineage(program.env) for node in program.classes[owner].body)
    renewed = {name_of(target) for one in program.play for target, _, _ in one.bindings}
    renewed |= {
        name_of(node.value)
        for one in program.play
        for node in one.nodes
        if isinstance(node, ast.Attribute) and node.attr == "seed"
    }
    for target, value, node in bindings([*program.module_nodes, *bodies]):
        made = isinstance(value, ast.Call) and program.path(value.func) in MAKERS and not _unseeded(value)
        if made and name_of(target) in read - renewed:
            yield Suspect(line(node), f"creates {name_of(target)} with a fixed seed once for all instances")


def constant_seed(program: Program) -> Suspect | None:
    """The line of reset() that seeds a generator with a constant, or, which is not certain, chooses a seed where it
    receives none; None if there is none or several.
    """
    found: dict[int, Suspect] = {}
    for function in program.reached("reset"):
        for node in function.nodes:
            match node:
                case ast.Call(func=func, args=args, keywords=keywords):
                    seeding = name_of(func) == "seed" or program.path(func, function) in MAKERS
                    seeds = [*(args[:1] if seeding else []), *(each.value for each in keywords if each.arg == "seed")]
                    fixed = any(map(_is_number, seeds))
                case ast.Assign(targets=[ast.Name(id="seed")], value=value):
                    fixed = any(map(_is_number, ast.walk(value)))
                case ast.BoolOp(op=ast.Or(), values=[ast.Name(id="seed"), value]):
                    fixed = _is_number(value)
                case ast.IfExp(test=ast.Compare(left=ast.Name(id="seed"), comparators=[ast.Constant(value=None)])):
                    fixed = _is_number(node.body) or _is_number(node.orelse)
                case _:
                    continue
            if fixed:
                words = f"seeds with a constant: {ast.unparse(node)[:60]}"
                found.setdefault(line(node), Suspect(line(node), words, certain=isinstance(node, ast.Call)))
    return found.popitem()[1] if len(found) == 1 else None


def anew(program: Program) -> Suspect | None:
    """The line of reset() that makes or seeds a generator anew where it receives no seed; None if there is none or
    several.
    """
    unseeded, passed = {}, {}
    for function in program.reached("reset"):
        for node in function.nodes:
            if not isinstance(node, ast.Call):
                continue
            makes = program.path(node.func, function) in MAKERS
            given = [*node.args, *(keyword.value for keyword in node.keywords)]
            if makes and _unseeded(node):
                unseeded[line(node)] = node
            elif (makes or name_of(node.func) == "seed") and any(name_of(each) == "seed" for each in given):
                passed[line(node)] = node
    for number, node in (unseeded or passed).items() if len(unseeded or passed) == 1 else ():
        return Suspect(number, f"takes new numbers from the system where there is no seed: {ast.unparse(node)[:60]}")
    return None


def _is_number(node: ast.AST) -> bool:
    """Whether an expression is a number, in digits or by the name of a constant."""
    return (isinstance(node, ast.Constant) and isinstance(node.value, int)) or (
        isinstance(node, ast.Name | ast.Attribute) and name_of(node).isupper()
    )


def _aliases(program: Program) -> dict[str, str]:
    """The attributes that are the modules of the global generators."""
    return {
        function.field(target): path
        for function in program.all
        for target, value, _ in function.bindings
        if function.field(target)
        and value is not None
        and (path := program.path(value, function)) in ("random", "numpy.random")
    }


def _path(program: Program, call: ast.Call, function: Function, aliases: dict[str, str]) -> str:
    if any(keyword.arg == "generator" for keyword in call.keywords):
        return ""
    if isinstance(call.func, ast.Attribute) and (alias := aliases.get(function.field(call.func.value))):
        return f"{alias}.{call.func.attr}"
    return program.path(call.func, function)


def draws(path: str) -> bool:
    """Whether a function takes a number from a global generator or from the system."""
    module, _, name = path.rpartition(".")
    if path in _ENTROPY:
        return True
    if module == "random":
        return name in _DRAWS
    if module == "numpy.random":
        return name.islower() and name not in _NO_DRAWS
    if module == "torch":
        return name in _TORCH
    return module == "secrets"


def _draws_from_space(program: Program, node: ast.Call, function: Function) -> bool:
    match program.parents[node]:
        case ast.BinOp(op=ast.Mult(), right=ast.Constant(value=0)):
            return False
        case ast.Assign(targets=[target]):
            filled = [place for place, call in function.writes if name_of(call) == "fill"]
            if any(ast.dump(place) == ast.dump(target).replace("Store()", "Load()") for place in filled):
                return False
    match node.func:
        case ast.Attribute(attr="sample", value=ast.Attribute(attr="action_space" | "observation_space") as space):
            return bool(function.field(space))
    return False


def _seeds_space(functions: list[Function]) -> bool:
    return any(
        isinstance(node, ast.Attribute)
        and node.attr == "seed"
        and name_of(node.value) in ("action_space", "observation_space")
        for function in functions
        for node in function.nodes
    )


def _unseeded(node: ast.Call) -> bool:
    given = [*node.args, *(keyword.value for keyword in node.keywords)]
    return all(isinstance(one, ast.Constant) and one.value is None for one in given)


def _is_drawn_from(program: Program, function: Function, node: ast.Call) -> bool:
    """Whether play draws from a new generator, and nothing binds another one to its name."""
    parent = program.parents[node]
    if isinstance(parent, ast.Tuple | ast.Subscript):
        parent = program.parents[parent]
    if isinstance(parent, ast.Attribute):
        return function in program.play
    targets = [target for target, _, statement in function.bindings if statement is parent]
    if not isinstance(parent, ast.Assign) or not targets:
        return False
    if field := function.field(targets[0]):
        values = [value for one in program.methods(program.bound_to(function)) for value in _values(one, field)]
        return len(values) == 1 and not seeded_by_gymnasium(program, field) and _drawn(program, field)
    name = name_of(targets[0])
    others = [target for target, _, _ in function.bindings if isinstance(target, ast.Name) and target.id == name]
    return function in program.play and len(others) == 1


def _values(function: Function, field: str) -> list[ast.expr | None]:
    values = [value for target, value, _ in function.bindings if function.field(target) == field]
    return [value for value in values if not (isinstance(value, ast.Constant) and value.value is None)]


def seeded_by_gymnasium(program: Program, field: str) -> bool:
    """Whether ``super().reset(seed=seed)`` seeds the attribute."""
    return field in ("np_random", "_np_random") and any(
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "reset"
        and (node.keywords or node.args)
        for function in program.play
        for node in function.nodes
    )


def _drawn(program: Program, field: str) -> bool:
    """Whether play calls a method of the attribute and never seeds it."""
    called = {
        node.func.attr
        for function in program.play
        for node in function.nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and function.field(node.func.value) == field
    }
    return bool(called) and "seed" not in called


def _own(program: Program, usage: Usage) -> Iterator[Suspect]:
    """Find generators that only the constructor creates, with a fixed seed, and play draws from."""
    built = [function for function in program.all if function not in program.play]
    for function in built:
        for target, value, node in function.bindings:
            field = function.field(target)
            if (
                field
                and isinstance(value, ast.Call)
                and program.path(value.func, function) in MAKERS
                and value.args
                and isinstance(value.args[0], ast.Constant)
                and value.args[0].value is not None
                and sum(len(_values(one, field)) for one in program.methods(program.env)) == 1
                and _drawn(program, field)
                and not seeded_by_gymnasium(program, field)
                and usage.is_used(value, function)
            ):
                yield Suspect(line(node), f"creates self.{field} with a fixed seed, and reset() does not seed it again")


def _of_module(program: Program, usage: Usage) -> Iterator[Suspect]:
    """Find generators of the module that play draws from, and what the module draws itself."""
    loaded = {
        node.id
        for function in program.play
        for node in function.nodes
        if isinstance(node, ast.Name) and node.id not in function.local
    }
    for target, value, node in bindings(program.module_nodes):
        if not isinstance(target, ast.Name) or target.id not in loaded:
            continue
        if isinstance(value, ast.Call) and program.path(value.func) in MAKERS:
            if usage.is_used(value, None):
                words = f"creates the generator {target.id} of the module, which reset() does not create again"
                yield Suspect(line(node), words)
            continue
        for call in ast.walk(node):
            if not isinstance(call, ast.Call):
                continue
            drawn = draws(path := program.path(call.func)) or (path in MAKERS and _unseeded(call))
            if drawn and usage.is_used(call, None):
                yield Suspect(
                    line(call), f"takes {target.id} from a generator without a seed when the file is imported: {path}()"
                )
                break


def _ignored_seed(program: Program) -> Iterator[Suspect]:
    """Find a reset() that never reads its seed, although play draws from ``self.np_random``."""
    reset = program.method(program.env, "reset")
    if reset is None or "seed" not in reset.parameters:
        return
    read = any(isinstance(node, ast.Name) and node.id in ("locals", "seed") for node in reset.nodes)
    # A constant may be one fixed level for every seed, see _constant_seed.
    fixed = any(isinstance(node, ast.keyword) and node.arg == "seed" for node in reset.nodes)
    drawn = any(function.field(node) == "np_random" for function in program.play for node in function.nodes)
    if drawn and not read and not fixed:
        calls = (node for node in reset.nodes if isinstance(node, ast.Call))
        if (call := next((node for node in calls if ast.unparse(node.func) == "super().reset"), None)) is not None:
            yield Suspect(line(call), "does not pass the seed on, and play draws from self.np_random")
        else:
            yield Suspect(line(reset.node), "takes a seed that nothing reads, and play draws from self.np_random")


def _constant_seed(program: Program) -> Iterator[Suspect]:
    """Find a reset() that always seeds ``self.np_random`` with one constant, although steps draw from it.

    If only reset() draws, the constant may stand for one fixed level, which is a design.
    """
    reset = program.method(program.env, "reset")
    if reset is None or program.method(program.env, "reset", after=reset.owner) is not None:
        return
    arguments = reset.node.args
    names = {"locals", "seed", *([arguments.kwarg.arg] if arguments.kwarg else [])}
    if any(isinstance(node, ast.Name) and node.id in names for node in reset.nodes):
        return
    if {"np_random", "_np_random"} & program.field_values(program.env).keys():
        return
    levels = program.reached("reset")
    drawn = [
        node
        for function in program.reached("step")
        if function not in levels
        for node in function.nodes
        if function.field(node) == "np_random"
    ]
    for node in reset.nodes:
        match node:
            case ast.Call(
                func=ast.Attribute(attr="reset", value=ast.Call(func=ast.Name(id="super"))),
                keywords=[ast.keyword(arg="seed", value=value), *_],
            ) if drawn and _constant(program, reset, value) and _always(program, reset, node):
                words = f"always seeds self.np_random with {ast.unparse(value)}, so that each episode draws the same"
                yield Suspect(line(node), f"{words} numbers in line {line(drawn[0])}")


def _constant(program: Program, function: Function, node: ast.expr) -> bool:
    """Whether an expression is a whole number, or a name that the file binds to one and never again."""
    bound = program.values(node, function) or [(node, None)]
    stored = [one for one in program.nodes if isinstance(getattr(one, "ctx", None), ast.Store)]
    return sum(name_of(one) == name_of(node) != "" for one in stored) <= 1 and all(
        owner is None and isinstance(value, ast.Constant) and type(value.value) is int for value, owner in bound
    )


def _always(program: Program, function: Function, node: ast.AST) -> bool:
    """Whether a call of a function's body runs whenever the function does."""
    return all(isinstance(each, ast.Expr | ast.Assign) for each in program.around(node, function))
