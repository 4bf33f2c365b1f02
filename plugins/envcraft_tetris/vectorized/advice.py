"""What to do in the state of a game, by the rating of :mod:`envcraft_tetris.placement`, compiled.

The advice uses the directions left and right alone. Which control turns a piece or drops it differs between variants,
and no frame shows it, so that a learner could not follow other advice in an environment that it has not seen.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_tetris.placement import _BCTS, _CLEARED, _LOST, _PAIR, _STEPS, _WON
from envcraft_tetris.vectorized.clearing import clear
from envcraft_tetris.vectorized.jit import entry, jit
from envcraft_tetris.vectorized.moves import colour
from envcraft_tetris.vectorized.records import CELLS, COLOUR, COLUMNS, DIG, FULL_ROWS, GAME, ROWS, SAND
from envcraft_tetris.vectorized.rules import maneuver

#: The joint actions of the contract ``arcade``, and those of the advice: wait, left and right.
NUM_ACTIONS = 20
WAIT, LEFT, RIGHT = 0, 12, 16
#: Differences of ratings by which the odds of two actions differ by a factor of e, and the largest that counts.
_TEMPERATURE, _WORST = 50.0, 300.0
#: The number of set bits of a row.
_COUNTS = np.array([number.bit_count() for number in range(1 << COLUMNS)], np.int64)
_HEIGHT, _ERODED, _ACROSS, _DOWN, _HOLES, _WELLS, _DEPTH, _HOLED = _BCTS


@jit
def _rows_of(rules: Any, kind: int, turn: int, column: int, piece: Any) -> bool:
    """Write the rows of a piece as bits, [CELLS]; return whether it lies between the sides."""
    piece[:] = 0
    for cell in range(rules.cells[kind]):
        x = column + rules.turns[kind, turn, cell, 1]
        if rules.wrap:
            x %= rules.columns
        if x < 0 or x >= rules.columns:
            return False
        piece[rules.turns[kind, turn, cell, 0]] |= 1 << x
    return True


@jit
def _collides(rules: Any, board: Any, piece: Any, row: int) -> bool:
    for down in range(CELLS):
        if piece[down]:
            y = row + down
            if y >= rules.rows or (y >= 0 and board[y] & piece[down]):
                return True
    return False


@jit
def _landing(rules: Any, board: Any, kind: int, turn: int, row: int, column: int) -> int:
    """The row in which a piece comes to lie that falls from `row`."""
    piece = np.zeros(CELLS, np.int64)
    if not _rows_of(rules, kind, turn, column, piece):
        return row
    while not _collides(rules, board, piece, row + 1):
        row += 1
    return row


@jit
def _features(rules: Any, board: Any) -> float:
    """The rating of a board of bits, [ROWS]."""
    columns, full = rules.columns, (1 << rules.columns) - 1
    above = covered = 0
    across = down = holes = wells = depth = holed = 0
    open_wells = np.zeros(ROWS, np.int64)
    for y in range(rules.rows):
        line = board[y]
        if rules.wrap:
            left, right = (line << 1 | line >> columns - 1) & full, (line >> 1 | line << columns - 1) & full
            across += _COUNTS[line ^ left]
        else:
            left, right = (line << 1 | 1) & full, line >> 1 | 1 << columns - 1
            across += _COUNTS[line ^ left] + 1 - (line >> columns - 1)
        down += _COUNTS[line ^ above]
        missing = covered & ~line
        if missing:
            holes += _COUNTS[missing]
            holed += 1
            over, up = missing & above, y - 1
            while over:
                depth += _COUNTS[over]
                up -= 1
                over &= board[up] if up >= 0 else 0
        covered |= line
        well = left & right & ~covered
        open_wells[y] = well
        up = y
        while well:
            wells += _COUNTS[well]
            up -= 1
            well &= open_wells[up] if up >= 0 else 0
        above = line
    down += _COUNTS[above ^ full]
    return _ACROSS * across + _DOWN * down + _HOLES * holes + _WELLS * wells + _DEPTH * depth + _HOLED * holed


@jit
def _bits(rules: Any, game: Any, board: Any) -> None:
    """Write the filled cells of a game as bits, [ROWS]."""
    for y in range(rules.rows):
        board[y] = 0
        for x in range(rules.columns):
            if game.board[y, x]:
                board[y] |= 1 << x


@jit
def _group(rules: Any, game: Any, waiting: Any, size: int) -> int:
    """The size of the group of one colour that the first `size` cells belong to, which are on the board."""
    seen = np.zeros((ROWS, COLUMNS), np.bool_)
    for place in range(size):
        seen[waiting[place, 0], waiting[place, 1]] = True
    shade = game.board[waiting[0, 0], waiting[0, 1]] if size else 0
    done = 0
    while done < size:
        y, x = waiting[done, 0], waiting[done, 1]
        done += 1
        for side in range(4):
            row, column = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
            if rules.wrap:
                column %= rules.columns
            inside = 0 <= row < rules.rows and 0 <= column < rules.columns
            if inside and game.board[row, column] == shade and not seen[row, column]:
                seen[row, column] = True
                waiting[size, 0], waiting[size, 1] = row, column
                size += 1
    return size


@jit
def _lay(
    rules: Any, game: Any, scratch: Any, goal: Any, board: Any, kind: int, turn: int, row: int, column: int, after: Any
) -> float:
    """Write the board after a landing, and return what the landing is worth by itself.

    Args:
        goal: The number of lines or groups that are missing, or -1, and whether garbage must go: (int, bool).
    """
    missing, digs = goal
    piece = np.zeros(CELLS, np.int64)
    _rows_of(rules, kind, turn, column, piece)
    worth, high, low = 0.0, ROWS, -ROWS
    lost = False
    after[:] = board
    for down in range(CELLS):
        if piece[down]:
            y = row + down
            high, low = min(high, y), max(low, y)
            lost |= y < rules.ceiling
            if y >= 0:
                after[y] |= piece[down]
    if lost:
        worth += _LOST
    worth += _HEIGHT * (rules.rows - (low + high) / 2)
    if rules.clearing == COLOUR:
        scratch.board[:] = game.board
        waiting = np.zeros((ROWS * COLUMNS, 2), np.int64)
        count = 0
        for cell in range(rules.cells[kind]):
            y, x = row + rules.turns[kind, turn, cell, 0], column + rules.turns[kind, turn, cell, 1]
            if y >= 0:
                x %= rules.columns
                scratch.board[y, x] = colour(rules, kind)
                waiting[count, 0], waiting[count, 1] = y, x
                count += 1
        size = _group(rules, scratch, waiting, count)
        worth += _PAIR * size
        if size >= rules.group:
            cleared = clear(rules, scratch)
            _bits(rules, scratch, after)
            worth += _CLEARED * rules.group
            if 0 <= missing <= cleared:
                worth += _WON
        return worth
    full, cleared, eroded, plain = (1 << rules.columns) - 1, 0, 0, rules.clearing == FULL_ROWS
    digging = digs
    for y in range(rules.rows):
        if after[y] == full:
            cleared += 1
            eroded += _COUNTS[piece[y - row]] if 0 <= y - row < CELLS else 0
        elif digs:
            for x in range(rules.columns):
                digging &= game.board[y, x] != rules.garbage
        for x in range(rules.columns):
            plain &= not rules.walls[y, x]
    eroded *= cleared
    if cleared and digging:
        worth += _WON
    if cleared and plain:
        kept = rules.rows - 1
        for y in range(rules.rows - 1, -1, -1):
            if after[y] != full:
                after[kept] = after[y]
                kept -= 1
        for y in range(kept + 1):
            after[y] = 0
    elif cleared or rules.clearing == SAND:
        for y in range(rules.rows):
            for x in range(rules.columns):
                wall = rules.walls[y, x]
                scratch.board[y, x] = wall if wall else after[y] >> x & 1
        cleared = clear(rules, scratch)
        _bits(rules, scratch, after)
    if 0 <= missing <= cleared:
        worth += _WON
    return worth + _ERODED * eroded


@jit
def _follow(game: Any, ghost: Any) -> None:
    """Copy what a maneuver changes or needs."""
    ghost.steps, ghost.cleared, ghost.pieces, ghost.kind = game.steps, game.cleared, game.pieces, game.kind
    ghost.turn, ghost.row, ghost.column = game.turn, game.row, game.column
    ghost.timer, ghost.grounded, ghost.resets = game.timer, game.grounded, game.resets
    ghost.drop_rest, ghost.first_down, ghost.second_down, ghost.lost = 0, 0, 0, 0


@jit
def _rate(rules: Any, game: Any, ghost: Any, scratch: Any, ratings: Any) -> None:
    """Rate waiting, going left and going right by the best place that each leads to, [3].

    A direction in which the piece does not move is rated -inf.
    """
    board, after = np.zeros(ROWS, np.int64), np.zeros(ROWS, np.int64)
    _bits(rules, game, board)
    ghost.board[:] = game.board
    goal = (rules.count - game.cleared if rules.count else -1, rules.goal == DIG)
    for number in range(3):
        best = -np.inf
        _follow(game, ghost)
        moves, landed, column = 0, False, game.column
        while True:
            if moves or number == 0:
                row = ghost.row if landed else _landing(rules, board, ghost.kind, ghost.turn, ghost.row, ghost.column)
                worth = _lay(rules, game, scratch, goal, board, ghost.kind, ghost.turn, row, ghost.column, after)
                best = max(best, worth + _features(rules, after))
            if number == 0 or landed or moves == _STEPS:
                break
            column = ghost.column
            ghost.steps += 1
            landed = maneuver(rules, ghost, 2 + number, 0, 0)
            moves += 1
            if ghost.column == column and not landed:
                break
        ratings[number] = best


#: See the digest of :mod:`envcraft_tetris.vectorized.kernel`.
_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    + Path(__file__).parent.with_name("placement.py").read_bytes()
).hexdigest()


def _compiled(sources: str) -> Any:
    @entry
    def rate(rules: Any, which: Any, games: Any, wanted: Any, scratch: Any, ratings: Any) -> None:
        """Write the ratings [games, 3] of the `wanted` games."""
        sources  # noqa: B018 (part of the cache key)
        for number in range(games.shape[0]):
            if wanted[number]:
                _rate(rules[which[number]], games[number], scratch[0], scratch[1], ratings[number])

    return rate


_compiled_rate = _compiled(_SOURCES)


def rate(rules: Any, which: Any, games: Any, wanted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rate waiting, going left and going right.

    Args:
        rules: The distinct rules, a :data:`~envcraft_tetris.vectorized.records.RULES` array.
        which: The number of the rules of each game, int64 [games].
        games: The games, a :data:`~envcraft_tetris.vectorized.records.GAME` array.
        wanted: The games to rate, bool [games].

    Returns:
        The ratings of the best places that the actions lead to, [games, 3]; -inf where a piece cannot move, and 0 for
        other games.
    """
    ratings = np.zeros((len(games), 3))
    _compiled_rate(rules, which, games, wanted, np.zeros(2, GAME), ratings)
    return ratings


def probabilities(ratings: NDArray[np.float64]) -> NDArray[np.float32]:
    """The softmax of ratings [games, 3] as probabilities of the joint actions, [games, 20].

    Actions with close ratings get close probabilities, which a label of the best action alone does not tell apart.
    """
    scaled = np.exp(np.maximum(ratings - ratings.max(1, keepdims=True), -_WORST) / _TEMPERATURE)
    found = np.zeros((len(ratings), NUM_ACTIONS), np.float32)
    found[:, [WAIT, LEFT, RIGHT]] = scaled / scaled.sum(1, keepdims=True)
    return found
