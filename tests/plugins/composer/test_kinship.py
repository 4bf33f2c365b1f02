"""How much code games share."""

from __future__ import annotations

from envcraft_composer.composition import GROUPS
from envcraft_composer.kinship import Kinship
from envcraft_composer.mechanic import Mechanic


def chosen(names: str) -> dict[str, Mechanic]:
    return {
        group: next(mechanic for mechanic in mechanics if mechanic.name == name)
        for (group, mechanics), name in zip(GROUPS.items(), names.split(), strict=True)
    }


def test_games_are_alike_by_the_code_of_their_mechanics() -> None:
    known = Kinship()
    assert known.nearest(chosen("maze walker match wind calm hurry")) == 0
    known.add(chosen("maze walker match wind calm hurry"))
    same = known.nearest(chosen("maze walker match wind spikes lives"))
    other_twist = known.nearest(chosen("maze walker match tide calm hurry"))
    other_goal = known.nearest(chosen("maze walker escort tide calm hurry"))
    assert same > other_twist > other_goal > known.nearest(chosen("plane flyer shoot night calm lives")) == 0


def test_mechanics_that_were_used_together_count_more() -> None:
    known = Kinship()
    known.add(chosen("maze walker match wind calm hurry"))
    known.add(chosen("cave turtle order wind spikes lives"))
    together = known.uses(chosen("maze walker match tide fire energy"))
    apart = known.uses(chosen("maze turtle match tide fire energy"))
    assert together > apart > known.uses(chosen("field hopper score tide fire energy")) == 0
