"""Defects of the observation."""

from __future__ import annotations

import ast

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import OBSERVATION, flagged, pictured, result
from benchmarks.mutation.source import Edit, Source, names_in, nodes

_SHOWN = ("EC40", "EC05")


@operator(*_SHOWN, "EC066")
def frozen_after_event(game: Source) -> Places:
    """Draw nothing new after an event."""
    for event, _ in flagged(game, "self.frozen"):
        if game.results and game.seeding is not None:
            yield [
                game.after(game.seeding, "self.frozen = self.last_picture = None"),
                game.after(event, "self.frozen = True"),
                *result(game, OBSERVATION, "self._shown({0})"),
                game.method(
                    "def _shown(self, picture):",
                    "    if not self.frozen or self.last_picture is None:",
                    "        self.last_picture = picture",
                    "    return self.last_picture.copy()",
                ),
            ]


@operator(*_SHOWN, "EC066")
def blank_after_event(game: Source) -> Places:
    """Return a black picture after an event."""
    for _, edits in flagged(game, "self.dark"):
        if game.pictured:
            yield [*edits, *pictured(game, "({0}) * np.uint8(not self.dark)")]


@operator(*_SHOWN)
def drawn_once(game: Source) -> Places:
    """Draw the picture at the reset only."""
    if game.results and game.seeding is not None:
        yield [
            game.after(game.seeding, "self.last_picture = None"),
            *result(game, OBSERVATION, "self._shown({0})"),
            game.method(
                "def _shown(self, picture):",
                "    if self.last_picture is None:",
                "        self.last_picture = picture",
                "    return self.last_picture.copy()",
            ),
        ]


@operator(*_SHOWN)
def cast_from_unit(game: Source) -> Places:
    """Scale colours to 0..1 before they are cast to bytes."""
    if game.pictured:
        yield pictured(game, "(({0}) / 255.0).astype(np.uint8)")


@operator(*_SHOWN)
def low_contrast(game: Source) -> Places:
    """Divide all colours by 100."""
    if game.pictured:
        yield pictured(game, "({0}) // 100")


@operator(*_SHOWN)
def always_black(game: Source) -> Places:
    """Return a black picture."""
    if game.pictured:
        yield pictured(game, "np.zeros_like({0})")


@operator(*_SHOWN, "EC20")
def noise(game: Source) -> Places:
    """Return random pixels."""
    if game.pictured and game.seeding is not None:
        yield pictured(game, "self.np_random.integers(0, 256, ({0}).shape, dtype=np.uint8)")


@operator(*_SHOWN)
def every_other_stale(game: Source) -> Places:
    """Return the first picture of the episode at every second step."""
    if game.results and game.seeding is not None and game.counter is not None:
        yield [
            game.after(game.seeding, "self.last_picture = None"),
            *result(game, OBSERVATION, "self._shown({0})"),
            game.method(
                "def _shown(self, picture):",
                "    if self.last_picture is None:",
                "        self.last_picture = picture",
                f"    return picture if {game.counter} % 2 else self.last_picture.copy()",
            ),
        ]


@operator(*_SHOWN)
def player_not_drawn(game: Source) -> Places:
    """Draw nothing that depends on what the player controls."""
    edits: list[Edit] = []
    for name in sorted(game.drawing & set(game.methods)):
        edits += _undrawn(game, game.methods[name])
    if edits:
        yield edits


def _undrawn(game: Source, method: ast.FunctionDef) -> list[Edit]:
    """Replace each statement that draws something controlled by ``pass``."""
    hidden: set[str] = set()

    def depends(node: ast.AST) -> bool:
        fields = {game.of(part) for part in nodes(node, ast.Attribute)}
        return bool(fields & game.controlled or names_in(node) & hidden)

    edits: list[Edit] = []
    for node in nodes(method, ast.stmt):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name | ast.Tuple) and depends(node.value):
            hidden |= {part.id for part in nodes(node.targets[0], ast.Name)}
        elif isinstance(node, ast.For) and depends(node.iter):
            hidden |= {part.id for part in nodes(node.target, ast.Name)}
        drawn = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript)
        if (drawn or isinstance(node, ast.Expr)) and depends(node):
            edits.append(game.replace(node, "pass"))
    return edits


@operator("EC40", "EC80", "EC05")
def action_ignored(game: Source) -> Places:
    """Play without the player's action."""
    counting = game.methods["step"].body[0]
    yield [game.before(counting, f"{game.action} = [0, 0, 0]")]
