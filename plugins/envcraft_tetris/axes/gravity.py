"""How fast pieces fall, and how that changes."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

from .board import Board

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

SCHEDULES = ("constant", "levels", "ramp", "pieces", "pulse")


@dataclass(frozen=True)
class Gravity:
    """A row every `slow` steps at first, every `fast` at last, and another step sooner after every `every`."""

    schedule: str
    slow: int
    fast: int
    every: int = 0

    @classmethod
    def draw(cls, rng: Random, board: Board) -> Gravity:
        slowest = 6 if board.rows <= 12 else 5 if board.rows <= 15 else 4
        # Before a board is full that is as low as they come, a piece that falls at every step leaves too little time.
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

    def write(self, draft: Draft, variant: Variant) -> None:
        if self.schedule == "constant":
            pace = "at every step" if self.slow == 1 else f"every {self.slow} steps"
            draft.add("story", f"A piece falls one row {pace}.")
            draft.add("constants", f"FALL_EVERY = {self.slow}")
            draft.add("period", "FALL_EVERY")
            return
        draft.add("constants", f"SLOW, FAST = {self.slow}, {self.fast}")
        fast = "at every step" if self.fast == 1 else f"every {self.fast}"
        if self.schedule == "pulse":
            draft.add("story", f"A piece falls one row every {self.slow} steps, then {fast}, in turns of {self.every}.")
            draft.add("constants", f"PULSE = {self.every}")
            draft.add("period", "FAST if self.steps // PULSE % 2 else SLOW")
            return
        unit = {"levels": variant.clearing.units, "ramp": "steps", "pieces": "pieces"}[self.schedule]
        often = f"{self.every} {unit}" if self.every > 1 else unit.removesuffix("s")
        draft.add(
            "story",
            f"A piece falls one row every {self.slow} steps, a step sooner after every {often}, at last {fast}.",
        )
        draft.add("constants", f"LEVEL = {self.every}")
        counted = {"levels": "self.cleared", "ramp": "self.steps", "pieces": "self.pieces"}[self.schedule]
        draft.add("period", f"max(FAST, SLOW - {counted} // LEVEL)")
        if self.schedule == "pieces":
            draft.add("reset", "self.pieces = 0")
            draft.add("entered", "self.pieces += 1")
