"""The rewards."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.clearing import Clearing
from envcraft_tetris.axes.ending import Ending

CLEARS = ("linear", "bonus", "combo", "sparse")
EXTRAS = ("none", "piece", "holes", "height", "step")


@dataclass(frozen=True)
class Rewards:
    """Rewards: `line` for a line, `prize` for the goal, minus `death` for a loss, and the shaping term `extra`."""

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
            # Success is the sign of the return here, so mere survival must not make it positive.
            return cls(
                rng.choice(CLEARS[:3]), rng.choice(("none", "holes", "height")), line, 0.0, rng.choice((2.0, 3.0, 5.0))
            )
        return cls(rng.choice(CLEARS), rng.choice(EXTRAS), line, prize, rng.choice((0.0, 1.0, 2.0)))

    @property
    def bonus(self) -> tuple[float, ...]:
        """The rewards of zero to four lines at once under `bonus`."""
        return tuple(self.line * times for times in (0, 1, 2.5, 5, 8))

    def write(self, code: SourceBuilder, clearing: Clearing) -> None:
        self._write_clears(code, clearing.units.removesuffix("s"))
        self._write_extra(code)
        if self.prize:
            code.add("paid", f"+{self.prize:g} for the goal")
            code.add("constants", f"PRIZE = {self.prize}")
            code.add("settle", "if self.won:", "    self.reward += PRIZE")
        if self.death:
            code.add("paid", f"-{self.death:g} when the game is lost")
            code.add("constants", f"DEATH = {self.death}")
            code.add("settle", "if self.lost:", "    self.reward -= DEATH")

    def _write_clears(self, code: SourceBuilder, unit: str) -> None:
        if self.clears == "linear":
            code.add("paid", f"+{self.line:g} for each {unit}")
            code.add("constants", f"LINE_REWARD = {self.line}")
            code.add("pay", "self.reward += LINE_REWARD * cleared")
        elif self.clears == "bonus":
            words = ", ".join(f"{step:g}" for step in self.bonus[1:])
            code.add("paid", f"{words} for one {unit}, two, three, and four or more at once")
            code.add("constants", f"LINE_REWARDS = {self.bonus}")
            code.add("pay", "self.reward += LINE_REWARDS[min(cleared, 4)]")
        elif self.clears == "combo":
            code.add(
                "paid", f"+{self.line:g} for each {unit}, times the pieces in a row that cleared one (at most five)"
            )
            code.add("constants", f"LINE_REWARD = {self.line}", "LONGEST_COMBO = 4")
            code.add("reset", "self.combo = 0")
            code.add("pay", "self.reward += LINE_REWARD * cleared * (1 + self.combo)")
            code.add("pay", "self.combo = min(self.combo + 1, LONGEST_COMBO) if cleared else 0")

    def _write_extra(self, code: SourceBuilder) -> None:
        if self.extra == "piece":
            code.add("paid", "+0.1 for each piece that stays")
            code.add("constants", "PIECE_REWARD = 0.1")
            code.add("pay", "self.reward += PIECE_REWARD")
        elif self.extra == "step":
            code.add("paid", "+0.01 for each step")
            code.add("constants", "STEP_REWARD = 0.01")
            code.add("tick", "self.reward += STEP_REWARD")
        elif self.extra == "holes":
            code.add("paid", "-0.1 for each empty cell that gets covered, and +0.1 for each that is freed")
            code.add("constants", "HOLE_REWARD = -0.1")
            code.add("started", "self.holes = self._count_holes()")
            code.add("pay", "holes = self._count_holes()", "self.reward += HOLE_REWARD * (holes - self.holes)")
            code.add("pay", "self.holes = holes")
            code.add(
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
            code.add("paid", "-0.1 for each row by which the stack grows, and +0.1 for each by which it shrinks")
            code.add("constants", "HEIGHT_REWARD = -0.1")
            code.add("started", "self.height = self._stack_height()")
            code.add("pay", "height = self._stack_height()", "self.reward += HEIGHT_REWARD * (height - self.height)")
            code.add("pay", "self.height = height")
            code.add(
                "methods",
                """
                def _stack_height(self) -> int:
                    return ROWS - next((y for y, row in enumerate(self.board) if any(row)), ROWS)
                """,
            )
