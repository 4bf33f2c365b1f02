"""Estimates of episode lengths from the rules alone, used to reject variants that end at once or never.

The coefficients are fitted to played episodes. An estimate is accurate to a factor of about two.
"""

from __future__ import annotations

from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.controls import Controls
from envcraft_tetris.axes.entry import Entry
from envcraft_tetris.axes.garbage import Garbage
from envcraft_tetris.axes.gravity import Gravity
from envcraft_tetris.axes.locking import Locking
from envcraft_tetris.axes.pieces import Pieces


def idle_steps(pieces: Pieces, board: Board, entry: Entry, gravity: Gravity, garbage: Garbage) -> float:
    """Estimate the steps of an episode without any input, in which pieces pile up below their entry."""
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
    """Estimate the steps of an episode of uniformly random actions."""
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
