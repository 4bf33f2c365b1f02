"""The functions of up, down and the two buttons."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder

#: The functions of controls: the words for the docstring, and the statement. A drop takes effect after all others.
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
#: The functions of the two buttons, in either order, with their weights.
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
#: Whether a held button acts at every step or once.
PRESSES = ("every step", "once")


@dataclass(frozen=True)
class Controls:
    """The function of each control, a key of :data:`FUNCTIONS` or empty.

    A drop is possible again `rest` steps after the last. Without this delay, random button presses end an episode
    within a dozen steps, and long episodes mean little more than not pressing the button.
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
        """The functions of all controls."""
        return self.up, self.down, self.first, self.second

    @property
    def holds(self) -> bool:
        """Whether a control puts the piece aside."""
        return "hold" in self.all

    @property
    def drop(self) -> str:
        """The kind of control that drops a piece at once: "button", "down" or "none"."""
        return "button" if "hard" in (self.first, self.second) else "down" if self.down == "hard" else "none"

    def write(self, code: SourceBuilder) -> None:
        if self.drop != "none":
            code.add("constants", f"DROP_REST = {self.rest}")
            code.add("reset", "self.drop_rest = 0")
            code.add("press", "drop = False", "self.drop_rest = max(0, self.drop_rest - 1)")
        self._write_buttons(code)
        self._write_moves(code)
        if self.holds:
            self._write_hold(code)
        if "dash" in self.all:
            self._write_dash(code)
        if self.drop == "none":
            code.add("fall", "self._fall()")
            return
        code.add("fall", "if drop and self.drop_rest == 0:", "    self._drop()", "else:", "    self._fall()")
        code.add(
            "methods",
            """
            def _drop(self) -> None:
                while self._move(self.turn, self.row + 1, self.column):
                    pass
                self.drop_rest = DROP_REST
                self._lock()
            """,
        )

    def _write_moves(self, code: SourceBuilder) -> None:
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
            code.add("steer", f"{'elif' if place else 'if'} direction == {number}:", f"    {statement}")
        for button, function in (("first", self.first), ("second", self.second)):
            words.append(f"The {button} button {FUNCTIONS[function][0]}.")
            pressed = button if self.press == "every step" or function in ("soft", "dash") else f"{button}_pressed"
            code.add("steer", f"if {pressed}:", f"    {FUNCTIONS[function][1]}")
        if self.press == "once":
            words.append("A button has to be released before it acts again.")
        elif {self.first, self.second} - {"soft", "dash"}:
            words.append("A button that stays pressed acts at every step.")
        if self.drop != "none":
            words.append(f"The next drop can follow after {'a step' if self.rest == 1 else f'{self.rest} steps'}.")
        code.add("controls", *words)
        if self.holds:
            code.add("steer", "if self.lost:", "    return")

    def _write_buttons(self, code: SourceBuilder) -> None:
        if self.press == "every step":
            return
        for button, function in (("first", self.first), ("second", self.second)):
            if function not in ("soft", "dash"):
                code.add("reset", f"self.{button}_down = False")
                code.add("press", f"{button}_pressed = bool({button}) and not self.{button}_down")
                code.add("press", f"self.{button}_down = bool({button})")

    def _write_hold(self, code: SourceBuilder) -> None:
        code.add("reset", "self.held: int | None = None")
        code.add("entered", "self.swapped = False")
        code.add(
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

    def _write_dash(self, code: SourceBuilder) -> None:
        code.add("constants", "DASH = 3")
        code.add(
            "methods",
            """
            def _dash(self, direction: int) -> None:
                step = (direction == 4) - (direction == 3)
                for _ in range(DASH if step else 0):
                    if not self._move(self.turn, self.row, self.column + step):
                        return
            """,
        )
