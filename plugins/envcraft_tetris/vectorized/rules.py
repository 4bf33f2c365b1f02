"""The reset and the step of a game, as in the generated files."""

from __future__ import annotations

from typing import Any

from envcraft_tetris.vectorized.clearing import clear
from envcraft_tetris.vectorized.jit import jit
from envcraft_tetris.vectorized.moves import colour, draw_kind, enter, fits, hold, move, period, rotate
from envcraft_tetris.vectorized.pcg64 import integer
from envcraft_tetris.vectorized.records import (
    BONUS,
    BY_IDLE_PIECES,
    BY_PIECES,
    BY_STEPS,
    CCW,
    CLOCK,
    COLOUR,
    COMBO,
    CW,
    DASH,
    DIG,
    EACH_HOLE,
    EACH_PIECE,
    EACH_ROW,
    EACH_STEP,
    FLIP,
    HARD,
    HOLD,
    LINEAR,
    LINES,
    OPPOSITE,
    RANDOM_HOLES,
    SIDEWAYS,
    SOFT,
    STAIRS,
    SURVIVE,
    SWEEP,
)

MAX_STEPS = 1000
_LONGEST_COMBO = 4
_PIECE_REWARD, _STEP_REWARD, _HOLE_REWARD, _HEIGHT_REWARD = 0.1, 0.01, -0.1, -0.1


@jit
def reset(rules: Any, game: Any) -> None:
    """Start a game. Random draws follow the order of the files: hole, entry, queue, garbage, piece."""
    game.steps = game.cleared = game.won = game.lost = 0
    game.reward = 0.0
    for y in range(rules.rows):
        for x in range(rules.columns):
            game.board[y, x] = rules.walls[y, x]
    game.hole = 0 if rules.hole_rule == RANDOM_HOLES else integer(game.random, rules.columns)
    game.bag_count = 0
    for place in range(rules.memory):
        game.recent[place] = -1
    game.entry = integer(game.random, rules.columns) if rules.entry == SWEEP else 0
    game.from_left = integer(game.random, 2) if rules.entry == OPPOSITE else 0
    game.drop_rest = game.first_down = game.second_down = game.swapped = game.pieces = game.combo = 0
    game.held = -1
    game.until_garbage = rules.every
    for place in range(rules.preview):
        game.queue[place] = draw_kind(rules, game)
    for _ in range(rules.start):
        _rise(rules, game)
    if rules.extra == EACH_HOLE:
        game.holes = _count_holes(rules, game)
    elif rules.extra == EACH_ROW:
        game.height = _stack_height(rules, game)
    enter(rules, game, -1)


@jit
def step(rules: Any, game: Any, direction: int, first: int, second: int) -> None:
    """Advance a game by one step."""
    game.steps += 1
    game.reward = 0.0
    if game.won or game.lost:
        return
    _advance(rules, game, direction, first, second)
    if game.won:
        game.reward += rules.prize
    if game.lost:
        game.reward -= rules.death


@jit
def _advance(rules: Any, game: Any, direction: int, first: int, second: int) -> None:
    landed = maneuver(rules, game, direction, first, second)
    if rules.holds and game.lost:
        return
    if landed:
        _lock(rules, game)
    _tick(rules, game)


@jit
def maneuver(rules: Any, game: Any, direction: int, first: int, second: int) -> bool:
    """Move the piece by the controls and by gravity, and return whether it has landed."""
    game.drop_rest = max(0, game.drop_rest - 1)
    first_acts = first != 0 and not (rules.first_once and game.first_down)
    second_acts = second != 0 and not (rules.second_once and game.second_down)
    game.first_down, game.second_down = first, second
    drop = False
    for control in range(3):
        function = 0
        if control == 0:
            function = _steered(rules, direction)
        elif control == 1 and first_acts:
            function = rules.first
        elif control == 2 and second_acts:
            function = rules.second
        if function:
            _act(rules, game, function, direction)
            drop |= function == HARD
    if rules.holds and game.lost:
        return False
    if drop and game.drop_rest == 0:
        while move(rules, game, game.turn, game.row + 1, game.column):
            pass
        game.drop_rest = rules.rest
        return True
    return _fall(rules, game)


@jit
def _steered(rules: Any, direction: int) -> int:
    """The function of a direction."""
    if direction == 1:
        return rules.up
    if direction == 2:
        return rules.down
    return SIDEWAYS if direction else 0


@jit
def _act(rules: Any, game: Any, function: int, direction: int) -> None:
    """Apply the function of a control. Drops are applied after all other functions."""
    across = 1 if direction == 4 else -1 if direction == 3 else 0
    if function in (CW, CCW, FLIP):
        rotate(rules, game, 1 if function == CW else 3 if function == CCW else 2)
    elif function == HOLD:
        hold(rules, game)
    elif function == SOFT:
        move(rules, game, game.turn, game.row + 1, game.column)
    elif function == SIDEWAYS or (function == DASH and across):
        for _ in range(3 if function == DASH else 1):
            if not move(rules, game, game.turn, game.row, game.column + across):
                break


@jit
def _fall(rules: Any, game: Any) -> bool:
    """Let the piece fall when its timer is up, and return whether it locks."""
    below = game.row + 1
    if rules.instant:
        game.timer -= 1
        if game.timer > 0:
            return False
        game.timer = period(rules, game)
        return not move(rules, game, game.turn, below, game.column)
    if not fits(rules, game, game.turn, below, game.column):
        game.grounded += 1
        return game.grounded > rules.delay
    game.timer -= 1
    if game.timer <= 0:
        game.timer = period(rules, game)
        game.row = below
        if rules.by_row:
            game.grounded = 0
    return False


@jit
def _lock(rules: Any, game: Any) -> None:
    """Lock the piece, clear, and let the next piece enter."""
    cells = rules.turns[game.kind, game.turn]
    for cell in range(rules.cells[game.kind]):
        y, x = game.row + cells[cell, 0], game.column + cells[cell, 1]
        if y < rules.ceiling:
            game.lost = 1
        if y >= 0:
            game.board[y, x % rules.columns] = colour(rules, game.kind)
    cleared = clear(rules, game)
    game.cleared += cleared
    _pay(rules, game, cleared)
    _count_to_garbage(rules, game, cleared)
    if not game.lost and _reached(rules, game):
        game.won = 1
    if not (game.won or game.lost):
        enter(rules, game, -1)


@jit
def _pay(rules: Any, game: Any, cleared: int) -> None:
    if rules.clears == LINEAR:
        game.reward += rules.line * cleared
    elif rules.clears == BONUS:
        game.reward += rules.bonus[min(cleared, 4)]
    elif rules.clears == COMBO:
        game.reward += rules.line * cleared * (1 + game.combo)
        game.combo = min(game.combo + 1, _LONGEST_COMBO) if cleared else 0
    if rules.extra == EACH_PIECE:
        game.reward += _PIECE_REWARD
    elif rules.extra == EACH_HOLE:
        holes = _count_holes(rules, game)
        game.reward += _HOLE_REWARD * (holes - game.holes)
        game.holes = holes
    elif rules.extra == EACH_ROW:
        height = _stack_height(rules, game)
        game.reward += _HEIGHT_REWARD * (height - game.height)
        game.height = height


@jit
def _count_to_garbage(rules: Any, game: Any, cleared: int) -> None:
    if rules.rhythm == BY_PIECES:
        game.until_garbage -= 1
    elif rules.rhythm == BY_IDLE_PIECES:
        game.until_garbage = rules.every if cleared else game.until_garbage - 1
    else:
        return
    if game.until_garbage == 0:
        game.until_garbage = rules.every
        _rise(rules, game)


@jit
def _reached(rules: Any, game: Any) -> bool:
    """Whether a goal of clearing is reached."""
    if rules.goal == LINES or rules.goal == CLOCK:
        return game.cleared >= rules.count
    if rules.goal != DIG:
        return False
    for y in range(rules.rows):
        for x in range(rules.columns):
            if game.board[y, x] == rules.garbage:
                return False
    return True


@jit
def _rise(rules: Any, game: Any) -> None:
    """Push a row of garbage in from below. Blocks that leave the board at the top lose the game."""
    board, last = game.board, rules.rows - 1
    for x in range(rules.columns):
        if board[0, x]:
            game.lost = 1
    for y in range(last):
        for x in range(rules.columns):
            board[y, x] = board[y + 1, x]
    for x in range(rules.columns):
        board[last, x] = 1 + integer(game.random, rules.shades) if rules.clearing == COLOUR else rules.garbage
    if rules.hole_rule == RANDOM_HOLES:
        board[last, integer(game.random, rules.columns)] = 0
    else:
        board[last, game.hole] = 0
    if rules.hole_rule == STAIRS:
        game.hole = (game.hole + 1) % rules.columns


@jit
def _tick(rules: Any, game: Any) -> None:
    """Apply the rules that depend on the step count."""
    if rules.rhythm == BY_STEPS and game.steps % rules.every == 0 and not (game.won or game.lost):
        _rise(rules, game)
        if not fits(rules, game, game.turn, game.row, game.column):
            game.row -= 1
    if rules.goal == CLOCK and game.steps >= rules.time and not game.won:
        game.lost = 1
    elif rules.goal == SURVIVE and game.steps >= rules.time and not game.lost:
        game.won = 1
    if rules.extra == EACH_STEP:
        game.reward += _STEP_REWARD


@jit
def _count_holes(rules: Any, game: Any) -> int:
    """The number of empty cells with a block anywhere above them."""
    holes = 0
    for x in range(rules.columns):
        covered = False
        for y in range(rules.rows):
            if game.board[y, x]:
                covered = True
            elif covered:
                holes += 1
    return holes


@jit
def _stack_height(rules: Any, game: Any) -> int:
    for y in range(rules.rows):
        for x in range(rules.columns):
            if game.board[y, x]:
                return rules.rows - y
    return 0
