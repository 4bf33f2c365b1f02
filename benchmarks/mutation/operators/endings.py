"""Defects of the ends of episodes."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import TERMINATED, TRUNCATED, result
from benchmarks.mutation.source import Source

_ENDS = ("EC50", "EC05")


@operator("EC501", "EC05")
def limit_forgotten(game: Source) -> Places:
    """Never truncate."""
    if game.limits:
        yield [game.replace(limit, "False") for limit in game.limits]


@operator("EC501", "EC05")
def limit_too_late(game: Source) -> Places:
    """Truncate a thousand steps too late."""
    if game.limits:
        yield [game.replace(limit.comparators[0], f"1000 + {game.of(limit.comparators[0])}") for limit in game.limits]


@operator("EC501", "EC05")
def limit_per_level(game: Source) -> Places:
    """Start the step counter again at an event."""
    if game.counter is not None and game.limits:
        for event in game.events:
            yield [game.after(event, f"{game.counter} = 0")]


@operator("EC501", "EC05")
def clock_paused(game: Source) -> Places:
    """Count only the steps in which the player moves."""
    counting = game.counting
    if counting is not None and game.limits:
        indented = f"if int({game.action}[0]):\n{' ' * counting.col_offset}    {game.of(counting)}"
        yield [game.replace(counting, indented)]


@operator("EC501", "EC05")
def limit_missed(game: Source) -> Places:
    """Compare the steps with the limit for equality, and skip that number after an event."""
    if game.counter is not None and game.limits:
        for event in game.events:
            edits = [game.replace(limit, game.of(limit).replace(">=", "==", 1)) for limit in game.limits]
            if all(isinstance(limit.ops[0], ast.GtE) for limit in game.limits):
                yield [*edits, game.after(event, f"{game.counter} += 500")]


@operator("EC502", "EC50", "EC05", "EC061")
def limit_is_termination(game: Source) -> Places:
    """Report the time limit as termination."""
    for _, values in game.results[-1:]:
        terminated, truncated = (game.of(values[at]) for at in (TERMINATED, TRUNCATED))
        if truncated != "False" and game.limits:
            yield [
                game.replace(values[TERMINATED], f"{terminated} or {truncated}"),
                game.replace(values[TRUNCATED], "False"),
            ]


@operator("EC502", "EC50", "EC05", "EC061")
def flags_swapped(game: Source) -> Places:
    """Swap the two flags."""
    for _, values in game.results[-1:]:
        terminated, truncated = (game.of(values[at]) for at in (TERMINATED, TRUNCATED))
        if truncated != "False":
            yield [game.replace(values[TERMINATED], truncated), game.replace(values[TRUNCATED], terminated)]


@operator(*_ENDS, "EC060")
def goes_on_after_success(game: Source) -> Places:
    """Do not end the episode at success."""
    if game.results and game.success:
        yield result(game, TERMINATED, f"({{0}}) and not ({game.success})")


@operator(*_ENDS)
def goes_on_after_loss(game: Source) -> Places:
    """Do not end the episode when the game is lost."""
    ends = {game.of(values[TERMINATED]) for _, values in game.results}
    # A game that only success ends has no loss.
    if game.success and ends - {game.success, game.success.removeprefix("bool(").removesuffix(")")}:
        yield result(game, TERMINATED, f"({{0}}) and ({game.success})")


@operator("EC503", "EC50", "EC70", "EC80", "EC60", "EC05")
def ends_at_once(game: Source) -> Places:
    """End every episode at its third step."""
    if game.results and game.counter is not None:
        yield result(game, TERMINATED, f"({{0}}) or {game.counter} >= 3")
