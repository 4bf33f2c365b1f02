"""The family `composer`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from random import Random
from typing import Any

from envcraft.environments.families import Family, Generated
from envcraft_composer.composition import Composition, combinations, cores
from envcraft_composer.kinship import Kinship
from envcraft_composer.mechanic import Mechanic

#: The most lines of a source.
_MOST_LINES = 250
#: Sets of mechanics among which the next is chosen.
_CHOICES = 40
#: The share of their own code from which two games are too much alike.
_ALIKE, _EQUAL = 0.6, 1.0


class ComposerFamily(Family):
    """Games assembled from typed mechanics, under the contract ``arcade``."""

    name = "composer"
    has_difficulty = True
    summary = (
        "games of many kinds, assembled from worlds, avatars, goals, twists, dangers, pressures and looks "
        "(contract arcade)"
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
    """Yield sets of mechanics: goals in turn, and for each the mechanics that were used least, alone and together.

    A goal is left out once each of its sets shares too much code with an earlier game, and comes back when all are.
    """
    known = Kinship()
    done: set[tuple[str, ...]] = set()
    for limit in itertools.cycle((_ALIKE, _EQUAL)):
        if limit == _ALIKE:
            known = Kinship()
            done.clear()
        rest: dict[str, list[dict[str, Mechanic]]] = {}
        for core in cores():
            rest.setdefault(core["goal"].name, []).append(core)
        while rest:
            for goal, waiting in list(rest.items()):
                fresh: list[dict[str, Mechanic]] = []
                while waiting and not fresh:
                    rng.shuffle(waiting)
                    core = min(waiting, key=known.uses)
                    fresh = [one for one in combinations(core) if _names(one) not in done]
                    fresh = [one for one in fresh if limit == _EQUAL or known.nearest(one) < limit]
                    if not fresh:
                        # All that is added makes it less likely that a set fits.
                        waiting.remove(core)
                if not fresh:
                    del rest[goal]
                    continue
                rng.shuffle(fresh)
                chosen = min(fresh[:_CHOICES], key=known.uses)
                done.add(_names(chosen))
                known.add(chosen)
                yield chosen


def _names(chosen: dict[str, Mechanic]) -> tuple[str, ...]:
    return tuple(mechanic.name for mechanic in chosen.values())
