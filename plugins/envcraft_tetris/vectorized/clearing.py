"""Clearing after a piece locks, and how the remaining blocks fall."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_tetris.vectorized.jit import jit
from envcraft_tetris.vectorized.records import COLOUR, COLUMNS, FULL_ROWS, ROWS, SAND, STICKY

#: The group number of a cell that belongs to no group. Groups are numbered from 1.
_NONE = 0


@jit
def clear(rules: Any, game: Any) -> int:
    """Clear all full rows or large groups, and return their number."""
    cleared = 0
    loose = rules.clearing == SAND
    while True:
        if loose and rules.clearing == STICKY:
            _settle_groups(rules, game)
        elif loose:
            _settle(rules, game)
        found = _clear_groups(rules, game) if rules.clearing == COLOUR else _clear_rows(rules, game)
        cleared += found
        if found == 0 or rules.clearing == FULL_ROWS:
            return cleared
        loose = True


@jit
def _clear_rows(rules: Any, game: Any) -> int:
    """Clear the rows that are full now, from top to bottom, so that the rows still to clear stay in place."""
    board, wall = game.board, rules.wall
    full = np.zeros(ROWS, np.bool_)
    count = 0
    for y in range(rules.rows):
        taken = 0
        for x in range(rules.columns):
            taken += board[y, x] != 0
        full[y] = taken == rules.columns
        count += full[y]
    for y in range(rules.rows):
        if full[y]:
            for row in range(y, -1, -1):
                for x in range(rules.columns):
                    above = board[row - 1, x] if row else 0
                    if board[row, x] != wall:
                        board[row, x] = 0 if above == wall else above
    return count


@jit
def _settle(rules: Any, game: Any) -> None:
    """Drop every block as far as possible."""
    board, wall = game.board, rules.wall
    for x in range(rules.columns):
        floor = rules.rows - 1
        for y in range(rules.rows - 1, -1, -1):
            block = board[y, x]
            if block == wall:
                floor = y - 1
            elif block:
                board[y, x] = 0
                board[floor, x] = block
                floor -= 1


@jit
def _spread(rules: Any, board: NDArray[np.int8], groups: NDArray[np.int16], start: int, number: int) -> int:
    """Number the group of a cell and return its size. Under the rule `colour`, a group has a single colour."""
    waiting = np.empty(ROWS * COLUMNS, np.int16)
    columns, alike = rules.columns, rules.clearing == COLOUR
    size, done = 1, 0
    waiting[0] = start
    groups[start // columns, start % columns] = number
    while done < size:
        y, x = waiting[done] // columns, waiting[done] % columns
        done += 1
        for side in range(4):
            row, column = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
            if rules.wrap:
                column %= columns
            if row < 0 or row >= rules.rows or column < 0 or column >= columns or groups[row, column] != _NONE:
                continue
            block = board[row, column]
            if block and block != rules.wall and (not alike or block == board[y, x]):
                groups[row, column] = number
                waiting[size] = row * columns + column
                size += 1
    return size


@jit
def _clear_groups(rules: Any, game: Any) -> int:
    board = game.board
    groups = np.zeros((ROWS, COLUMNS), np.int16)
    large = np.zeros(ROWS * COLUMNS + 1, np.bool_)
    number = found = 0
    for start in range(rules.rows * rules.columns):
        y, x = start // rules.columns, start % rules.columns
        if board[y, x] and board[y, x] != rules.wall and groups[y, x] == _NONE:
            number += 1
            large[number] = _spread(rules, board, groups, start, number) >= rules.group
            found += large[number]
    for y in range(rules.rows):
        for x in range(rules.columns):
            if large[groups[y, x]]:
                board[y, x] = 0
    return found


@jit
def _hangs(rules: Any, board: NDArray[np.int8], groups: NDArray[np.int16], number: int) -> bool:
    for y in range(rules.rows):
        for x in range(rules.columns):
            if groups[y, x] == number:
                if y + 1 >= rules.rows:
                    return False
                if groups[y + 1, x] != number and board[y + 1, x]:
                    return False
    return True


@jit
def _hanging(rules: Any, board: NDArray[np.int8], groups: NDArray[np.int16]) -> int:
    """The number of the first unsupported group, searched from the last cell; 0 if there is none."""
    for y in range(rules.rows):
        for x in range(rules.columns):
            groups[y, x] = _NONE
    number = 0
    for start in range(rules.rows * rules.columns - 1, -1, -1):
        y, x = start // rules.columns, start % rules.columns
        if board[y, x] and board[y, x] != rules.wall and groups[y, x] == _NONE:
            number += 1
            _spread(rules, board, groups, start, number)
            if _hangs(rules, board, groups, number):
                return number
    return 0


@jit
def _settle_groups(rules: Any, game: Any) -> None:
    """Drop connected blocks together, row by row, until nothing moves."""
    board = game.board
    groups = np.empty((ROWS, COLUMNS), np.int16)
    while True:
        number = _hanging(rules, board, groups)
        if number == 0:
            return
        for y in range(rules.rows - 2, -1, -1):
            for x in range(rules.columns):
                if groups[y, x] == number:
                    board[y + 1, x], board[y, x] = board[y, x], 0
