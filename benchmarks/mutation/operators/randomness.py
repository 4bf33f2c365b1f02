"""Defects of seeding and of the sources of randomness."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import first
from benchmarks.mutation.source import Source

_ANY = ("EC20", "EC21", "EC05")
#: Methods of a generator that numpy.random has as well, by the name there.
_GLOBAL = {
    name: name for name in ("random", "uniform", "normal", "choice", "permutation", "shuffle", "exponential")
} | {"integers": "randint"}


def _generator(game: Source, method: str, call: ast.Call, generator: str) -> str:
    assert isinstance(call.func, ast.Attribute)
    return game.of(call).replace(game.of(call.func), f"{generator}.{method}", 1)


@operator(*_ANY)
def numpy_global(game: Source) -> Places:
    """Draw from `numpy.random` and not from `self.np_random`."""
    for method, call in game.draws:
        keywords = {keyword.arg for keyword in call.keywords} - {"size"}
        if method in _GLOBAL and not keywords:
            yield [game.replace(call, _generator(game, _GLOBAL[method], call, "np.random"))]


@operator(*_ANY)
def random_module(game: Source) -> Places:
    """Draw from the module `random`."""
    for method, call in game.draws:
        if method == "random" and not call.args:
            yield [*game.imported("random"), game.replace(call, "random.random()")]
        if method == "integers" and len(call.args) in (1, 2) and not call.keywords:
            yield [*game.imported("random"), game.replace(call, _generator(game, "randrange", call, "random"))]


@operator(*_ANY)
def generator_unseeded(game: Source) -> Places:
    """Draw from a generator that nobody seeds."""
    for method, call in game.draws:
        yield [game.replace(call, _generator(game, method, call, "np.random.default_rng()"))]


@operator(*_ANY)
def seeded_by_clock(game: Source) -> Places:
    """Seed a generator with the time of day."""
    for method, call in game.draws:
        seeded = "np.random.default_rng(int(time.time() * 1000))"
        yield [*game.imported("time"), game.replace(call, _generator(game, method, call, seeded))]


@operator(*_ANY)
def set_of_strings(game: Source) -> Places:
    """Draw values for a set of names in the order of the set."""
    for method, call in game.draws:
        if method != "shuffle":
            text = f"{{name: {game.of(call)} for name in {{'red', 'green', 'blue'}}}}['red']"
            yield [game.replace(call, text.replace("'", '"'))]


@operator(*_ANY)
def seeded_once(game: Source) -> Places:
    """Use the seed of the first reset only."""
    if game.seeding is not None and game.draws:
        line = "\n" + " " * (game.seeding.col_offset + 4)
        text = f'if not hasattr(self, "seeded"):{line}{game.of(game.seeding)}{line}self.seeded = True'
        yield [game.replace(game.seeding, text)]


@operator(*_ANY, warns=True)
def seed_ignored(game: Source) -> Places:
    """Seed with a constant."""
    if game.seeding is not None and game.draws:
        yield [game.replace(game.seeding, game.of(game.seeding).replace("seed=seed", "seed=0"))]


@operator(*_ANY)
def seed_not_passed(game: Source) -> Places:
    """Do not pass the seed to `super().reset()`."""
    if game.seeding is not None and game.draws:
        yield [game.replace(game.seeding, "super().reset()")]


@operator(*_ANY)
def unseeded_fixed(game: Source) -> Places:
    """Give every reset without a seed the same seed."""
    if game.seeding is not None and game.draws:
        seeded = game.of(game.seeding).replace("seed=seed", "seed=7 if seed is None else seed")
        yield [game.replace(game.seeding, seeded)]


@operator(*_ANY)
def generator_of_the_module(game: Source) -> Places:
    """Share one generator of the module between all instances."""
    drawn = [(method, call) for method, call in game.draws if game.caller(call) != "reset"]
    if game.seeding is not None and drawn:
        edits = [game.replace(call, _generator(game, method, call, "GENERATOR[0]")) for method, call in drawn]
        kept = game.before(game.env, "GENERATOR = [np.random.default_rng(0)]", "", "")
        yield [kept, game.after(game.seeding, "GENERATOR[0] = np.random.default_rng(seed)"), *edits]


@operator(*_ANY)
def drawn_by_render(game: Source) -> Places:
    """Draw a random number whenever `render` is called."""
    if "render" in game.methods and any(game.caller(call) != "reset" for _, call in game.draws):
        yield [game.before(first(game, "render"), "self.np_random.random()")]


@operator(*_ANY)
def event_by_clock(game: Source) -> Places:
    """Let the wall clock decide whether an event counts."""
    for event in game.events:
        yield [
            *game.imported("time"),
            game.replace(event, f"if time.time() % 2 < 1:\n{' ' * event.col_offset}    {game.of(event)}"),
        ]


@operator(*_ANY)
def hashed_name(game: Source) -> Places:
    """Derive a value of the episode from the hash of a string."""
    for method, call in game.draws:
        if method == "integers" and not call.keywords and game.caller(call) != "step":
            drawn = game.of(call)
            width = game.of(call.args[1]) if len(call.args) > 1 else game.of(call.args[0])
            low = game.of(call.args[0]) if len(call.args) > 1 else "0"
            if "[" not in drawn and "(" not in width + low:
                yield [game.replace(call, f'({low} + hash(f"level {{{drawn}}}") % ({width} - ({low})))')]
