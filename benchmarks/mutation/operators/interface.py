"""Defects of the calls and of the types and shapes of their results."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import INFO, OBSERVATION, TERMINATED, first, flagged, pictured, result
from benchmarks.mutation.source import Source, nodes

_API = ("EC10", "EC11", "EC05")


@operator("EC110", "EC11", "EC05")
def buffer_returned(game: Source) -> Places:
    """Return one buffer for every observation."""
    yield from _kept(game, 1)


@operator("EC110", "EC11", "EC05")
def ring_of_buffers(game: Source) -> Places:
    """Return one of five buffers in turn."""
    yield from _kept(game, 5)


def _kept(game: Source, number: int) -> Places:
    if game.picture is None or len(game.pictured) != 1:
        return
    returned = game.parents[game.pictured[0]]
    assert isinstance(returned, ast.Return)
    yield [
        game.replace(
            returned,
            f"\n{' ' * returned.col_offset}".join(
                [
                    'if not hasattr(self, "buffers"):',
                    f"    self.buffers = [np.zeros(self.observation_space.shape, np.uint8) for _ in range({number})]",
                    "self.buffers.append(self.buffers.pop(0))",
                    f"self.buffers[-1][:] = {game.of(game.pictured[0])}",
                    "return self.buffers[-1]",
                ]
            ),
        )
    ]


@operator(*_API, "EC064")
def dtype_widened(game: Source) -> Places:
    """Darken the picture after an event, which makes it a picture of floats."""
    for _, edits in flagged(game, "self.dimmed"):
        if game.pictured:
            yield [*edits, *pictured(game, "{0} * 0.5 if self.dimmed else {0}")]


@operator(*_API)
def shape_after_event(game: Source) -> Places:
    """Return a grey picture after an event."""
    for _, edits in flagged(game, "self.grey"):
        if game.pictured:
            yield [*edits, *pictured(game, "({0})[:, :, 0] if self.grey else {0}")]


@operator("EC107", "EC05")
def division_by_zero(game: Source) -> Places:
    """Divide by a number that is zero after the second event."""
    for score in game.scores:
        yield [game.after(score, f"self.pace = 1 / (2 - {game.of(score.target)})")]


@operator("EC107", "EC05")
def rare_action(game: Source) -> Places:
    """Look up a joint action in a table that lacks one."""
    table = "{(0, 0): 1, (1, 0): 2, (0, 1): 2}"
    yield [
        game.before(first(game, "step"), f"self.effort = {table}[int({game.action}[1]), int({game.action}[2])]"),
    ]


@operator("EC107", "EC05")
def rare_action_late(game: Source) -> Places:
    """Raise on both buttons and up at once, from step 12 on."""
    if game.counter is not None:
        values = f"tuple(int(part) for part in {game.action})"
        yield [
            game.before(
                first(game, "step"),
                f"if {game.counter} >= 12 and {values} == (1, 1, 1):",
                '    raise ValueError("no such move")',
            )
        ]


@operator("EC107", "EC05", "EC067")
def crash_after_events(game: Source) -> Places:
    """Read past the end of a list at the third event."""
    if game.seeding is not None:
        for event in game.events:
            yield [
                game.after(game.seeding, "self.chimes = [3, 2, 1]", "self.rung = 0"),
                game.after(event, "self.rung += 1", "self.tone = self.chimes[self.rung]"),
            ]


@operator("EC11", "EC05")
def action_modified(game: Source) -> Places:
    """Write into the action array."""
    for returned, _ in game.results[-1:]:
        yield [game.before(returned, f"{game.action} *= 0")]
        yield [game.before(returned, f"{game.action}[0] = 0")]


@operator(*_API, "EC21")
def action_kept(game: Source) -> Places:
    """Keep the action array and act on it one step later, where the caller may have changed it."""
    if game.seeding is not None:
        yield [
            game.after(game.seeding, "self.last_action = np.zeros(3, int)"),
            game.before(
                first(game, "step"),
                f"self.last_action, {game.action} = {game.action}, self.last_action",
            ),
        ]


@operator(*_API, "EC061")
def info_is_list(game: Source) -> Places:
    """Return a list as `info` after an event."""
    for _, edits in flagged(game, "self.listed"):
        if game.results:
            yield [*edits, *result(game, INFO, "list({0}) if self.listed else {0}")]


@operator(*_API)
def info_key(game: Source) -> Places:
    """Put a key into `info` that is not a string, after an event."""
    for event, edits in flagged(game, "self.tagged"):
        if game.results:
            yield [*edits, *result(game, INFO, f"{{{{**{{0}}, {event.lineno}: True}}}} if self.tagged else {{0}}")]


@operator("EC106", "EC10", "EC05")
def four_values(game: Source) -> Places:
    """Return four values at the end of an episode."""
    for returned, values in game.results[-1:]:
        observation, reward, terminated, _truncated, info = (game.of(value) for value in values)
        yield [
            game.before(
                returned,
                f"if {terminated}:",
                f"    return {observation}, {reward}, {terminated}, {info}",
            )
        ]


@operator("EC105", "EC10", "EC05")
def reset_without_info(game: Source) -> Places:
    """Return only the observation from `reset`."""
    for node in nodes(game.methods["reset"], ast.Return):
        if isinstance(node.value, ast.Tuple):
            yield [game.replace(node.value, game.of(node.value.elts[0]))]


@operator(*_API)
def options_required(game: Source) -> Places:
    """Read an option that the caller may leave out."""
    if game.seeding is not None and "options" in {arg.arg for arg in game.methods["reset"].args.kwonlyargs}:
        yield [game.after(game.seeding, "if options is not None:", '    self.difficulty = options["difficulty"]')]


@operator("EC112", "EC11", "EC404", "EC05")
def render_returns_nothing(game: Source) -> Places:
    """Return nothing from `render`."""
    if "render" in game.methods and not _rendered_by_step(game):
        yield [game.replace(node, "return None") for node in nodes(game.methods["render"], ast.Return)]


@operator("EC404", "EC112", "EC05")
def render_other_picture(game: Source) -> Places:
    """Show other colours in `render` than in the observation."""
    if "render" in game.methods and not _rendered_by_step(game):
        for node in nodes(game.methods["render"], ast.Return):
            if node.value is not None:
                yield [game.replace(node.value, f"255 - {game.of(node.value)}")]


def _rendered_by_step(game: Source) -> bool:
    calls = [call for name in ("reset", "step") for call in nodes(game.methods[name], ast.Call)]
    return any(game.of(call.func) == "self.render" for call in calls)


@operator("EC113", "EC11", "EC05")
def second_close(game: Source) -> Places:
    """Raise when `close` is called a second time."""
    if "close" not in game.methods and "__init__" in game.methods:
        yield [
            game.after(game.methods["__init__"].body[-1], "self.handle = [0]"),
            game.method("def close(self):", "    self.handle.pop()"),
        ]


@operator("EC10", "EC11", "EC05")
def space_changes(game: Source) -> Places:
    """Replace the action space after an event."""
    for event in game.events:
        yield [game.after(event, "self.action_space = type(self.action_space)([4, 2, 2])")]


@operator("EC504", "EC05")
def flag_is_number(game: Source) -> Places:
    """Return 0 and 1 as the flag of termination."""
    if game.results:
        yield result(game, TERMINATED, "int({0})")


@operator("EC504", "EC05")
def flag_is_none(game: Source) -> Places:
    """Return None as the flag of termination while the game goes on."""
    if game.results:
        yield result(game, TERMINATED, "({0}) or None")


@operator("EC108", "EC05")
def first_observation(game: Source) -> Places:
    """Return a picture of another type from `reset` than from `step`."""
    for node in nodes(game.methods["reset"], ast.Return):
        if isinstance(node.value, ast.Tuple):
            picture = node.value.elts[0]
            yield [game.replace(picture, f"{game.of(picture)}.astype(np.int64)")]


@operator("EC108", "EC109", "EC05")
def observation_is_list(game: Source) -> Places:
    """Return the last observation of an episode as a list."""
    for _, values in game.results[-1:]:
        observation, terminated = game.of(values[OBSERVATION]), game.of(values[TERMINATED])
        yield [game.replace(values[OBSERVATION], f"{observation}.tolist() if {terminated} else {observation}")]
