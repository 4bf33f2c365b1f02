"""What up, down and the two buttons do."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

#: What a control can do: how the docstring tells it, and the statement; `drop` is acted on when all else is done.
FUNCTIONS = {
    "cw": ("turns the piece clockwise", "self._rotate(1)"),
    "ccw": ("turns the piece anticlockwise", "self._rotate(3)"),
    "flip": ("turns the piece upside down", "self._rotate(2)"),
    "soft": ("lets the piece fall a row faster", "self._move(self.turn, self.row + 1, self.column)"),
    "hard": ("drops the piece to the ground", "drop = True"),
    "hold": ("puts the piece aside for later, once for each piece", "self._hold()"),
    "dash": ("takes the piece further in the direction of the move", "self._dash(direction)"),
}
TURNING = ("cw", "ccw", "flip")
#: What the two buttons do, in either order, and how often that comes.
BUTTONS = {
    ("cw", "ccw"): 5,
    ("cw", "hard"): 3,
    ("ccw", "hard"): 2,
    ("cw", "hold"): 3,
    ("ccw", "hold"): 2,
    ("cw", "soft"): 2,
    ("ccw", "soft"): 2,
    ("cw", "flip"): 2,
    ("cw", "dash"): 2,
    ("ccw", "dash"): 2,
    ("hard", "hold"): 2,
    ("soft", "hold"): 2,
    ("soft", "hard"): 1,
    ("dash", "hold"): 1,
    ("dash", "hard"): 1,
}
#: Whether a button that stays pressed acts at every step, or once.
PRESSES = ("every step", "once")


@dataclass(frozen=True)
class Controls:
    """The function of each, of :data:`FUNCTIONS`; empty where there is none.

    One drop can follow another after `rest` steps: a button pressed half of the time would else end a game
    within a dozen steps, and playing longer would mean little but leaving it alone.
    """

    up: str
    down: str
    first: str
    second: str
    press: str
    rest: int = 0

    @classmethod
    def draw(cls, rng: Random) -> Controls:
        first, second = rng.choices(tuple(BUTTONS), tuple(BUTTONS.values()))[0]
        if rng.random() < 0.5:
            first, second = second, first
        buttons = (first, second)
        if not set(buttons) & set(TURNING):
            up = rng.choice(("cw", "ccw"))
        else:
            free = [name for name in ("cw", "ccw", "hold") if name not in buttons]
            up = rng.choice(("", "", *free))
        down = "" if "soft" in buttons else rng.choices(("soft", ""), (5, 1))[0]
        if "hard" not in buttons and rng.random() < 0.12:
            down = "hard"
        press = rng.choice(PRESSES)
        rest = rng.randint(3, 12) if "hard" in (first, second) else rng.randint(1, 6) if down == "hard" else 0
        return cls(up, down, first, second, press, rest)

    @property
    def all(self) -> tuple[str, ...]:
        return self.up, self.down, self.first, self.second

    @property
    def holds(self) -> bool:
        return "hold" in self.all

    @property
    def drop(self) -> str:
        """Which kind of control drops a piece at once: "button", "down" or "none"."""
        return "button" if "hard" in (self.first, self.second) else "down" if self.down == "hard" else "none"

    def write(self, draft: Draft, variant: Variant) -> None:
        if self.drop != "none":
            draft.add("constants", f"DROP_REST = {self.rest}")
            draft.add("reset", "self.drop_rest = 0")
            draft.add("press", "drop = False", "self.drop_rest = max(0, self.drop_rest - 1)")
        self._write_buttons(draft)
        self._write_moves(draft)
        if self.holds:
            self._write_hold(draft)
        if "dash" in self.all:
            self._write_dash(draft)
        if self.drop == "none":
            draft.add("fall", "self._fall()")
            return
        draft.add("fall", "if drop and self.drop_rest == 0:", "    self._drop()", "else:", "    self._fall()")
        draft.add(
            "methods",
            """
            def _drop(self) -> None:
                while self._move(self.turn, self.row + 1, self.column):
                    pass
                self.drop_rest = DROP_REST
                self._lock()
            """,
        )

    def _write_moves(self, draft: Draft) -> None:
        words = ["left and right move the piece."]
        branches = [(3, "self._move(self.turn, self.row, self.column - 1)")]
        branches.append((4, "self._move(self.turn, self.row, self.column + 1)"))
        for number, name, function in ((1, "Up", self.up), (2, "Down", self.down)):
            if function:
                words.append(f"{name} {FUNCTIONS[function][0]}.")
                branches.append((number, FUNCTIONS[function][1]))
            else:
                words.append(f"{name} does nothing.")
        for place, (number, statement) in enumerate(branches):
            draft.add("steer", f"{'elif' if place else 'if'} direction == {number}:", f"    {statement}")
        for button, function in (("first", self.first), ("second", self.second)):
            words.append(f"The {button} button {FUNCTIONS[function][0]}.")
            pressed = button if self.press == "every step" or function in ("soft", "dash") else f"{button}_pressed"
            draft.add("steer", f"if {pressed}:", f"    {FUNCTIONS[function][1]}")
        if self.press == "once":
            words.append("A button has to be released before it acts again.")
        elif {self.first, self.second} - {"soft", "dash"}:
            words.append("A button that stays pressed acts at every step.")
        if self.drop != "none":
            words.append(f"The next drop can follow after {'a step' if self.rest == 1 else f'{self.rest} steps'}.")
        draft.add("controls", *words)
        if self.holds:
            draft.add("steer", "if self.lost:", "    return")

    def _write_buttons(self, draft: Draft) -> None:
        if self.press == "every step":
            return
        for button, function in (("first", self.first), ("second", self.second)):
            if function not in ("soft", "dash"):
                draft.add("reset", f"self.{button}_down = False")
                draft.add("press", f"{button}_pressed = bool({button}) and not self.{button}_down")
                draft.add("press", f"self.{button}_down = bool({button})")

    def _write_hold(self, draft: Draft) -> None:
        draft.add("reset", "self.held: int | None = None")
        draft.add("entered", "self.swapped = False")
        draft.add(
            "methods",
            """
            def _hold(self) -> None:
                if self.swapped:
                    return
                self.held, kind = self.kind, self.held
                self._enter(kind)
                self.swapped = True
                self._paint()
            """,
        )

    def _write_dash(self, draft: Draft) -> None:
        draft.add("constants", "DASH = 3")
        draft.add(
            "methods",
            """
            def _dash(self, direction: int) -> None:
                step = (direction == 4) - (direction == 3)
                for _ in range(DASH if step else 0):
                    if not self._move(self.turn, self.row, self.column + step):
                        return
            """,
        )
