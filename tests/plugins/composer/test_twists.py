"""The twists: what each does to the avatar, the world or the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.plugins.composer.composed import game

STAY, UP, DOWN, LEFT, RIGHT = ((move, 0, 0) for move in range(5))


def twisted(twist: str, **constants: int) -> Any:
    """A walker on an empty field, in the middle of row 4, with one gem far away."""
    danger = "calm lives" if twist in ("storm", "echo") else "calm hurry"
    env = game(f"field walker collect {twist} {danger}")
    env.walls = {place for place in env.walls if min(place) < 0 or max(place) > 8 or place == (0, 8)}
    env.at, env.gems, env.fewest, env.clock = (4, 4), [(8, 8)], 1, 0
    vars_of(env).update(constants)
    return env


def vars_of(env: Any) -> dict[str, Any]:
    """The constants of a game."""
    found: dict[str, Any] = env.step.__func__.__globals__
    return found


def test_a_portal_leads_to_the_other_one_and_back_after_a_step_off_it() -> None:
    env = twisted("portals")
    env.gates, env.inside = [(4, 5), (1, 1)], False
    env.step(RIGHT)
    assert env.at == (1, 1)
    env.step(STAY)
    assert env.at == (1, 1)
    env.step(RIGHT)
    env.step(LEFT)
    assert env.at == (4, 5)


def test_the_wind_blows_once_in_a_cycle() -> None:
    env = twisted("wind", CYCLE=3)
    env.wind = 1
    places = []
    for _ in range(3):
        env.step(STAY)
        places.append(env.at)
    assert places == [(4, 4), (4, 4), (3, 4)]


def test_mirrors_turn_the_moves_round_in_every_other_cycle() -> None:
    env = twisted("mirrors", CYCLE=2)
    columns = []
    for _ in range(5):
        env.step(RIGHT)
        columns.append(env.at[1])
    assert columns == [5, 4, 3, 4, 5]


def test_mud_lets_one_step_in_three_go() -> None:
    env = twisted("mud")
    env.mud = [(4, column) for column in range(9)]
    for _ in range(3):
        env.step(RIGHT)
    assert env.at == (4, 5)
    env.mud = []
    for _ in range(3):
        env.step(RIGHT)
    assert env.at == (4, 8)


def test_a_belt_carries_in_every_other_step() -> None:
    env = twisted("belts")
    env.belts = {(4, 4): 1, (3, 4): 1, (2, 4): 1}
    for _ in range(4):
        env.step(STAY)
    assert env.at == (2, 4)


def test_a_belt_pushes_a_crate() -> None:
    env = game("field walker crates belts calm hurry")
    env.walls = {place for place in env.walls if min(place) < 0 or max(place) > 8}
    env.at, env.crates, env.marks, env.belts, env.clock = (4, 4), [(4, 5), (7, 7)], [(4, 6), (7, 6)], {(4, 4): 4}, 0
    env.fewest = env._remaining()
    env.step(STAY)
    assert env.at == (4, 5)
    assert env.crates[0] == (4, 6)


def test_doors_close_and_open_again() -> None:
    env = twisted("doors", CYCLE=2)
    env.doors = {(4, 5)}
    env.step(STAY)
    env.step(RIGHT)
    assert env.at == (4, 4)
    env.step(STAY)
    env.step(RIGHT)
    assert env.at == (4, 5)


def test_lightning_strikes_where_the_avatar_was() -> None:
    env = twisted("storm", CYCLE=2)
    env.strike, env.shield = (0, 0), 0
    for action in (STAY, STAY, UP, STAY):
        env.step(action)
    assert env.lives == 3
    env.step(STAY)
    env.step(STAY)
    assert env.lives == 2


def test_the_echo_harms_where_it_meets_the_avatar() -> None:
    env = twisted("echo")
    env.shield, env.past = 0, [(4, 6), (4, 6), (4, 5), (4, 4)]
    env.step(STAY)
    assert env.lives == 3
    env.step(STAY)
    assert env.lives == 2
    env.shield = 0
    for _ in range(5):
        env.step(STAY)
    assert env.lives == 2, "an echo that rests does not harm"


def test_the_night_darkens_what_is_far() -> None:
    env = twisted("night", LIGHT=8)
    dark = env.render()
    vars_of(env)["LIGHT"] = 84
    light = env.render()
    top, left = env._pixel(env.at)
    assert (dark[top : top + 4, left : left + 4] == light[top : top + 4, left : left + 4]).all()
    assert (dark[6:10, 2:80] < light[6:10, 2:80]).all()


def test_clouds_drift_over_the_world() -> None:
    env = twisted("clouds")
    still = vars_of(env)["PALETTE"][1]
    covered = []
    for clock in (40, 60):
        env.clock = clock
        covered.append((env.render() == still).all(axis=2))
    assert covered[0].sum() > 200
    assert (covered[0] != covered[1]).any()


def test_a_nettle_stings_once() -> None:
    env = twisted("nettles", STING=1)
    env.nettles = [(4, 5)]
    rewards = [env.step(action)[1] for action in (RIGHT, LEFT, RIGHT)]
    assert rewards[0] == pytest.approx(rewards[1] - 1)
    assert rewards[2] == rewards[1]


def test_a_spring_throws_what_moves_on_it() -> None:
    env = twisted("springs", THROW=2)
    env.springs = [(4, 5)]
    env.step(RIGHT)
    assert env.at == (4, 7)
    env.at = (4, 5)
    env.step(STAY)
    assert env.at == (4, 5)


def test_the_tide_slows_the_avatar_in_its_rows() -> None:
    env = twisted("tide", HIGH=5, EBB=1000)
    rows = vars_of(env)["ROWS"]
    env.at = (rows - 5, 4)
    for _ in range(4):
        env.step(RIGHT)
    assert env.at == (rows - 5, 6)
    env.at = (rows - 6, 2)
    for _ in range(4):
        env.step(RIGHT)
    assert env.at == (rows - 6, 6)


def test_a_magnet_pulls_the_longer_way_first() -> None:
    env = twisted("magnet", CYCLE=1)
    env.magnet = (4, 6)
    env.at = (3, 3)
    places = []
    for _ in range(5):
        env.step(STAY)
        places.append(env.at)
    assert places == [(3, 4), (3, 5), (3, 6), (4, 6), (4, 6)]


@pytest.mark.parametrize("twist", ["sinking", "marching"])
def test_bricks_move_and_stay_inside(twist: str) -> None:
    env = game(f"plane paddle bricks {twist} calm lives")
    start = np.array(env.gems)
    for _ in range(40):
        env.step(STAY)
    places = np.array(env.gems)
    assert places.tolist() != start[: len(places)].tolist()
    assert places.min() >= 1
    assert places[:, 0].max() <= vars_of(env)["LOW"] + 1
    assert places[:, 1].max() <= 83 - vars_of(env)["CELL"]
