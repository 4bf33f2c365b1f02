"""A player of the family `tetris`: tries where each piece can come to lie, and rates the board that is left.

The text of this file is the policy that runs beside the environment (``act(state)``), so it needs nothing but the
standard library. It reads the whole state and changes none of it: moves are tried on a stand-in of the game's own
class, whose rules are therefore those of the variant: turning and kicks, gravity and lock delay, sides that are one,
walls, and whatever is cleared.

A board is rated by the features of Dellacherie and the two that Thiery and Scherrer added, with the weights of their
controller BCTS (C. Thiery and B. Scherrer, "Building Controllers for Tetris", ICGA Journal 32(1), 3-11, 2009). The
depth of a hole is the number of successive blocks right above it, as in their program. Where groups of a colour are
cleared, neighbours of one colour count besides.
"""

from __future__ import annotations

from typing import Any

Move = tuple[int, int, int]
_WAIT: Move = (0, 0, 0)
_LEFT, _RIGHT = 3, 4
#: So many steps are tried to get a piece where it is to fall.
_STEPS = 16
#: Landing height, eroded cells (lines cleared times the piece's cells in them), row transitions, column transitions,
#: holes, cumulative wells, depth of holes, rows with holes.
_BCTS = (-12.63, 6.60, -9.22, -19.77, -13.08, -10.49, -1.61, -24.04)
_LOST, _WON = -1e6, 1e5
#: A piece may be put aside while so many rows are free. So many steps before the last one, it hurries.
_ROOM, _REST = 5, 20
#: Per pair of neighbours of one colour, and per block that is cleared, under the rule that clears groups.
_PAIR, _CLEARED = 25.0, 40.0
#: So many of the best placements are told apart by what the next piece would find.
_AHEAD = 5
#: A goal takes more pieces than its blocks by this factor.
_WASTE = 1.4


class Placement:
    """Plays one episode."""

    def __init__(self) -> None:
        self._game: Game | None = None
        self._plan: list[Move] = []
        self._expected: tuple[int, ...] | None = None

    def act(self, state: Any) -> Move:
        env = state.step.__self__
        if self._game is None:
            self._game = Game(env)
        game = self._game
        game.follow(env)
        if self._expected != game.place():
            self._plan = game.plan()
        move = self._plan.pop(0) if self._plan else game.rest()
        game.follow(env)
        landed = game.advance(move)
        if landed and game.room > _ROOM:
            game.follow(env)
            # A piece that is put aside at the last moment falls once more later.
            move = game.aside() or move
        self._expected = None if landed else game.place()
        return move


class Game:
    """The rules and the state of a game, and a stand-in on which moves are tried."""

    def __init__(self, env: Any) -> None:
        names = env.step.__func__.__globals__
        self.rows, self.columns = names["ROWS"], names["COLUMNS"]
        self.full = (1 << self.columns) - 1
        self.wrap = bool(env._fits(0, -9, -3))
        self._names = names
        self._turns = names["TURNS"]
        self._colours = names.get("COLOURS", 0)
        self._group = names.get("GROUP", 0)
        self._wall = names.get("WALL", -1)
        self._top = names.get("CEILING", 0)
        # Where blocks fall before rows are looked at, every piece crumbles.
        self._crumbles = env._clear.__func__.__code__.co_names[0] == "_settle"
        self._walls = [sum(1 << x for x, block in enumerate(row) if block == self._wall) for row in env.board]
        self._plain = not hasattr(env, "_settle") and not any(self._walls)
        self._masks: dict[tuple[int, int, int], tuple[tuple[int, int], ...] | None] = {}
        self._class = type(env)
        self._ghost = self._stand_in(env)
        self._controls = self._probe()
        self._hurry = False
        self._back = 0
        self.room = 0
        # Steps that a piece takes to the ground.
        self._fall = 0.7 * self.rows * names.get("FALL_EVERY", (names.get("SLOW", 0) + names.get("FAST", 0)) / 2)
        self._goal = names.get("GOAL", 0)
        self._digs = hasattr(env, "won") and not self._goal and "TIME" not in names
        self._garbage: set[int] = set()
        self._limit = min(names.get("TIME", names["MAX_STEPS"]), names["MAX_STEPS"])
        self._rising = "GARBAGE_EVERY" in names and not hasattr(env, "until_garbage")
        self._each = self._group or self.columns
        self._cells = sum(len(turns[0]) for turns in self._turns) / len(self._turns)
        self.follow(env)

    # -- the stand-in ----------------------------------------------------------------------------------------------

    def _stand_in(self, env: Any) -> Any:
        """An object of the same class that can be moved: what comes after a landing, and what is drawn, is left out."""
        ghost = object.__new__(self._class)
        ghost.__dict__.update(env.__dict__)

        def landed() -> None:
            ghost.landed = True

        def nothing(*_: Any) -> None:
            pass

        ghost._lock, ghost._hold = landed, nothing
        ghost._paint = ghost._rise = ghost._enter = nothing
        self._own = {name: ghost.__dict__[name] for name in ("_lock", "_hold", "_paint", "_rise", "_enter")}
        return ghost

    def follow(self, env: Any) -> None:
        """Take over the state of the environment."""
        state = self._ghost.__dict__
        state.update(env.__dict__)
        state.update(self._own)
        state["landed"] = False

    def place(self) -> tuple[int, ...]:
        """What tells whether the game is where it was expected to be."""
        ghost = self._ghost
        return ghost.kind, ghost.turn, ghost.row, ghost.column, ghost.steps

    def advance(self, move: Move) -> bool:
        """Move the stand-in; give whether the piece has landed."""
        ghost = self._ghost
        ghost.steps += 1
        ghost._advance(*move)
        return bool(ghost.landed)

    def _probe(self) -> dict[str, Move]:
        """Which control does what, by trying each in the middle of an empty board."""
        ghost, found = self._ghost, {}
        state = dict(ghost.__dict__)
        wall = self._wall
        board = [[block if block == wall else 0 for block in row] for row in state["board"]]
        held: list[bool] = []
        free = next(
            (row, column)
            for row in range(1, self.rows)
            for column in range(self.columns // 2 - 2, self.columns)
            if all(self._clears(board, state["kind"], turn, row, column) for turn in range(4))
        )
        state |= {"board": board, "turn": 0, "row": free[0], "column": free[1], "timer": 99, "grounded": 0, "steps": 1}
        state |= {"first_down": False, "second_down": False, "drop_rest": 0, "swapped": False, "lost": False}
        state["_hold"] = lambda: held.append(True)
        for move in ((1, 0, 0), (2, 0, 0), (0, 1, 0), (0, 0, 1)):
            ghost.__dict__.clear()
            ghost.__dict__.update(state, landed=False)
            held.clear()
            ghost._advance(*move)
            if ghost.turn:
                found[f"turn {ghost.turn}"] = move
            elif held:
                found["hold"] = move
            elif ghost.landed:
                found["hard"] = move
            elif ghost.row > free[0]:
                found["soft"] = move
        for move in ((_RIGHT, 1, 0), (_RIGHT, 0, 1)):
            ghost.__dict__.clear()
            ghost.__dict__.update(state, landed=False, column=0, row=0)
            ghost._advance(*move)
            if ghost.column > 1 and ghost.turn == 0:
                found["dash"] = (0, *move[1:])
        ghost.__dict__.clear()
        return found

    def _clears(self, board: list[list[int]], kind: int, turn: int, row: int, column: int) -> bool:
        for down, across in self._turns[kind][turn]:
            y, x = row + down, column + across
            if y + 1 >= self.rows or not 0 <= x < self.columns or board[y][x] or board[y + 1][x]:
                return False
        return True

    # -- where the piece can go ------------------------------------------------------------------------------------

    def plan(self) -> list[Move]:
        """The moves that bring the piece above the best place for it."""
        ghost = self._ghost
        self._back = 0
        start = dict(ghost.__dict__)
        self._note(ghost)
        board = self._bits(ghost.board)
        found: dict[tuple[int, int, int], list[Move]] = {}
        dash = self._controls.get("dash")
        for turn in range(4):
            for direction in (_LEFT, _RIGHT):
                for fast in (False, True) if dash else (False,):
                    self._steer(start, board, turn, direction, dash if fast else None, found)
        ghost.__dict__.update(start)
        rated = sorted(((self._rate(board, ghost.kind, *place), place) for place in found), reverse=True)
        queue = getattr(ghost, "queue", None)
        if queue and len(rated) > 1 and rated[0][0] > _LOST / 2:
            kind = queue[0]
            ahead = [(self._followed(board, ghost.kind, place, kind), place) for _, place in rated[:_AHEAD]]
            rated = sorted(ahead, reverse=True)
        return found[rated[0][1]] if rated else []

    def _steer(
        self,
        start: dict[str, Any],
        board: list[int],
        turn: int,
        direction: int,
        dash: Move | None,
        found: dict[tuple[int, int, int], list[Move]],
    ) -> None:
        """Go one way and turn on the way; every place that the piece could fall from is one to land at."""
        ghost = self._ghost
        state = ghost.__dict__
        state.update(start)
        moves: list[Move] = []
        before = None
        for _ in range(_STEPS):
            if ghost.turn == turn:
                place = (turn, self._landing(board, ghost.kind, turn, ghost.row, ghost.column), ghost.column)
                if place not in found or len(moves) < len(found[place]):
                    found[place] = list(moves)
            move = self._toward(turn, direction, dash)
            if move is None:
                return
            ghost.steps += 1
            ghost._advance(*move)
            moves.append(move)
            here = (ghost.turn, ghost.column)
            if ghost.landed:
                place = (ghost.turn, ghost.row, ghost.column)
                if place not in found:
                    found[place] = moves
                return
            if here == before and ghost.turn == turn:
                return
            before = here

    def _toward(self, turn: int, direction: int, dash: Move | None) -> Move | None:
        """The next move of a piece that is to be turned and to go one way; None where its controls cannot turn it."""
        left = (turn - self._ghost.turn) % 4
        if not left:
            return (direction, *(dash[1:] if dash else (0, 0)))
        controls = self._controls
        button = controls.get(f"turn {left}") or controls.get("turn 1") or controls.get("turn 3")
        if button is None:
            return None
        if self._pressed(button):
            return (direction, 0, 0)
        return button if button[0] else (direction, button[1], button[2])

    def rest(self) -> Move:
        """What to do above the place: wait, or go down where there is something to be done in time."""
        controls = self._controls
        if not self._hurry:
            return self._stay()
        if "hard" in controls and self._ghost.drop_rest <= 1 and not self._pressed(controls["hard"]):
            return controls["hard"]
        return controls.get("soft", _WAIT)

    def _stay(self) -> Move:
        """Wait. On the ground, where the delay is counted anew after a move, go to the side at last, and come back."""
        ghost = self._ghost
        if "LOCK_RESETS" not in self._names or ghost.grounded < self._names["LOCK_DELAY"]:
            return _WAIT
        if self._back:
            back, self._back = self._back, 0
            return (back, 0, 0)
        for there, back, step in ((_LEFT, _RIGHT, -1), (_RIGHT, _LEFT, 1)) if ghost.resets else ():
            column = ghost.column + step
            if ghost._fits(ghost.turn, ghost.row, column) and not ghost._fits(ghost.turn, ghost.row + 1, column):
                self._back = back
                return (there, 0, 0)
        return _WAIT

    def aside(self) -> Move | None:
        """How to put the piece aside, where that can be done, there is time, and no goal waits."""
        move = self._controls.get("hold")
        if move is None or self._missing is not None or self._digs or self._rising:
            return None
        if self._hurry or self._ghost.swapped or self._pressed(move):
            return None
        return move

    def _pressed(self, move: Move) -> bool:
        """Whether a button of a move is still down, so that it would not act."""
        state = self._ghost.__dict__
        return bool((move[1] and state.get("first_down")) or (move[2] and state.get("second_down")))

    def _note(self, ghost: Any) -> None:
        """See how far the goal is, and whether there is a reason to be quick."""
        self._missing = self._goal - ghost.cleared if self._goal else None
        if self._missing is not None:
            needed = _WASTE * self._missing * self._each / self._cells
            self._hurry = ghost.steps + needed * self._fall > self._limit - 1.3 * self._fall
        if self._digs:
            self._garbage = {y for y, row in enumerate(ghost.board) if self._names["GARBAGE"] in row}
        filled = (y for y, row in enumerate(ghost.board) if any(block not in (0, self._wall) for block in row))
        self.room = next(filled, self.rows) - self._top
        late = ghost.steps > self._limit - 1.3 * self._fall - _REST
        if self._missing is None:
            # Rows that rise by the clock are dug away by pieces.
            self._hurry = self._rising or (self._digs and late)
        else:
            self._hurry = self._hurry or late

    # -- boards as rows of bits ------------------------------------------------------------------------------------

    def _bits(self, board: list[list[int]]) -> list[int]:
        return [sum(1 << x for x, block in enumerate(row) if block) for row in board]

    def _mask(self, kind: int, turn: int, column: int) -> tuple[tuple[int, int], ...] | None:
        """The rows of a piece as (row, bits); None where it sticks out at a side."""
        key = (kind, turn, column)
        if key not in self._masks:
            rows: dict[int, int] = {}
            for down, across in self._turns[kind][turn]:
                x = (column + across) % self.columns if self.wrap else column + across
                if not 0 <= x < self.columns:
                    self._masks[key] = None
                    return None
                rows[down] = rows.get(down, 0) | 1 << x
            self._masks[key] = tuple(sorted(rows.items(), reverse=True))
        return self._masks[key]

    def _landing(self, board: list[int], kind: int, turn: int, row: int, column: int) -> int:
        """The row in which a piece comes to lie that falls from `row`."""
        mask, rows = self._mask(kind, turn, column), self.rows
        if mask is None:
            return row
        while True:
            row += 1
            for down, bits in mask:
                y = row + down
                if y >= rows or (y >= 0 and board[y] & bits):
                    return row - 1

    def _rate(self, board: list[int], kind: int, turn: int, row: int, column: int) -> float:
        gain, after = self._laid(board, kind, turn, row, column)
        return gain + self._features(after)

    def _followed(self, board: list[int], kind: int, place: tuple[int, int, int], follower: int) -> float:
        """The best rating after this piece and the next one were laid."""
        gain, after = self._laid(board, kind, *place)
        if self._colours:
            return gain + self._features(after)
        best = 4 * _LOST
        seen = set()
        for turn in range(4):
            for column in range(-2, self.columns):
                mask = self._mask(follower, turn, column)
                if mask is None or (mask in seen) or (self.wrap and column < 0):
                    continue
                seen.add(mask)
                if any(down >= 0 and after[down] & bits for down, bits in mask):
                    continue
                row = self._landing(after, follower, turn, 0, column)
                best = max(best, self._rate(after, follower, turn, row, column))
        return gain + best

    def _laid(self, board: list[int], kind: int, turn: int, row: int, column: int) -> tuple[float, list[int]]:
        """What a landing is worth by itself, and the board that it leaves."""
        mask = self._mask(kind, turn, column)
        assert mask is not None
        after, lost = list(board), False
        for down, bits in mask:
            y = row + down
            lost = lost or y < self._top
            if y >= 0:
                after[y] |= bits
        low, high = row + mask[0][0], row + mask[-1][0]
        height = self.rows - (low + high) / 2
        bonus, eroded = _LOST if lost else 0.0, 0
        if self._colours:
            gained, after = self._coloured(kind, turn, row, column, after)
            return bonus + gained + _BCTS[0] * height, after
        lines = [y for y, line in enumerate(after) if line == self.full]
        cleared = len(lines)
        if lines:
            eroded = cleared * sum(bits.bit_count() for down, bits in mask if row + down in lines)
            bonus += _WON if self._digs and self._garbage <= set(lines) else 0.0
        if lines and self._plain:
            after = [0] * cleared + [line for line in after if line != self.full]
        elif lines or self._crumbles:
            cleared, after = self._settled(after)
        if self._missing is not None and cleared >= self._missing:
            bonus += _WON
        return bonus + _BCTS[0] * height + _BCTS[1] * eroded, after

    def _settled(self, board: list[int]) -> tuple[int, list[int]]:
        """How much the game's own rules clear of a board, and what they leave of it."""
        ghost, walls, wall = self._ghost, self._walls, self._wall
        real = ghost.board
        columns = range(self.columns)
        ghost.board = [
            [wall if fixed >> x & 1 else line >> x & 1 for x in columns]
            for line, fixed in zip(board, walls, strict=True)
        ]
        cleared = self._class._clear(ghost)
        after = self._bits(ghost.board)
        ghost.board = real
        return cleared, after

    def _coloured(self, kind: int, turn: int, row: int, column: int, after: list[int]) -> tuple[float, list[int]]:
        """What a landing is worth for its colour, and the board that it leaves."""
        ghost = self._ghost
        colour = kind % self._colours + 1
        board = [list(line) for line in ghost.board]
        cells = []
        for down, across in self._turns[kind][turn]:
            y, x = row + down, column + across
            x = x % self.columns if self.wrap else x
            if y >= 0:
                board[y][x] = colour
                cells.append((y, x))
        group, waiting, pairs = set(cells), list(cells), 0
        while waiting:
            y, x = waiting.pop()
            for below, beside in ((y + 1, x), (y - 1, x), (y, x + 1), (y, x - 1)):
                beside = beside % self.columns if self.wrap else beside
                if 0 <= below < self.rows and 0 <= beside < self.columns and board[below][beside] == colour:
                    pairs += 1
                    if (below, beside) not in group:
                        group.add((below, beside))
                        waiting.append((below, beside))
        if len(group) < self._group:
            return _PAIR * len(group), after
        real, ghost.board = ghost.board, board
        cleared = self._class._clear(ghost)
        after = self._bits(ghost.board)
        ghost.board = real
        end = _WON if self._missing is not None and cleared >= self._missing else 0.0
        return _PAIR * len(group) + _CLEARED * self._group + end, after

    def _features(self, board: list[int]) -> float:
        """The rating of a board."""
        full, columns = self.full, self.columns
        above = covered = 0
        across = down = holes = wells = depth = holed = 0
        open_wells = [0] * len(board)
        for y, line in enumerate(board):
            if self.wrap:
                left, right = (line << 1 | line >> columns - 1) & full, (line >> 1 | line << columns - 1) & full
                across += (line ^ left).bit_count()
            else:
                left, right = (line << 1 | 1) & full, line >> 1 | 1 << columns - 1
                across += (line ^ left).bit_count() + 1 - (line >> columns - 1)
            down += (line ^ above).bit_count()
            missing = covered & ~line
            if missing:
                holes += missing.bit_count()
                holed += 1
                over, up = missing & above, y - 1
                while over:
                    depth += over.bit_count()
                    up -= 1
                    over &= board[up] if up >= 0 else 0
            covered |= line
            well = left & right & ~covered
            open_wells[y] = well
            up = y
            while well:
                wells += well.bit_count()
                up -= 1
                well &= open_wells[up] if up >= 0 else 0
            above = line
        down += (above ^ full).bit_count()
        values = (across, down, holes, wells, depth, holed)
        return sum((weight * float(value) for weight, value in zip(_BCTS[2:], values, strict=True)), 0.0)
