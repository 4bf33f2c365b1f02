"""What is paid for."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

from .ending import Ending

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

CLEARS = ("linear", "bonus", "combo", "sparse")
EXTRAS = ("none", "piece", "holes", "height", "step")


@dataclass(frozen=True)
class Rewards:
    """Of one line `line`, of the goal `prize`, of losing minus `death`; `extra` shapes the way there."""

    clears: str
    extra: str
    line: float
    prize: float
    death: float

    @classmethod
    def draw(cls, rng: Random, ending: Ending) -> Rewards:
        line = rng.choice((0.5, 1.0, 1.0, 2.0))
        prize = rng.choice((2.0, 5.0, 10.0))
        if not ending.wins:
            # Where nothing but the return tells success, staying alive for a while must not be one.
            return cls(
                rng.choice(CLEARS[:3]), rng.choice(("none", "holes", "height")), line, 0.0, rng.choice((2.0, 3.0, 5.0))
            )
        return cls(rng.choice(CLEARS), rng.choice(EXTRAS), line, prize, rng.choice((0.0, 1.0, 2.0)))

    @property
    def bonus(self) -> tuple[float, ...]:
        """What so many lines at once are worth under `bonus`, from none to four."""
        return tuple(self.line * times for times in (0, 1, 2.5, 5, 8))

    def write(self, draft: Draft, variant: Variant) -> None:
        self._write_clears(draft, variant.clearing.units.removesuffix("s"))
        self._write_extra(draft)
        if self.prize:
            draft.add("paid", f"+{self.prize:g} for the goal")
            draft.add("constants", f"PRIZE = {self.prize}")
            draft.add("settle", "if self.won:", "    self.reward += PRIZE")
        if self.death:
            draft.add("paid", f"-{self.death:g} when the game is lost")
            draft.add("constants", f"DEATH = {self.death}")
            draft.add("settle", "if self.lost:", "    self.reward -= DEATH")

    def _write_clears(self, draft: Draft, unit: str) -> None:
        if self.clears == "linear":
            draft.add("paid", f"+{self.line:g} for each {unit}")
            draft.add("constants", f"LINE_REWARD = {self.line}")
            draft.add("pay", "self.reward += LINE_REWARD * cleared")
        elif self.clears == "bonus":
            told = ", ".join(f"{step:g}" for step in self.bonus[1:])
            draft.add("paid", f"{told} for one {unit}, two, three, and four or more at once")
            draft.add("constants", f"LINE_REWARDS = {self.bonus}")
            draft.add("pay", "self.reward += LINE_REWARDS[min(cleared, 4)]")
        elif self.clears == "combo":
            draft.add(
                "paid", f"+{self.line:g} for each {unit}, times the pieces in a row that cleared one (at most five)"
            )
            draft.add("constants", f"LINE_REWARD = {self.line}", "LONGEST_COMBO = 4")
            draft.add("reset", "self.combo = 0")
            draft.add("pay", "self.reward += LINE_REWARD * cleared * (1 + self.combo)")
            draft.add("pay", "self.combo = min(self.combo + 1, LONGEST_COMBO) if cleared else 0")

    def _write_extra(self, draft: Draft) -> None:
        if self.extra == "piece":
            draft.add("paid", "+0.1 for each piece that stays")
            draft.add("constants", "PIECE_REWARD = 0.1")
            draft.add("pay", "self.reward += PIECE_REWARD")
        elif self.extra == "step":
            draft.add("paid", "+0.01 for each step")
            draft.add("constants", "STEP_REWARD = 0.01")
            draft.add("tick", "self.reward += STEP_REWARD")
        elif self.extra == "holes":
            draft.add("paid", "-0.1 for each empty cell that gets covered, and +0.1 for each that is freed")
            draft.add("constants", "HOLE_REWARD = -0.1")
            draft.add("started", "self.holes = self._count_holes()")
            draft.add("pay", "holes = self._count_holes()", "self.reward += HOLE_REWARD * (holes - self.holes)")
            draft.add("pay", "self.holes = holes")
            draft.add(
                "methods",
                """
                def _count_holes(self) -> int:
                    \"\"\"Empty cells with a block anywhere above them.\"\"\"
                    return sum(
                        sum(block == EMPTY for block in column[next((y for y, b in enumerate(column) if b), ROWS) :])
                        for column in zip(*self.board, strict=True)
                    )
                """,
            )
        elif self.extra == "height":
            draft.add("paid", "-0.1 for each row by which the stack grows, and +0.1 for each by which it shrinks")
            draft.add("constants", "HEIGHT_REWARD = -0.1")
            draft.add("started", "self.height = self._stack_height()")
            draft.add("pay", "height = self._stack_height()", "self.reward += HEIGHT_REWARD * (height - self.height)")
            draft.add("pay", "self.height = height")
            draft.add(
                "methods",
                """
                def _stack_height(self) -> int:
                    return ROWS - next((y for y, row in enumerate(self.board) if any(row)), ROWS)
                """,
            )
