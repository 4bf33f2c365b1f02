"""Incremental rendering: only what changed since the last frame is drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_tetris.vectorized.jit import jit
from envcraft_tetris.vectorized.moves import colour, fits
from envcraft_tetris.vectorized.records import CLOCK, LINES, PREVIEW, SIZE, SURVIVE

#: Added to the code of a cell under the falling piece or its shadow, which also cover the ceiling line.
_OVER = 64
#: The width of a bar in a frame that has not been drawn.
UNDRAWN = -2
_BAR_LEFT, _BAR_WIDTH = 2, 80
_PANEL_TOP, _PANEL_STEP, _PANEL_SIDE, _HELD_TOP = 8, 18, 14, 66


@jit
def draw_background(rules: Any, game: Any, frame: NDArray[np.uint8]) -> None:
    """Draw the surroundings of the board and mark its contents as not drawn."""
    _fill(frame, 0, SIZE, 0, SIZE, rules.palette[rules.page])
    bottom, right = rules.top + rules.cell * rules.rows, rules.left + rules.cell * rules.columns
    _fill(frame, rules.top - 1, bottom + 1, rules.left - 1, right + 1, rules.palette[rules.rim])
    for y in range(rules.rows):
        for x in range(rules.columns):
            game.shown[y, x] = -1
    for place in range(PREVIEW + 1):
        game.shown_panel[place] = -1
    game.shown_cleared = game.shown_time = -1


@jit
def draw(rules: Any, game: Any, frame: NDArray[np.uint8]) -> None:
    """Update a frame of shape (84, 84, 3)."""
    _arrange(rules, game)
    wanted, shown = game.wanted, game.shown
    for y in range(rules.rows):
        for x in range(rules.columns):
            if wanted[y, x] != shown[y, x]:
                shown[y, x] = wanted[y, x]
                _draw_cell(rules, frame, y, x, wanted[y, x])
    if rules.preview or rules.holds:
        _draw_panel(rules, game, frame)
    if rules.goal == LINES or rules.goal == CLOCK:
        _draw_cleared(rules, game, frame)
    if rules.goal == CLOCK or rules.goal == SURVIVE:
        _draw_time(rules, game, frame)


@jit
def _arrange(rules: Any, game: Any) -> None:
    """Write the codes of all cells into ``wanted``: the board, the shadow and the piece."""
    wanted, board, field = game.wanted, game.board, rules.field
    for y in range(rules.rows):
        for x in range(rules.columns):
            wanted[y, x] = board[y, x] if board[y, x] else field[y, x]
    if rules.shadow >= 0:
        depth = 0
        while fits(rules, game, game.turn, game.row + depth + 1, game.column):
            depth += 1
        _lay(rules, game, game.row + depth, rules.shadow + _OVER)
    _lay(rules, game, game.row, colour(rules, game.kind) + _OVER)


@jit
def _lay(rules: Any, game: Any, row: int, code: int) -> None:
    cells = rules.turns[game.kind, game.turn]
    for cell in range(rules.cells[game.kind]):
        y, x = row + cells[cell, 0], (game.column + cells[cell, 1]) % rules.columns
        if y >= 0:
            game.wanted[y, x] = code


@jit
def _draw_cell(rules: Any, frame: NDArray[np.uint8], y: int, x: int, code: int) -> None:
    top, left = rules.top + rules.cell * y, rules.left + rules.cell * x
    tile = rules.tiles[code % _OVER]
    for down in range(rules.cell):
        for across in range(rules.cell):
            for channel in range(3):
                frame[top + down, left + across, channel] = tile[down, across, channel]
    if rules.ceiling and y == rules.ceiling and code < _OVER:
        for across in range(rules.cell * x % 2, rules.cell, 2):
            for channel in range(3):
                frame[top, left + across, channel] = rules.palette[rules.bar, channel]


@jit
def _draw_panel(rules: Any, game: Any, frame: NDArray[np.uint8]) -> None:
    """Draw the next pieces and the held piece whose kinds changed."""
    for place in range(PREVIEW + 1):
        held = place == PREVIEW
        kind = game.held if held else game.queue[place] if place < rules.preview else -1
        if kind == game.shown_panel[place]:
            continue
        game.shown_panel[place] = kind
        top = _HELD_TOP if held else _PANEL_TOP + _PANEL_STEP * place
        _fill(frame, top, top + _PANEL_SIDE, rules.panel, rules.panel + _PANEL_SIDE, rules.palette[rules.page])
        if kind >= 0:
            cells = rules.turns[kind, 0]
            for cell in range(rules.cells[kind]):
                y, x = top + 3 * cells[cell, 0], rules.panel + 3 * cells[cell, 1]
                _fill(frame, y, y + 2, x, x + 2, rules.palette[colour(rules, kind)])


@jit
def _draw_cleared(rules: Any, game: Any, frame: NDArray[np.uint8]) -> None:
    width = _BAR_WIDTH * min(game.cleared, rules.count) // rules.count
    if width != game.shown_cleared:
        game.shown_cleared = width
        _fill(frame, 1, 3, _BAR_LEFT, _BAR_LEFT + _BAR_WIDTH, rules.palette[rules.rim])
        _fill(frame, 1, 3, _BAR_LEFT, _BAR_LEFT + width, rules.palette[rules.bar])


@jit
def _draw_time(rules: Any, game: Any, frame: NDArray[np.uint8]) -> None:
    width = _BAR_WIDTH * min(game.steps, rules.time) // rules.time
    if width != game.shown_time:
        game.shown_time = width
        _fill(frame, 82, 83, _BAR_LEFT, _BAR_LEFT + _BAR_WIDTH, rules.palette[rules.page])
        _fill(frame, 82, 83, _BAR_LEFT, _BAR_LEFT + width, rules.palette[rules.bar])


@jit
def _fill(frame: NDArray[np.uint8], top: int, bottom: int, left: int, right: int, pixel: NDArray[np.uint8]) -> None:
    for y in range(top, bottom):
        for x in range(left, right):
            for channel in range(3):
                frame[y, x, channel] = pixel[channel]
