"""The family `composer`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from random import Random
from typing import Any

from envcraft.environments.families import Family, Generated
from envcraft_composer.composition import Composition, combinations
from envcraft_composer.mechanic import Mechanic

#: The most lines of a source.
_MOST_LINES = 250
#: Sets of mechanics among which the next is chosen.
_CHOICES = 40


class ComposerFamily(Family):
    """Games assembled from typed mechanics, under the contract ``arcade``."""

    name = "composer"
    has_difficulty = True
    summary = (
        "games of many kinds, assembled from worlds, avatars, goals, dangers, pressures and looks (contract arcade)"
    )

    def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
        """Generate `count` games, of which no two have the same mechanics until all combinations are used.

        Args:
            count: How many; a smaller number gives the first of the same games.
            seed: The same seed gives the same games.
            difficulty: From 0, the easiest, to 1; drawn for each game by default.
        """
        rng = Random(seed)
        mechanics = _varied(rng)
        made = 0
        # Rejected draws keep their numbers, so that a stricter limit renames no game.
        for number in itertools.count():
            if made == count:
                return
            chosen = next(mechanics)
            # The constants of a game do not depend on how many numbers another level of difficulty draws before it.
            drawn, own = rng.random(), Random(rng.getrandbits(64))
            level = round(drawn, 3) if difficulty is None else difficulty
            composition = Composition.draw(own, chosen, level)
            names = {group: mechanic.name for group, mechanic in chosen.items()}
            class_name = "".join(names[group].capitalize() for group in ("avatar", "goal", "world")) + f"{number:04}"
            source = composition.write(class_name)
            if source.count("\n") > _MOST_LINES:
                continue
            made += 1
            metadata = {"axes": {**names, "constants": composition.constants}, "difficulty": level}
            yield Generated(f"composer_{seed}_{number:04}", source, metadata)

    def kind(self, metadata: dict[str, Any]) -> str:
        """The goal."""
        return str(metadata["axes"]["goal"]) if "axes" in metadata else ""


def _varied(rng: Random) -> Iterator[dict[str, Mechanic]]:
    """Yield sets of mechanics: goals in turn, then those whose mechanics were used least together.

    Games with the same world, avatar and goal differ in little code, so such a three comes again only after all others.
    """
    rest: dict[str, dict[str, list[dict[str, Mechanic]]]] = {}
    used: dict[tuple[str, str], int] = {}
    while True:
        if not any(sets for cores in rest.values() for sets in cores.values()):
            for chosen in combinations():
                cores = rest.setdefault(chosen["goal"].name, {})
                cores.setdefault(f"{chosen['world'].name} {chosen['avatar'].name}", []).append(chosen)
            for cores in rest.values():
                for sets in cores.values():
                    rng.shuffle(sets)
        waiting = [[sets.pop() for sets in cores.values() if sets] for cores in rest.values()]
        for choices in waiting:
            rng.shuffle(choices)
        while any(waiting):
            for choices in waiting:
                if choices:
                    best = min(
                        choices[-_CHOICES:], key=lambda chosen: sum(used.get(pair, 0) for pair in _pairs(chosen))
                    )
                    choices.remove(best)
                    for pair in _pairs(best):
                        used[pair] = used.get(pair, 0) + 1
                    yield best


def _pairs(chosen: dict[str, Mechanic]) -> list[tuple[str, str]]:
    names = [(group, mechanic.name) for group, mechanic in chosen.items()]
    pairs = [(f"{one} {two}", f"{first} {second}") for one, first in names for two, second in names if one < two]
    return [*pairs, *((name, value) for name, value in names for _ in range(2))]
