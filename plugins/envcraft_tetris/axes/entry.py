"""The column in which pieces enter."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.controls import Controls

PLACES = ("middle", "left", "right", "random", "sweep", "opposite")


@dataclass(frozen=True)
class Entry:
    """The `place` of entry. A sweep moves by `step` columns for each piece."""

    place: str
    step: int = 0

    @classmethod
    def draw(cls, rng: Random) -> Entry:
        place = rng.choices(PLACES, (5, 1, 1, 3, 2, 2))[0]
        return cls(place, rng.randint(1, 3) if place == "sweep" else 0)

    def write(self, code: SourceBuilder, controls: Controls) -> None:
        width = "COLUMNS - len(PIECES[self.kind])"
        words, place = {
            "middle": ("in the middle", f"({width}) // 2"),
            "left": ("at the left side", "0"),
            "right": ("at the right side", width),
            "random": ("at a random column", f"int(self.np_random.integers({width} + 1))"),
            "sweep": (f"further to the right each time, by {self.step}", f"self.entry % ({width} + 1)"),
            "opposite": (
                "at one side and at the other in turn",
                f"0 if self.from_left else {width}",
            ),
        }[self.place]
        code.add("story", f"They come in {words}.")
        code.add("column", place)
        if self.place == "sweep":
            code.add("constants", f"ENTRY_STEP = {self.step}")
            code.add("reset", "self.entry = int(self.np_random.integers(COLUMNS))")
            code.add("entered", "self.entry += ENTRY_STEP")
        elif self.place == "opposite":
            code.add("reset", "self.from_left = bool(self.np_random.integers(2))")
            code.add("entered", "self.from_left = not self.from_left")
        again = controls.holds
        argument, kind = (
            (", kind: int | None = None", "<<next>> if kind is None else kind") if again else ("", "<<next>>")
        )
        code.add(
            "methods",
            f"""
            def _enter(self{argument}) -> None:
                \"\"\"Let a piece in; where there is no room for it the game is lost.\"\"\"
                self.kind = {kind}
                self.turn = self.row = 0
                self.column = <<column>>
                <<entered>>
                if not self._fits(self.turn, self.row, self.column):
                    self.lost = True
            """,
        )
