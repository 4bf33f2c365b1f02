"""Defects of winning and losing."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.source import Edit, Source, nodes

_HARD = ("EC80", "EC60", "EC30", "EC05")


@operator("EC80", "EC05", warns=True)
def never_won(game: Source) -> Places:
    """Set the flag of the won game to False where it is set."""
    if game.wins:
        yield [
            game.replace(value, "False" if game.of(value) == "True" else f"bool({game.of(value)}) and False")
            for value in game.wins
        ]


@operator("EC80", "EC05", warns=True)
def impossible_test(game: Source) -> Places:
    """Compare with a number that is out of reach in the test of success."""
    for value in game.wins:
        holder = game.parents[game.parents[value]]
        test = holder.test if game.of(value) == "True" and isinstance(holder, ast.If) else value
        if isinstance(test, ast.Compare) and len(test.ops) == 1 and isinstance(test.ops[0], ast.GtE | ast.Eq):
            bound = test.comparators[0]
            if _is_number(game, bound):
                yield [game.replace(bound, f"{game.of(bound)} + 1000")]


def _is_number(game: Source, bound: ast.expr) -> bool:
    """Whether a bound is a number or a constant by its name, and no place such as ``self.goal``."""
    if isinstance(bound, ast.Constant):
        return isinstance(bound.value, int)
    return isinstance(bound, ast.Name | ast.Attribute) and game.of(bound).removeprefix("self.").isupper()


@operator("EC60", "EC80", "EC05")
def won_by_waiting(game: Source) -> Places:
    """Win at step 20 under every action."""
    if game.counter is not None and (edits := game.ends_when(game.wins, f"{game.counter} >= 20")):
        yield edits


@operator("EC60", "EC80", "EC05")
def won_by_luck(game: Source) -> Places:
    """Win at random, in one of twenty steps."""
    if game.seeding is not None and (edits := game.ends_when(game.wins, "self.np_random.random() < 0.05")):
        yield edits


@operator(*_HARD)
def won_by_button(game: Source) -> Places:
    """Win by holding the second button for fifteen steps."""
    if game.seeding is not None and game.wins:
        condition = "self.held >= 15"
        held = f"self.held = (self.held + 1) * int({game.action}[2])"
        if edits := game.ends_when(game.wins, condition):
            step = game.methods["step"].body[0]
            yield [game.after(game.seeding, "self.held = 0"), game.before(step, held), *edits]


@operator("EC80", "EC60", "EC50", "EC30", "EC05", warns=True)
def success_never_told(game: Source) -> Places:
    """Put False into `info` in any case."""
    yield _told(game, "False")


@operator("EC60", "EC80", "EC05")
def success_always_told(game: Source) -> Places:
    """Put True into `info` in any case."""
    yield _told(game, "True")


def _told(game: Source, text: str) -> list[Edit]:
    return [
        game.replace(value, text)
        for node in nodes(game.env, ast.Dict)
        for key, value in zip(node.keys, node.values, strict=True)
        if isinstance(key, ast.Constant) and key.value == "is_success" and game.of(value) != "False"
    ]


@operator("EC70", "EC50", "EC80", "EC05")
def idle_loses(game: Source) -> Places:
    """Lose the game at the fifth step of whoever has not moved."""
    if game.seeding is not None and game.counter is not None and game.losses:
        condition = f"{game.counter} == 5 and not self.moved"
        if edits := game.ends_when(game.losses, condition):
            moved = f"self.moved = self.moved or bool(int({game.action}[0]))"
            step = game.methods["step"].body[0]
            yield [game.after(game.seeding, "self.moved = False"), game.before(step, moved), *edits]


@operator("EC70", "EC50", "EC80", "EC05")
def spawn_on_hazard(game: Source) -> Places:
    """Lose the game at the second step."""
    if game.counter is not None and game.losses and (edits := game.ends_when(game.losses, f"{game.counter} == 2")):
        yield edits


@operator("EC70", "EC50", "EC80", "EC05")
def some_spawns_on_hazard(game: Source) -> Places:
    """Lose the game at the second step on a fifth of the seeds."""
    if (
        game.counter is not None
        and game.losses
        and game.seeding is not None
        and (edits := game.ends_when(game.losses, f"{game.counter} == 2 and self.ambushed"))
    ):
        yield [game.after(game.seeding, "self.ambushed = self.np_random.random() < 0.2"), *edits]


@operator("EC60", "EC70", "EC80", "EC05")
def some_won_at_once(game: Source) -> Places:
    """Win the game at the second step on a fifth of the seeds."""
    if (
        game.counter is not None
        and game.wins
        and game.seeding is not None
        and (edits := game.ends_when(game.wins, f"{game.counter} == 2 and self.blessed"))
    ):
        yield [game.after(game.seeding, "self.blessed = self.np_random.random() < 0.2"), *edits]
