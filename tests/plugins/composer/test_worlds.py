"""The worlds: the room that they leave for things, and the size by the difficulty."""

from __future__ import annotations

from random import Random

import pytest
from envcraft_composer.composition import GROUPS

from tests.plugins.composer.composed import game

#: The most things that a game places: of a goal, a twist and a danger.
THINGS = 35
CELLS = [world.name for world in GROUPS["world"] if "cells" in world.gives]


@pytest.mark.parametrize("world", CELLS)
def test_every_start_has_room_for_all_things(world: str) -> None:
    avatar = "jumper" if world in ("platforms", "lifts") else "walker"
    pressure = "calm lives" if world == "lanes" else "calm hurry"
    env = game(f"{world} {avatar} collect plain {pressure}")
    shapes = set()
    for seed in range(60):
        env.reset(seed=seed)
        shapes.add(frozenset(env.walls))
        assert len(env._spots(THINGS)) == THINGS
    assert len(shapes) > 1 or world == "lanes", "seeds give different worlds"


def test_a_harder_world_is_larger() -> None:
    for world in GROUPS["world"]:
        drawn = [world.draw(Random(3), level).get("ROWS", 0) for level in (0.0, 0.5, 1.0)]
        sizes = [rows for rows in drawn if isinstance(rows, int)]
        assert sizes == sorted(sizes)
        assert sizes[0] < sizes[2] or world.name in ("plane", "space", "rooms", "lifts")
