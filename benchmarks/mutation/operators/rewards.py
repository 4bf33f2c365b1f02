"""Defects of the reward."""

from __future__ import annotations

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import REWARD, TERMINATED, flagged, result
from benchmarks.mutation.source import Source

_PAID = ("EC30", "EC60", "EC80", "EC05")


@operator("EC301", "EC30", "EC05")
def nan_after_event(game: Source) -> Places:
    """Return NaN as every reward after an event."""
    for _, edits in flagged(game, "self.void"):
        if game.results:
            yield [*edits, *result(game, REWARD, 'float("nan") if self.void else {0}')]


@operator("EC301", "EC30", "EC05")
def infinite_at_end(game: Source) -> Places:
    """Divide the reward of the last step by zero in numpy."""
    for _, values in game.results[-1:]:
        reward, terminated = game.of(values[REWARD]), game.of(values[TERMINATED])
        yield [game.replace(values[REWARD], f"float(np.float64({reward}) / (0.0 if {terminated} else 1.0))")]


@operator("EC302", "EC30", "EC05")
def reward_is_array(game: Source) -> Places:
    """Return the reward as an array."""
    if game.results:
        yield result(game, REWARD, "np.array([{0}])")


@operator("EC302", "EC30", "EC05")
def reward_is_none(game: Source) -> Places:
    """Return None as the reward of every step after an event."""
    for _, edits in flagged(game, "self.muted"):
        if game.results:
            yield [*edits, *result(game, REWARD, "None if self.muted else {0}")]


@operator("EC303", "EC30", "EC05")
def reward_out_of_range(game: Source) -> Places:
    """Pay a thousand points at an event."""
    for _, edits in flagged(game, "self.jackpot"):
        if game.results:
            yield [*edits, *result(game, REWARD, "1000.0 if self.jackpot else {0}")]


@operator(*_PAID, "EC065")
def paid_every_step(game: Source) -> Places:
    """Pay a point for every step."""
    if game.results:
        yield result(game, REWARD, "({0}) + 1.0")


@operator("EC304", *_PAID, "EC065")
def grows_with_time(game: Source) -> Places:
    """Pay more at every step, by the number of steps."""
    if game.results and game.counter is not None:
        yield result(game, REWARD, f"({{0}}) + 0.1 * {game.counter}")


@operator(*_PAID, "EC065")
def paid_for_pressing(game: Source) -> Places:
    """Pay a point whenever the first button is held."""
    if game.results:
        yield result(game, REWARD, f"({{0}}) + float({game.action}[1])")


@operator(*_PAID)
def always_zero(game: Source) -> Places:
    """Never pay anything."""
    if game.results:
        yield result(game, REWARD, "0.0")


@operator("EC305", *_PAID, "EC062", warns=True)
def win_unpaid(game: Source) -> Places:
    """Pay nothing at the step of success."""
    if game.results and game.success:
        yield result(game, REWARD, f"0.0 if {game.success} else {{0}}")


@operator("EC305", *_PAID, "EC062")
def sign_turned(game: Source) -> Places:
    """Turn the sign of every reward."""
    if game.results:
        yield result(game, REWARD, "-({0})")
