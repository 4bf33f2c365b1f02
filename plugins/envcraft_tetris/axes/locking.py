"""When a piece that lies on something becomes part of the board."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

KINDS = ("instant", "delay", "row", "moves")


@dataclass(frozen=True)
class Locking:
    """`delay` in steps on the ground; counted anew after each row that the piece falls, or after so many moves."""

    kind: str
    delay: int = 0
    resets: int = 0

    @classmethod
    def draw(cls, rng: Random) -> Locking:
        kind = rng.choices(KINDS, (3, 2, 2, 2))[0]
        if kind == "instant":
            return cls(kind)
        return cls(kind, rng.randint(1, 5), rng.randint(2, 5) if kind == "moves" else 0)

    def write(self, draft: Draft, variant: Variant) -> None:
        draft.add("entered", "self.timer = <<period>>")
        if self.kind == "instant":
            draft.add("story", "Where it can fall no further it stays.")
            draft.add(
                "methods",
                """
                def _fall(self) -> None:
                    self.timer -= 1
                    if self.timer > 0:
                        return
                    self.timer = <<period>>
                    if not self._move(self.turn, self.row + 1, self.column):
                        self._lock()
                """,
            )
            return
        anew = {
            "delay": "",
            "row": ", counted anew when it falls further",
            "moves": f", counted anew after each of its next {self.resets} moves",
        }[self.kind]
        steps = "a step" if self.delay == 1 else f"{self.delay} steps"
        draft.add("story", f"On the ground it can still be moved for {steps}{anew}.")
        draft.add("constants", f"LOCK_DELAY = {self.delay}")
        draft.add("entered", "self.grounded = 0")
        if self.kind == "row":
            draft.add("fallen", "self.grounded = 0")
        elif self.kind == "moves":
            draft.add("constants", f"LOCK_RESETS = {self.resets}")
            draft.add("entered", "self.resets = LOCK_RESETS")
            draft.add("moved", "if self.grounded and self.resets:", "    self.resets -= 1", "    self.grounded = 0")
        draft.add(
            "methods",
            """
            def _fall(self) -> None:
                if not self._fits(self.turn, self.row + 1, self.column):
                    self.grounded += 1
                    if self.grounded > LOCK_DELAY:
                        self._lock()
                    return
                self.timer -= 1
                if self.timer <= 0:
                    self.timer = <<period>>
                    self.row += 1
                    <<fallen>>
            """,
        )
