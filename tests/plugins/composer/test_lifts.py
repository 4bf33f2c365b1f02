"""The world `lifts`: platforms that move, carry and wait."""

from __future__ import annotations

from typing import Any

from tests.plugins.composer.composed import game

STAY = (0, 0, 0)


def one_lift(at: tuple[int, int]) -> Any:
    """A game with one lift in row 6, columns 2 to 4, which goes right at the next step as far as column 5."""
    env = game("lifts jumper collect plain calm hurry")
    env.walls = {place for place in env.walls if not (0 <= place[0] < 11 and 0 <= place[1] < 11)}
    constants = env.step.__func__.__globals__
    constants["PACE"], constants["WIDE"] = 1, 3
    env.lifts, env.at, env.gems = [[6, 2, 4, (2, 3)]], at, [(0, 0)]
    env._touch()
    return env


def test_a_lift_carries_what_stands_on_it_and_turns_at_its_ends() -> None:
    env = one_lift((5, 3))
    places = []
    for _ in range(4):
        env.step(STAY)
        places.append((env.lifts[0][1], env.at))
    assert places == [(3, (5, 4)), (2, (5, 3)), (3, (5, 4)), (2, (5, 3))]


def test_a_lift_waits_for_an_avatar_in_its_way() -> None:
    env = one_lift((6, 5))
    env.walls.add((7, 5))
    env.step(STAY)
    assert env.lifts[0][1] == 2
    assert env.at == (6, 5)


def test_a_rider_in_front_of_a_wall_stays_behind() -> None:
    env = one_lift((5, 2))
    env.walls.add((5, 3))
    env.step(STAY)
    assert env.lifts[0][1] == 3
    assert env.at == (5, 2)
    env.lifts[0][3] = (3, 3)
    env.step(STAY)
    assert env.at == (6, 2), "it falls where the lift was"


def test_lifts_stay_between_their_ledges() -> None:
    env = game("lifts jumper collect plain calm hurry")
    for seed in range(5):
        env.reset(seed=seed)
        for _ in range(60):
            env.step(STAY)
            assert not env.boards & env.walls
            assert all(ends[0] <= x <= ends[1] for _, x, _, ends in env.lifts)


def test_things_lie_above_the_whole_way_of_a_lift() -> None:
    env = game("lifts jumper collect plain calm hurry")
    above = 0
    for seed in range(20):
        env.reset(seed=seed)
        columns = {(y - 1, x) for y, _, _, (first, last) in env.lifts for x in range(first, last + 1)}
        above += len(columns & set(env.gems) - {(y - 1, x) for y, x in env.boards})
    assert above > 10
