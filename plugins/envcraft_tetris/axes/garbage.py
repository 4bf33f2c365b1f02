"""Rows of garbage: at the start, and those that rise from below."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

from .board import Board

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

RHYTHMS = ("none", "steps", "pieces", "idle pieces")
HOLES = ("random", "stairs", "stays")


@dataclass(frozen=True)
class Garbage:
    """`start` rows are there from the start; another rises after each `every` of what `rhythm` says."""

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
        return bool(self.start) or self.rhythm != "none"

    def write(self, draft: Draft, variant: Variant) -> None:
        if not self.any:
            return
        told = {"random": "at random", "stairs": "one column further in each row", "stays": "above each other"}[
            self.holes
        ]
        if self.start:
            draft.add("story", f"{self.start} rows of garbage lie there at the start.")
            draft.add("constants", f"START_ROWS = {self.start}")
            draft.add("queue", "for _ in range(START_ROWS):", "    self._rise()")
        self._write_rhythm(draft)
        draft.add("story", f"The holes in garbage lie {told}.")
        self._write_rise(draft, variant)

    def _write_rhythm(self, draft: Draft) -> None:
        if self.rhythm == "none":
            return
        draft.add("constants", f"GARBAGE_EVERY = {self.every}")
        if self.rhythm == "steps":
            draft.add("story", f"Every {self.every} steps a row of garbage rises from below.")
            draft.add(
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
        draft.add("reset", "self.until_garbage = GARBAGE_EVERY")
        if self.rhythm == "pieces":
            draft.add("story", f"After every {self.every} pieces a row of garbage rises from below.")
            draft.add("locked", "self.until_garbage -= 1")
        else:
            draft.add("story", f"After {self.every} pieces that clear nothing a row of garbage rises from below.")
            draft.add("locked", "self.until_garbage = GARBAGE_EVERY if cleared else self.until_garbage - 1")
        draft.add("locked", "if self.until_garbage == 0:", "    self.until_garbage = GARBAGE_EVERY", "    self._rise()")

    def _write_rise(self, draft: Draft, variant: Variant) -> None:
        row = "[GARBAGE] * COLUMNS"
        if variant.clearing.rule == "colour":
            row = "(1 + self.np_random.integers(COLOURS, size=COLUMNS)).tolist()"
        if self.holes == "random":
            draft.add("hole", "row[int(self.np_random.integers(COLUMNS))] = EMPTY")
        else:
            draft.add("board", "self.hole = int(self.np_random.integers(COLUMNS))")
            draft.add("hole", "row[self.hole] = EMPTY")
        if self.holes == "stairs":
            draft.add("hole", "self.hole = (self.hole + 1) % COLUMNS")
        draft.add(
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
