"""The records of the simulator: the rules of a variant, and the state of a game."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_tetris.axes.clearing import RULES as CLEARING
from envcraft_tetris.axes.controls import FUNCTIONS
from envcraft_tetris.axes.ending import GOALS
from envcraft_tetris.axes.entry import PLACES
from envcraft_tetris.axes.garbage import HOLES, RHYTHMS
from envcraft_tetris.axes.gravity import SCHEDULES
from envcraft_tetris.axes.pieces import Piece
from envcraft_tetris.axes.rewards import CLEARS, EXTRAS
from envcraft_tetris.axes.rotation import KICKS
from envcraft_tetris.variant import Variant

SIZE = 84
#: Upper bounds over all variants.
ROWS, COLUMNS, KINDS, CELLS, CODES, CELL = 20, 12, 9, 5, 20, 7
PREVIEW, MEMORY, BAG, LOTS, KICK = 3, 4, 2 * KINDS, 6 * KINDS, 6

#: Fields that bound loops over arrays in compiled code, with the lengths of these arrays.
_MOST = {
    "rows": ROWS,
    "columns": COLUMNS,
    "kinds": KINDS,
    "shades": CODES,
    "lot_count": LOTS,
    "memory": MEMORY,
    "preview": PREVIEW,
    "kick_count": KICK,
    "cell": CELL,
}

#: Enumerations in the order of the lists of the axes. A control without a function has 0.
MIDDLE, LEFT_SIDE, RIGHT_SIDE, ANYWHERE, SWEEP, OPPOSITE = range(len(PLACES))
CW, CCW, FLIP, SOFT, HARD, HOLD, DASH = range(1, 1 + len(FUNCTIONS))
SIDEWAYS = 1 + len(FUNCTIONS)
CONSTANT, LEVELS, RAMP, PIECES, PULSE = range(len(SCHEDULES))
FULL_ROWS, CASCADE, STICKY, SAND, COLOUR = range(len(CLEARING))
NO_GARBAGE, BY_STEPS, BY_PIECES, BY_IDLE_PIECES = range(len(RHYTHMS))
RANDOM_HOLES, STAIRS, STAYS = range(len(HOLES))
ENDLESS, LINES, CLOCK, SURVIVE, DIG = range(len(GOALS))
LINEAR, BONUS, COMBO, SPARSE = range(len(CLEARS))
NO_EXTRA, EACH_PIECE, EACH_HOLE, EACH_ROW, EACH_STEP = range(len(EXTRAS))

#: Named colours. The code of a colour that a variant lacks is -1.
_COLOURS = ("WALL", "GARBAGE", "EMPTY_TOO", "SHADOW", "PAGE", "RIM", "BAR")
_NUMBERS = (
    *("rows", "columns", "wrap", "kinds", "shades", "bag", "lot_count", "tries", "memory", "preview", "entry"),
    *("entry_step", "up", "down", "first", "second", "first_once", "second_once", "rest", "holds", "kick_count"),
    *("schedule", "slow", "fast", "level", "instant", "delay", "by_row", "resets", "clearing", "group"),
    *("start", "rhythm", "every", "hole_rule", "goal", "count", "time", "ceiling", "clears", "extra"),
    *("cell", "top", "left", "panel", *(name.lower() for name in _COLOURS)),
)
#: All integers have one type, because numba compiles a function for every combination of argument types.
RULES = np.dtype(
    [(name, np.int64) for name in _NUMBERS]
    + [(name, np.float64) for name in ("line", "prize", "death")]
    + [
        ("bonus", np.float64, 5),
        # The codes of the walls and of the empty cells.
        ("walls", np.int8, (ROWS, COLUMNS)),
        ("field", np.int8, (ROWS, COLUMNS)),
        ("lots", np.int64, LOTS),
        ("kicks", np.int64, (KICK, 2)),
        # For each kind of piece: the side of its box, the number of its cells, and their positions by orientation.
        ("sides", np.int64, KINDS),
        ("cells", np.int64, KINDS),
        ("turns", np.int64, (KINDS, 4, CELLS, 2)),
        ("palette", np.uint8, (CODES, 3)),
        ("tiles", np.uint8, (CODES, CELL, CELL, 3)),
    ]
)

#: Fields are named as in the generated files. Fields that start with `shown` describe the rendered frame.
GAME = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("steps", "cleared", "kind", "turn", "row", "column", "timer", "grounded", "resets", "entry", "from_left"),
            *("pieces", "until_garbage", "hole", "combo", "holes", "height", "drop_rest", "first_down", "second_down"),
            *("held", "swapped", "won", "lost", "bag_count", "shown_cleared", "shown_time"),
        )
    ]
    + [("reward", np.float64)]
    + [
        ("random", np.uint64, 6),
        ("bag", np.int64, BAG),
        ("queue", np.int64, PREVIEW),
        ("recent", np.int64, MEMORY),
        ("board", np.int8, (ROWS, COLUMNS)),
        ("wanted", np.int8, (ROWS, COLUMNS)),
        ("shown", np.int8, (ROWS, COLUMNS)),
        ("shown_panel", np.int64, PREVIEW + 1),
    ]
)


def fill(record: Any, variant: Variant) -> None:
    """Write the rules of a variant into a record of :data:`RULES`. Raises ValueError if one exceeds its bound."""
    record["lots"] = record["kicks"] = 0
    for part in (_board, _pieces, _supply, _controls, _timing, _ending, _look):
        for name, value in part(variant).items():
            if np.ndim(value):
                place = tuple(slice(length) for length in np.shape(value))
                record[name][place] = value
            else:
                record[name] = value
    for name, most in _MOST.items():
        if not 0 <= record[name] <= most:
            raise ValueError(f"{name} is {record[name]}; the simulator supports at most {most}")


def _board(variant: Variant) -> dict[str, Any]:
    board = variant.board
    codes, _ = variant.look.palette(variant)
    walls = np.array([[codes["WALL"] * (mark == "#") for mark in row] for row in board.walls], np.int8)
    blank = np.zeros((board.rows, board.columns), np.int8)
    return {
        "rows": board.rows,
        "columns": board.columns,
        "wrap": board.wrap,
        "walls": walls if board.walls else blank,
    }


def turns(piece: Piece, system: str) -> list[list[tuple[int, int]]]:
    """The cells (row, column) of a piece in its four orientations, as in the generated files."""
    found = []
    for _ in range(4):
        cells = [(y, x) for y, row in enumerate(piece) for x, mark in enumerate(row) if mark == "#"]
        up, left = min(y for y, _ in cells), min(x for _, x in cells)
        if system == "square":
            up = left = 0
        elif system == "foot":
            up = max(y for y, _ in cells) + 1 - len(piece)
        found.append([(y - up, x - left) for y, x in cells])
        piece = tuple("".join(column) for column in zip(*piece[::-1], strict=True))
    return found


def _pieces(variant: Variant) -> dict[str, Any]:
    positions = np.zeros((KINDS, 4, CELLS, 2), np.int64)
    art = variant.pieces.art
    for kind, piece in enumerate(art):
        cells = np.array(turns(piece, variant.rotation.system))
        positions[kind, :, : cells.shape[1]] = cells
    kicks = ((0, 0), *KICKS[variant.rotation.kicks])
    return {
        "kinds": len(art),
        "shades": variant.clearing.colours or len(art),
        "sides": [len(piece) for piece in art],
        "cells": ["".join(piece).count("#") for piece in art],
        "turns": positions,
        "kicks": kicks,
        "kick_count": len(kicks),
    }


def _supply(variant: Variant) -> dict[str, Any]:
    """A uniform order draws from one lot per kind, like `history` without memory and with one try."""
    supply, kinds = variant.supply, len(variant.pieces.art)
    lots = [kind for kind, weight in enumerate(supply.weights or (1,) * kinds) for _ in range(weight)]
    return {
        "bag": {"bag": kinds, "double bag": 2 * kinds}.get(supply.order, 0),
        "lots": lots,
        "lot_count": len(lots),
        "tries": supply.tries or 1,
        "memory": supply.memory,
        "preview": supply.preview,
        "entry": PLACES.index(variant.entry.place),
        "entry_step": variant.entry.step,
    }


def _controls(variant: Variant) -> dict[str, Any]:
    controls = variant.controls
    numbers = {"": 0, **{name: number for number, name in enumerate(FUNCTIONS, 1)}}
    functions: dict[str, Any] = {name: numbers[getattr(controls, name)] for name in ("up", "down", "first", "second")}
    for button in ("first", "second"):
        functions[f"{button}_once"] = controls.press == "once" and getattr(controls, button) not in ("soft", "dash")
    return {**functions, "rest": controls.rest, "holds": controls.holds}


def _timing(variant: Variant) -> dict[str, Any]:
    gravity, locking, garbage = variant.gravity, variant.locking, variant.garbage
    return {
        "schedule": SCHEDULES.index(gravity.schedule),
        "slow": gravity.slow,
        "fast": gravity.fast,
        "level": gravity.every,
        "instant": locking.kind == "instant",
        "delay": locking.delay,
        "by_row": locking.kind == "row",
        "resets": locking.resets,
        "start": garbage.start,
        "rhythm": RHYTHMS.index(garbage.rhythm),
        "every": garbage.every,
        "hole_rule": HOLES.index(garbage.holes),
    }


def _ending(variant: Variant) -> dict[str, Any]:
    clearing, ending, rewards = variant.clearing, variant.ending, variant.rewards
    return {
        "clearing": CLEARING.index(clearing.rule),
        "group": clearing.group,
        "goal": GOALS.index(ending.goal),
        "count": ending.count,
        "time": ending.steps,
        "ceiling": ending.ceiling,
        "clears": CLEARS.index(rewards.clears),
        "extra": EXTRAS.index(rewards.extra),
        "line": rewards.line,
        "prize": rewards.prize,
        "death": rewards.death,
        "bonus": rewards.bonus,
    }


def _look(variant: Variant) -> dict[str, Any]:
    look, board = variant.look, variant.board
    codes, colours = look.palette(variant)
    palette = np.frombuffer(bytes.fromhex(" ".join(colours)), np.uint8).reshape(-1, 3)
    cell, top, left, panel = look.layout(variant)
    tiles = np.stack([_tile(look.style, colour, palette[0], cell) for colour in palette])
    named: dict[str, Any] = {name.lower(): codes.get(name, -1) for name in _COLOURS}
    for name in ("EMPTY", "EMPTY_TOO", "SHADOW"):
        if name in codes:
            tiles[codes[name]] = palette[codes[name]]
    y, x = np.indices((board.rows, board.columns))
    second = {"plain": 0 * x, "checks": (y + x) % 2, "columns": x % 2}[look.field]
    field = second * named["empty_too"]
    return {
        **named,
        "cell": cell,
        "top": top,
        "left": left,
        "panel": panel,
        "field": field,
        "palette": palette,
        "tiles": tiles,
    }


def _tile(style: str, colour: NDArray[np.uint8], empty: NDArray[np.uint8], cell: int) -> NDArray[np.uint8]:
    """A block of a colour, shape (cell, cell, 3), as in the generated files."""
    pixels = np.tile(colour, (cell, cell, 1))
    if style == "grid":
        pixels[-1] = pixels[:, -1] = empty
    elif style == "bevel":
        pixels[0] = pixels[:, 0] = colour // 2 + 127
        pixels[-1] = pixels[:, -1] = colour // 2
    elif style == "outline":
        pixels[1:-1, 1:-1] = colour // 3
    elif style == "dot":
        pixels[cell // 2, cell // 2] = 255 - colour
    elif style == "stripes":
        pixels[1::2] = colour // 2
    return pixels
