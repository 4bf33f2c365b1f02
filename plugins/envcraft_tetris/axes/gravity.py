"""The speed of falling pieces and its schedule."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.clearing import Clearing

SCHEDULES = ("constant", "levels", "ramp", "pieces", "pulse")


@dataclass(frozen=True)
class Gravity:
    """A piece falls one row every `slow` steps at first, and every `fast` at last; the period changes after `every`."""

    schedule: str
    slow: int
    fast: int
    every: int = 0

    @classmethod
    def draw(cls, rng: Random, board: Board) -> Gravity:
        slowest = 6 if board.rows <= 12 else 5 if board.rows <= 15 else 4
        # On a low board, pieces that fall at every step leave too little time to play.
        quickest = 1 if board.rows >= 14 else 2
        schedule = rng.choice(SCHEDULES)
        slow = rng.randint(quickest, slowest)
        if schedule == "constant":
            return cls(schedule, slow, slow)
        slow = max(slow, quickest + 1)
        fast = rng.randint(quickest, slow - 1)
        if schedule == "levels":
            return cls(schedule, slow, fast, rng.randint(1, 4))
        if schedule == "ramp":
            return cls(schedule, slow, fast, 20 * rng.randint(2, 8))
        if schedule == "pieces":
            return cls(schedule, slow, fast, rng.randint(3, 10))
        return cls(schedule, slow, fast, 10 * rng.randint(2, 6))

    def write(self, code: SourceBuilder, clearing: Clearing) -> None:
        if self.schedule == "constant":
            pace = "at every step" if self.slow == 1 else f"every {self.slow} steps"
            code.add("story", f"A piece falls one row {pace}.")
            code.add("constants", f"FALL_EVERY = {self.slow}")
            code.add("period", "FALL_EVERY")
            return
        code.add("constants", f"SLOW, FAST = {self.slow}, {self.fast}")
        fast = "at every step" if self.fast == 1 else f"every {self.fast}"
        if self.schedule == "pulse":
            code.add("story", f"A piece falls one row every {self.slow} steps, then {fast}, in turns of {self.every}.")
            code.add("constants", f"PULSE = {self.every}")
            code.add("period", "FAST if self.steps // PULSE % 2 else SLOW")
            return
        unit = {"levels": clearing.units, "ramp": "steps", "pieces": "pieces"}[self.schedule]
        often = f"{self.every} {unit}" if self.every > 1 else unit.removesuffix("s")
        code.add(
            "story",
            f"A piece falls one row every {self.slow} steps, a step sooner after every {often}, at last {fast}.",
        )
        code.add("constants", f"LEVEL = {self.every}")
        counted = {"levels": "self.cleared", "ramp": "self.steps", "pieces": "self.pieces"}[self.schedule]
        code.add("period", f"max(FAST, SLOW - {counted} // LEVEL)")
        if self.schedule == "pieces":
            code.add("reset", "self.pieces = 0")
            code.add("entered", "self.pieces += 1")
