"""The rules of a variant: every axis except the look."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from random import Random
from typing import Any

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris import episode_length
from envcraft_tetris.axes.board import Board
from envcraft_tetris.axes.clearing import Clearing
from envcraft_tetris.axes.controls import Controls
from envcraft_tetris.axes.ending import Ending
from envcraft_tetris.axes.entry import Entry
from envcraft_tetris.axes.garbage import Garbage
from envcraft_tetris.axes.gravity import Gravity
from envcraft_tetris.axes.locking import Locking
from envcraft_tetris.axes.pieces import Pieces
from envcraft_tetris.axes.rewards import Rewards
from envcraft_tetris.axes.rotation import Rotation
from envcraft_tetris.axes.supply import Supply

_PLACES = {
    "rectangle": "",
    "bowl": " in a bowl",
    "pillar": " around a pillar",
    "stairs": " on stairs",
    "ledges": " between ledges",
    "islands": " among islands",
}
_MANNERS = {"cascade": "cascading", "sticky": "sticky", "sand": "crumbling", "colour": "coloured"}


@dataclass(frozen=True)
class Rules:
    """One value for each axis of the rules, in the order in which their code appears in the generated file."""

    board: Board
    pieces: Pieces
    supply: Supply
    entry: Entry
    controls: Controls
    rotation: Rotation
    gravity: Gravity
    locking: Locking
    clearing: Clearing
    garbage: Garbage
    ending: Ending
    rewards: Rewards

    @classmethod
    def draw(cls, rng: Random) -> Rules:
        """Draw compatible values at random."""
        pieces = Pieces.draw(rng)
        board = Board.draw(rng, pieces)
        entry = Entry.draw(rng)
        gravity = Gravity.draw(rng, board)
        clearing = Clearing.draw(rng, pieces, board)
        garbage = Garbage.draw(rng, board)
        ending = Ending.draw(rng, pieces, board, entry, gravity, clearing, garbage)
        return Rules(
            board=board,
            pieces=pieces,
            supply=Supply.draw(rng, pieces),
            entry=entry,
            controls=Controls.draw(rng),
            rotation=Rotation.draw(rng),
            gravity=gravity,
            locking=Locking.draw(rng),
            clearing=clearing,
            garbage=garbage,
            ending=ending,
            rewards=Rewards.draw(rng, ending),
        )

    def write_rules(self, code: SourceBuilder) -> None:
        """Add the code and the documentation of every rule to a source."""
        self.board.write(code)
        self.pieces.write(code)
        self.supply.write(code)
        self.entry.write(code, self.controls)
        self.controls.write(code)
        self.rotation.write(code)
        self.gravity.write(code, self.clearing)
        self.locking.write(code)
        self.clearing.write(code, self.board)
        self.garbage.write(code, self.clearing)
        self.ending.write(code, self.clearing)
        self.rewards.write(code, self.clearing)

    @property
    def idle_steps(self) -> float:
        """The estimated length of an episode without any input, in steps."""
        return episode_length.idle_steps(self.pieces, self.board, self.entry, self.gravity, self.garbage)

    @property
    def random_steps(self) -> float:
        """The estimated length of an episode of random actions that clears nothing, in steps."""
        return episode_length.random_steps(
            self.pieces, self.board, self.entry, self.gravity, self.garbage, self.locking, self.controls
        )

    @property
    def fair(self) -> bool:
        """Whether a single held action cannot win. On slopes and ledges, sand fills rows without any play."""
        return self.clearing.rule != "sand" or self.board.shape in ("rectangle", "pillar")

    @property
    def rules(self) -> tuple[Any, ...]:
        """The values of the rules alone. Two variants with equal rules are the same game."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(Rules))

    @property
    def title(self) -> str:
        """A short name made of the distinctive rules."""
        words = ["wrapped"] if self.board.wrap else []
        words += [_MANNERS[self.clearing.rule]] if self.clearing.rule in _MANNERS else []
        place = _PLACES[self.board.shape]
        goal = {"dig": ", digging", "clock": " against the clock", "survive": ", surviving"}.get(self.ending.goal, "")
        text = f"{' '.join([*words, self.pieces.family.removeprefix('some ')])}{place}{goal}"
        return text[0].upper() + text[1:]
