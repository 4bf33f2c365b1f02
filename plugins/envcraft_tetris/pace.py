"""About how long games last, from the rules alone: variants that would be over at once, or never, are not written.

The figures were fitted to games that were played, and are right to within a factor of two or so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .axes.board import Board
    from .axes.controls import Controls
    from .axes.entry import Entry
    from .axes.garbage import Garbage
    from .axes.gravity import Gravity
    from .axes.locking import Locking
    from .axes.pieces import Pieces


def idle_steps(pieces: Pieces, board: Board, entry: Entry, gravity: Gravity, garbage: Garbage) -> float:
    """Steps of a game in which nothing is pressed: pieces pile up where they come in."""
    height = board.rows - garbage.start - 2
    piled = height / 1.7
    if entry.place not in ("middle", "left", "right"):
        spread = 0.55 * height * board.columns / pieces.cells
        piled = min(1.9 * piled, spread)
    return piled * (height * 0.55 + 1) * gravity.slow


def random_steps(
    pieces: Pieces,
    board: Board,
    entry: Entry,
    gravity: Gravity,
    garbage: Garbage,
    locking: Locking,
    controls: Controls,
) -> float:
    """Steps of a game in which actions are drawn evenly."""
    height = board.rows - garbage.start - 1
    aside = 1.0 if entry.place in ("random", "sweep", "opposite") else 0.75
    count = min(0.5 * aside * height * board.columns / pieces.cells, 2.2 * height)
    soft = 0.2 * (controls.down == "soft") + 0.5 * ("soft" in (controls.first, controls.second))
    piece = height * 0.55 / (2 / (gravity.slow + gravity.fast) + soft) + locking.delay * (1 + 0.6 * locking.resets)
    if controls.drop == "button":
        piece = min(piece, controls.rest + 2)
    elif controls.drop == "down":
        piece = min(piece, controls.rest + 5)
    return count * piece
