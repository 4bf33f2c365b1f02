"""A variant of the family: its rules, its look, and the source file that they produce."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from random import Random
from typing import Any

from envcraft.environments.source_builder import SourceBuilder, paragraph
from envcraft_tetris.axes.look import Look
from envcraft_tetris.rules import Rules
from envcraft_tetris.skeleton import SKELETON

#: Limits on the estimated episode length, in steps: the least without input, then the range for random actions.
SHORTEST_IDLE, SHORTEST, LONGEST = 70, 40, 280


@dataclass(frozen=True)
class Variant(Rules):
    """One value for each axis."""

    look: Look

    @classmethod
    def draw(cls, rng: Random) -> Variant:
        """Draw a variant at random. Its episodes are neither too short to play nor endless under poor play."""
        while True:
            variant = cls(**vars(Rules.draw(rng)), look=Look.draw(rng))
            longest = LONGEST / 2 if variant.clearing.easy else LONGEST
            if variant.idle_steps >= SHORTEST_IDLE and SHORTEST <= variant.random_steps <= longest:
                return variant

    def axes(self) -> dict[str, Any]:
        """The values of all axes as plain data."""
        return dataclasses.asdict(self)

    def write(self, class_name: str) -> str:
        """The source of the environment, as a class with this name."""
        source = SourceBuilder()
        self.write_rules(source)
        self.look.write(source, self)
        title = self.title
        source.add("title", f"{title}: falling pieces on a board of {self.board.rows} by {self.board.columns}.")
        source.add("summary", f"{title}.")
        source.add("class", class_name)
        story, aim, controls, paid = (source.take(slot) for slot in ("story", "aim", "controls", "paid"))
        rewards = f"Rewards: {', '.join(paid)}."
        parts = (paragraph(*story), paragraph("Goal:", *aim), paragraph("Controls:", *controls), paragraph(rewards))
        source.add("about", "\n\n".join(parts))
        text = source.render(SKELETON)
        return re.sub(r"\n{4,}", "\n\n\n", text).rstrip() + "\n"
