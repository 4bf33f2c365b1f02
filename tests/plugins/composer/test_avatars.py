"""Avatars with moves of their own, and pushes by those that push."""

from __future__ import annotations

from typing import Any

import pytest

from tests.plugins.composer.composed import game

STAY, UP, DOWN, LEFT, RIGHT = ((move, 0, 0) for move in range(5))


def on_empty_field(names: str) -> Any:
    """A game on a field without blocks, with the avatar in the middle of row 4."""
    env = game(names)
    env.walls = {place for place in env.walls if min(place) < 0 or max(place) > 8}
    env.at = (4, 4)
    return env


def test_a_knight_leaps_two_cells_ahead_and_one_to_the_right() -> None:
    env = on_empty_field("field knight collect plain calm hurry")
    env.walls |= {(3, 4), (2, 4)}
    env.step((1, 1, 0))
    assert env.at == (2, 5)
    env.step((4, 1, 0))
    assert env.at == (3, 7)
    env.walls.add((5, 6))
    env.step((2, 1, 0))
    assert env.at == (3, 7), "there is a wall where it would land"
    env.step(UP)
    assert env.at == (2, 7)


def test_a_blinker_comes_to_the_opposite_cell_if_it_is_free() -> None:
    env = on_empty_field("field blinker collect plain calm hurry")
    constants = env.step.__func__.__globals__
    opposite = (constants["ROWS"] - 3, constants["COLUMNS"] - 2)
    env.walls.discard(opposite)
    env.at = (2, 1)
    env.step((0, 1, 0))
    assert env.at == opposite
    env.walls.add((2, 1))
    env.step((0, 1, 0))
    assert env.at == opposite


def test_a_sprinter_gets_faster_the_same_way_and_touches_what_it_passes() -> None:
    env = on_empty_field("field sprinter collect plain calm hurry")
    env.at, env.gems = (4, 0), [(4, 2), (8, 8)]
    columns = []
    for action in (RIGHT, RIGHT, RIGHT, STAY, LEFT):
        env.step(action)
        columns.append(env.at[1])
    assert columns == [1, 3, 6, 6, 5]
    assert env.gems == [(8, 8)]


@pytest.mark.parametrize(("avatar", "actions"), [("walker", [RIGHT]), ("turtle", [RIGHT, UP]), ("sprinter", [RIGHT])])
def test_avatars_that_push_move_a_crate_but_not_two(avatar: str, actions: list[tuple[int, int, int]]) -> None:
    env = on_empty_field(f"field {avatar} crates plain calm hurry")
    env.crates, env.marks = [(4, 5), (8, 0)], [(4, 7), (8, 1)]
    for action in actions:
        env.step(action)
    assert (env.at, env.crates[0]) == ((4, 5), (4, 6))
    env.crates = [(4, 6), (4, 7)]
    env.step(actions[-1])
    assert (env.at, env.crates) == ((4, 5), [(4, 6), (4, 7)])


def test_a_marksman_turns_on_the_spot_and_hits_a_mark_in_a_corner() -> None:
    env = on_empty_field("field marksman shoot plain calm hurry")
    env.at, env.marks, env.friends = (0, 0), [(0, 1), (8, 8)], []
    env.walls.add((1, 0))
    env.step((4, 1, 0))
    assert (env.at, env.marks) == ((0, 0), [(8, 8)])
    env.step(RIGHT)
    assert env.at == (0, 1)
