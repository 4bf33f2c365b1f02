"""How a game ends, and when it is won."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.clearing import Clearing
from envcraft_tetris.axes.entry import Entry
from envcraft_tetris.axes.garbage import Garbage
from envcraft_tetris.axes.gravity import Gravity
from envcraft_tetris.axes.pieces import Pieces
from envcraft_tetris.episode_length import idle_steps

GOALS = ("endless", "lines", "clock", "survive", "dig")
#: Survival must last longer than an episode without input by this factor, and at most this many steps.
_LONGER, _LONGEST = 1.6, 950


@dataclass(frozen=True)
class Ending:
    """The goal: `count` lines or groups to clear within `steps`. Blocks above the row `ceiling` lose the game."""

    goal: str
    count: int = 0
    steps: int = 0
    ceiling: int = 0

    @classmethod
    def draw(
        cls,
        rng: Random,
        pieces: Pieces,
        board: Board,
        entry: Entry,
        gravity: Gravity,
        clearing: Clearing,
        garbage: Garbage,
    ) -> Ending:
        goal = rng.choices(GOALS, (4, 4, 3, 3, 3))[0]
        ceiling = rng.choices((0, 2, 3), (4, 1, 1))[0] if board.rows >= 14 else 0
        # With holes above each other, one straight piece clears all garbage.
        diggable = garbage.start >= 3 and garbage.rhythm == "none" and garbage.holes != "stays" and not clearing.easy
        if goal == "dig" and not diggable:
            goal = "lines"
        if clearing.easy and goal != "lines":
            # If random play clears lines, neither survival nor a few cleared lines show skill.
            goal = "clock"
        count, steps = rng.randint(3, 9), 50 * rng.randint(6, 16)
        if clearing.easy:
            count = rng.randint(16, 24)
        elif board.columns <= 7:
            count += 4
        if goal == "survive":
            least = _LONGER * idle_steps(pieces, board, entry, gravity, garbage) + 100
            if least > _LONGEST:
                goal = "clock"
            else:
                return cls(goal, 0, 50 * round(rng.uniform(max(400, least), _LONGEST) / 50), ceiling)
        if goal == "lines":
            return cls(goal, count, 0, ceiling)
        if goal == "clock":
            return cls(goal, count, steps, ceiling)
        return cls(goal, 0, 0, ceiling)

    @property
    def wins(self) -> bool:
        """Whether the game can be won."""
        return self.goal != "endless"

    def write(self, code: SourceBuilder, clearing: Clearing) -> None:
        code.add("flags", "self.won = self.lost = False" if self.wins else "self.lost = False")
        code.add("over", "(self.won or self.lost)" if self.wins else "self.lost")
        code.add("ended", "self.won or self.lost" if self.wins else "self.lost")
        units = clearing.units
        code.add(
            "info",
            *(['"is_success": self.won'] if self.wins else []),
            f'"{units}": self.cleared',
            '"steps": self.steps',
        )
        words = "is left above the dashed line" if self.ceiling else "sticks out at the top"
        code.add("story", f"The game is lost when a piece {words} or the next finds no room.")
        code.add("put", f"if y < {'CEILING' if self.ceiling else '0'}:", "    self.lost = True")
        code.add("put", "if y >= 0:" if self.ceiling else "else:", "    self.board[y][x] = <<colour>>")
        if self.ceiling:
            code.add("constants", f"CEILING = {self.ceiling}")
            code.add("paint", "picture[TOP + CELL * CEILING, LEFT:RIGHT:2] = PALETTE[BAR]")
        {"endless": self._endless, "lines": self._lines, "clock": self._clock, "survive": self._survive}.get(
            self.goal, self._dig
        )(code, units)

    def _endless(self, code: SourceBuilder, units: str) -> None:
        code.add("aim", f"Clear as many {units} as you can, and keep playing.")

    def _lines(self, code: SourceBuilder, units: str) -> None:
        code.add("aim", f"Clear {self.count} {units}; the bar at the top shows how many there are.")
        self._count(code)

    def _clock(self, code: SourceBuilder, units: str) -> None:
        code.add("aim", f"Clear {self.count} {units} within {self.steps} steps; when the time is up the game is lost.")
        code.add("aim", "The bar at the top shows what is cleared, the one at the bottom the time.")
        self._count(code)
        code.add("constants", f"TIME = {self.steps}")
        code.add("tick", "if self.steps >= TIME and not self.won:", "    self.lost = True")
        self._show_time(code)

    def _survive(self, code: SourceBuilder, units: str) -> None:
        code.add("aim", f"Keep playing for {self.steps} steps; the bar at the bottom shows how many are over.")
        code.add("constants", f"TIME = {self.steps}")
        code.add("tick", "if self.steps >= TIME and not self.lost:", "    self.won = True")
        self._show_time(code)

    def _dig(self, code: SourceBuilder, units: str) -> None:
        code.add("aim", "Clear all the garbage that lies there at the start.")
        code.add("goal", "if not self.lost and not any(GARBAGE in row for row in self.board):", "    self.won = True")

    def _count(self, code: SourceBuilder) -> None:
        code.add("constants", f"GOAL = {self.count}")
        code.add("goal", "if not self.lost and self.cleared >= GOAL:", "    self.won = True")
        code.add("paint", "picture[1:3, 2:82] = PALETTE[RIM]")
        code.add("paint", "picture[1:3, 2 : 2 + 80 * min(self.cleared, GOAL) // GOAL] = PALETTE[BAR]")

    def _show_time(self, code: SourceBuilder) -> None:
        code.add("frame", "frame[82, 2 : 2 + 80 * min(self.steps, TIME) // TIME] = PALETTE[BAR]")
