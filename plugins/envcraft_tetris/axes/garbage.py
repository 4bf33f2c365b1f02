"""Rows of garbage at the start, and rows that rise from below."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.clearing import Clearing

RHYTHMS = ("none", "steps", "pieces", "idle pieces")
HOLES = ("random", "stairs", "stays")


@dataclass(frozen=True)
class Garbage:
    """`start` rows of garbage at the start, and another row after every `every` units of `rhythm`."""

    rhythm: str
    start: int = 0
    every: int = 0
    holes: str = "random"

    @classmethod
    def draw(cls, rng: Random, board: Board) -> Garbage:
        if board.walls:
            return cls("none")
        rhythm = rng.choices(RHYTHMS, (5, 2, 2, 2))[0]
        start = rng.choices((0, 2, 3, 4), (5, 1, 3, 2))[0]
        every = {
            "none": 0,
            "steps": 5 * rng.randint(6, 16),
            "pieces": rng.randint(4, 9),
            "idle pieces": rng.randint(3, 7),
        }
        any_rows = start or rhythm != "none"
        return cls(rhythm, start, every[rhythm], rng.choice(HOLES) if any_rows else "random")

    @property
    def any(self) -> bool:
        """Whether there is garbage at all."""
        return bool(self.start) or self.rhythm != "none"

    def write(self, code: SourceBuilder, clearing: Clearing) -> None:
        if not self.any:
            return
        words = {"random": "at random", "stairs": "one column further in each row", "stays": "above each other"}[
            self.holes
        ]
        if self.start:
            code.add("story", f"{self.start} rows of garbage lie there at the start.")
            code.add("constants", f"START_ROWS = {self.start}")
            code.add("queue", "for _ in range(START_ROWS):", "    self._rise()")
        self._write_rhythm(code)
        code.add("story", f"The holes in garbage lie {words}.")
        self._write_rise(code, clearing)

    def _write_rhythm(self, code: SourceBuilder) -> None:
        if self.rhythm == "none":
            return
        code.add("constants", f"GARBAGE_EVERY = {self.every}")
        if self.rhythm == "steps":
            code.add("story", f"Every {self.every} steps a row of garbage rises from below.")
            code.add(
                "tick",
                """
                if self.steps % GARBAGE_EVERY == 0 and not <<over>>:
                    self._rise()
                    # The board has moved up by a row; so a piece that does not fit any more rides on it.
                    if not self._fits(self.turn, self.row, self.column):
                        self.row -= 1
                    self._paint()
                """,
            )
            return
        code.add("reset", "self.until_garbage = GARBAGE_EVERY")
        if self.rhythm == "pieces":
            code.add("story", f"After every {self.every} pieces a row of garbage rises from below.")
            code.add("locked", "self.until_garbage -= 1")
        else:
            code.add("story", f"After {self.every} pieces that clear nothing a row of garbage rises from below.")
            code.add("locked", "self.until_garbage = GARBAGE_EVERY if cleared else self.until_garbage - 1")
        code.add("locked", "if self.until_garbage == 0:", "    self.until_garbage = GARBAGE_EVERY", "    self._rise()")

    def _write_rise(self, code: SourceBuilder, clearing: Clearing) -> None:
        row = "[GARBAGE] * COLUMNS"
        if clearing.rule == "colour":
            row = "(1 + self.np_random.integers(COLOURS, size=COLUMNS)).tolist()"
        if self.holes == "random":
            code.add("hole", "row[int(self.np_random.integers(COLUMNS))] = EMPTY")
        else:
            code.add("board", "self.hole = int(self.np_random.integers(COLUMNS))")
            code.add("hole", "row[self.hole] = EMPTY")
        if self.holes == "stairs":
            code.add("hole", "self.hole = (self.hole + 1) % COLUMNS")
        code.add(
            "methods",
            f"""
            def _rise(self) -> None:
                \"\"\"Push a row of garbage in from below; what leaves the board at the top loses the game.\"\"\"
                if any(self.board[0]):
                    self.lost = True
                row = {row}
                <<hole>>
                self.board = [*self.board[1:], row]
            """,
        )
