"""When a piece that has landed becomes part of the board."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder

KINDS = ("instant", "delay", "row", "moves")


@dataclass(frozen=True)
class Locking:
    """A `delay` in steps on the ground, restarted when the piece falls further or by up to `resets` moves."""

    kind: str
    delay: int = 0
    resets: int = 0

    @classmethod
    def draw(cls, rng: Random) -> Locking:
        kind = rng.choices(KINDS, (3, 2, 2, 2))[0]
        if kind == "instant":
            return cls(kind)
        return cls(kind, rng.randint(1, 5), rng.randint(2, 5) if kind == "moves" else 0)

    def write(self, code: SourceBuilder) -> None:
        code.add("entered", "self.timer = <<period>>")
        if self.kind == "instant":
            code.add("story", "Where it can fall no further it stays.")
            code.add(
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
        code.add("story", f"On the ground it can still be moved for {steps}{anew}.")
        code.add("constants", f"LOCK_DELAY = {self.delay}")
        code.add("entered", "self.grounded = 0")
        if self.kind == "row":
            code.add("fallen", "self.grounded = 0")
        elif self.kind == "moves":
            code.add("constants", f"LOCK_RESETS = {self.resets}")
            code.add("entered", "self.resets = LOCK_RESETS")
            code.add("moved", "if self.grounded and self.resets:", "    self.resets -= 1", "    self.grounded = 0")
        code.add(
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
