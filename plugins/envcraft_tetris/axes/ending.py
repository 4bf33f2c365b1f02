"""What ends a game, and whether it is won."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft
from envcraft_tetris.pace import idle_steps

from .board import Board
from .clearing import Clearing
from .entry import Entry
from .garbage import Garbage
from .gravity import Gravity
from .pieces import Pieces

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

GOALS = ("endless", "lines", "clock", "survive", "dig")
#: Survival has to last longer than doing nothing does, by so much, and less than the limit of 1,000 steps.
_LONGER, _LONGEST = 1.6, 950


@dataclass(frozen=True)
class Ending:
    """`count` is of lines or groups to clear, `steps` the time; blocks left above the row `ceiling` lose the game."""

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
        # One straight piece can fill holes above each other.
        diggable = garbage.start >= 3 and garbage.rhythm == "none" and garbage.holes != "stays" and not clearing.easy
        if goal == "dig" and not diggable:
            goal = "lines"
        if clearing.easy and goal != "lines":
            # Where anyone clears something, neither lasting nor clearing something is an achievement.
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
        return self.goal != "endless"

    def write(self, draft: Draft, variant: Variant) -> None:
        draft.add("flags", "self.won = self.lost = False" if self.wins else "self.lost = False")
        draft.add("over", "(self.won or self.lost)" if self.wins else "self.lost")
        draft.add("ended", "self.won or self.lost" if self.wins else "self.lost")
        units = variant.clearing.units
        draft.add(
            "info",
            *(['"is_success": self.won'] if self.wins else []),
            f'"{units}": self.cleared',
            '"steps": self.steps',
        )
        told = "is left above the dashed line" if self.ceiling else "sticks out at the top"
        draft.add("story", f"The game is lost when a piece {told} or the next finds no room.")
        draft.add("put", f"if y < {'CEILING' if self.ceiling else '0'}:", "    self.lost = True")
        draft.add("put", "if y >= 0:" if self.ceiling else "else:", "    self.board[y][x] = <<colour>>")
        if self.ceiling:
            draft.add("constants", f"CEILING = {self.ceiling}")
            draft.add("paint", "picture[TOP + CELL * CEILING, LEFT:RIGHT:2] = PALETTE[BAR]")
        {"endless": self._endless, "lines": self._lines, "clock": self._clock, "survive": self._survive}.get(
            self.goal, self._dig
        )(draft, units)

    def _endless(self, draft: Draft, units: str) -> None:
        draft.add("aim", f"Clear as many {units} as you can, and keep playing.")

    def _lines(self, draft: Draft, units: str) -> None:
        draft.add("aim", f"Clear {self.count} {units}; the bar at the top shows how many there are.")
        self._count(draft)

    def _clock(self, draft: Draft, units: str) -> None:
        draft.add("aim", f"Clear {self.count} {units} within {self.steps} steps; when the time is up the game is lost.")
        draft.add("aim", "The bar at the top shows what is cleared, the one at the bottom the time.")
        self._count(draft)
        draft.add("constants", f"TIME = {self.steps}")
        draft.add("tick", "if self.steps >= TIME and not self.won:", "    self.lost = True")
        self._show_time(draft)

    def _survive(self, draft: Draft, units: str) -> None:
        draft.add("aim", f"Keep playing for {self.steps} steps; the bar at the bottom shows how many are over.")
        draft.add("constants", f"TIME = {self.steps}")
        draft.add("tick", "if self.steps >= TIME and not self.lost:", "    self.won = True")
        self._show_time(draft)

    def _dig(self, draft: Draft, units: str) -> None:
        draft.add("aim", "Clear all the garbage that lies there at the start.")
        draft.add("goal", "if not self.lost and not any(GARBAGE in row for row in self.board):", "    self.won = True")

    def _count(self, draft: Draft) -> None:
        draft.add("constants", f"GOAL = {self.count}")
        draft.add("goal", "if not self.lost and self.cleared >= GOAL:", "    self.won = True")
        draft.add("paint", "picture[1:3, 2:82] = PALETTE[RIM]")
        draft.add("paint", "picture[1:3, 2 : 2 + 80 * min(self.cleared, GOAL) // GOAL] = PALETTE[BAR]")

    def _show_time(self, draft: Draft) -> None:
        draft.add("frame", "frame[82, 2 : 2 + 80 * min(self.steps, TIME) // TIME] = PALETTE[BAR]")
