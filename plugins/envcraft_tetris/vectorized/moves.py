"""The falling piece: collisions, moves, rotation, the order of pieces and their entry."""

from __future__ import annotations

from typing import Any

from envcraft_tetris.vectorized.jit import jit
from envcraft_tetris.vectorized.pcg64 import integer, permute
from envcraft_tetris.vectorized.records import ANYWHERE, LEFT_SIDE, LEVELS, MIDDLE, OPPOSITE, PIECES, PULSE, RAMP, SWEEP


@jit
def colour(rules: Any, kind: int) -> int:
    """The colour code of the blocks of a piece."""
    return kind % rules.shades + 1


@jit
def fits(rules: Any, game: Any, turn: int, row: int, column: int) -> bool:
    """Whether the falling piece fits at a position."""
    cells, board = rules.turns[game.kind, turn], game.board
    for cell in range(rules.cells[game.kind]):
        y, x = row + cells[cell, 0], column + cells[cell, 1]
        if rules.wrap:
            x %= rules.columns
        if y >= rules.rows or x < 0 or x >= rules.columns or (y >= 0 and board[y, x]):
            return False
    return True


@jit
def move(rules: Any, game: Any, turn: int, row: int, column: int) -> bool:
    """Move the piece if it fits, and return whether it does."""
    if not fits(rules, game, turn, row, column):
        return False
    game.turn, game.row = turn, row
    game.column = column % rules.columns if rules.wrap else column
    if game.grounded and game.resets:
        game.resets -= 1
        game.grounded = 0
    return True


@jit
def rotate(rules: Any, game: Any, quarters: int) -> None:
    """Rotate the piece by quarter turns clockwise, at the first kick that fits."""
    turn = (game.turn + quarters) % 4
    for kick in range(rules.kick_count):
        if move(rules, game, turn, game.row + rules.kicks[kick, 0], game.column + rules.kicks[kick, 1]):
            return


@jit
def period(rules: Any, game: Any) -> int:
    """The steps in which a piece falls by one row."""
    if rules.schedule == PULSE:
        return rules.fast if game.steps // rules.level % 2 else rules.slow
    if rules.schedule == LEVELS:
        return max(rules.fast, rules.slow - game.cleared // rules.level)
    if rules.schedule == RAMP:
        return max(rules.fast, rules.slow - game.steps // rules.level)
    if rules.schedule == PIECES:
        return max(rules.fast, rules.slow - game.pieces // rules.level)
    return rules.slow


@jit
def draw_kind(rules: Any, game: Any) -> int:
    """Draw the next kind from the bag or from the weighted lots."""
    if rules.bag:
        if game.bag_count == 0:
            permute(game.random, game.bag, rules.bag)
            game.bag_count = rules.bag
        game.bag_count -= 1
        return game.bag[game.bag_count] % rules.kinds
    kind = rules.lots[integer(game.random, rules.lot_count)]
    recent = game.recent
    for _ in range(rules.tries - 1):
        known = False
        for place in range(rules.memory):
            known |= recent[place] == kind
        if not known:
            break
        kind = rules.lots[integer(game.random, rules.lot_count)]
    for place in range(rules.memory - 1):
        recent[place] = recent[place + 1]
    if rules.memory:
        recent[rules.memory - 1] = kind
    return kind


@jit
def next_kind(rules: Any, game: Any) -> int:
    """The kind that enters: the first of the preview, or a new draw without one."""
    drawn = draw_kind(rules, game)
    if rules.preview == 0:
        return drawn
    queue = game.queue
    kind = queue[0]
    for place in range(rules.preview - 1):
        queue[place] = queue[place + 1]
    queue[rules.preview - 1] = drawn
    return kind


@jit
def _entry_column(rules: Any, game: Any) -> int:
    width = rules.columns - rules.sides[game.kind]
    if rules.entry == MIDDLE:
        return width // 2
    if rules.entry == ANYWHERE:
        return integer(game.random, width + 1)
    if rules.entry == SWEEP:
        return game.entry % (width + 1)
    if rules.entry == LEFT_SIDE or (rules.entry == OPPOSITE and game.from_left):
        return 0
    return width


@jit
def enter(rules: Any, game: Any, kind: int) -> None:
    """Let a piece of a kind enter, or of the next kind if it is -1. The game is lost if the piece does not fit."""
    game.kind = next_kind(rules, game) if kind < 0 else kind
    game.turn = game.row = 0
    game.column = _entry_column(rules, game)
    game.entry += rules.entry_step
    game.from_left = 1 - game.from_left
    game.swapped = 0
    game.pieces += 1
    game.timer = period(rules, game)
    game.grounded = 0
    game.resets = rules.resets
    if not fits(rules, game, game.turn, game.row, game.column):
        game.lost = 1


@jit
def hold(rules: Any, game: Any) -> None:
    """Swap the falling piece with the held one, once per piece."""
    if game.swapped:
        return
    kind = game.held
    game.held = game.kind
    enter(rules, game, kind)
    game.swapped = 1
