"""A variant: one value along each axis, drawn so that they go together, and the source that they make."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from random import Random
from typing import Any

from . import pace
from .axes.board import Board
from .axes.clearing import Clearing
from .axes.controls import Controls
from .axes.ending import Ending
from .axes.entry import Entry
from .axes.garbage import Garbage
from .axes.gravity import Gravity
from .axes.locking import Locking
from .axes.look import Look
from .axes.pieces import Pieces
from .axes.rewards import Rewards
from .axes.rotation import Rotation
from .axes.supply import Supply
from .draft import Draft, paragraph
from .skeleton import SKELETON

#: In steps, of the estimates: a game in which nothing is pressed, and games of random actions.
SHORTEST_IDLE, SHORTEST, LONGEST = 70, 40, 280
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
class Variant:
    """The fields stand in the order in which their code comes in the file."""

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
    look: Look

    @classmethod
    def draw(cls, rng: Random) -> Variant:
        """A variant whose games last long enough to do something, and end where nobody plays well."""
        while True:
            variant = cls._draw(rng)
            longest = LONGEST / 2 if variant.clearing.easy else LONGEST
            if variant.idle_steps >= SHORTEST_IDLE and SHORTEST <= variant.random_steps <= longest:
                return variant

    @classmethod
    def _draw(cls, rng: Random) -> Variant:
        pieces = Pieces.draw(rng)
        board = Board.draw(rng, pieces)
        entry = Entry.draw(rng)
        gravity = Gravity.draw(rng, board)
        clearing = Clearing.draw(rng, pieces, board)
        garbage = Garbage.draw(rng, board)
        ending = Ending.draw(rng, pieces, board, entry, gravity, clearing, garbage)
        return cls(
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
            look=Look.draw(rng),
        )

    @property
    def idle_steps(self) -> float:
        """About how long a game lasts in which nothing is pressed."""
        return pace.idle_steps(self.pieces, self.board, self.entry, self.gravity, self.garbage)

    @property
    def random_steps(self) -> float:
        """About how long a game of random actions lasts, if nothing is cleared."""
        return pace.random_steps(
            self.pieces, self.board, self.entry, self.gravity, self.garbage, self.locking, self.controls
        )

    @property
    def fair(self) -> bool:
        """Whether it takes more than one action, held, to win: on slopes and ledges grains fill rows by themselves."""
        return self.clearing.rule != "sand" or self.board.shape in ("rectangle", "pillar")

    @property
    def rules(self) -> tuple[Any, ...]:
        """All but the look: two variants that differ in nothing else are one game."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "look")

    @property
    def title(self) -> str:
        """A few words of what stands out."""
        words = ["wrapped"] if self.board.wrap else []
        words += [_MANNERS[self.clearing.rule]] if self.clearing.rule in _MANNERS else []
        place = _PLACES[self.board.shape]
        goal = {"dig": ", digging", "clock": " against the clock", "survive": ", surviving"}.get(self.ending.goal, "")
        text = f"{' '.join([*words, self.pieces.family.removeprefix('some ')])}{place}{goal}"
        return text[0].upper() + text[1:]

    def axes(self) -> dict[str, Any]:
        """The values as plain data."""
        return dataclasses.asdict(self)

    def write(self, class_name: str) -> str:
        """The source of the environment."""
        draft = Draft()
        for field in dataclasses.fields(self):
            getattr(self, field.name).write(draft, self)
        title = self.title
        draft.add("title", f"{title}: falling pieces on a board of {self.board.rows} by {self.board.columns}.")
        draft.add("summary", f"{title}.")
        draft.add("class", class_name)
        story, aim, controls, paid = (draft.take(slot) for slot in ("story", "aim", "controls", "paid"))
        rewards = f"Rewards: {', '.join(paid)}."
        parts = (paragraph(*story), paragraph("Goal:", *aim), paragraph("Controls:", *controls), paragraph(rewards))
        draft.add("about", "\n\n".join(parts))
        text = draft.write(SKELETON)
        return re.sub(r"\n{4,}", "\n\n\n", text).rstrip() + "\n"
