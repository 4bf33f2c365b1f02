"""The avatar `cursor`: a pointer that crosses walls, and a figure that follows at a button."""

from __future__ import annotations

from tests.plugins.composer.composed import game

RIGHT, JUMP = (4, 0, 0), (0, 1, 0)


def test_the_pointer_crosses_walls_and_the_figure_follows_at_the_button() -> None:
    env = game("field cursor collect plain calm hurry")
    env.walls = (env.walls - {(1, 0), (1, 2)}) | {(1, 1)}
    env.at, env.pointer, env.gems = (1, 0), (1, 0), [(1, 2), (8, 8)]
    env.fewest = env._remaining()
    env.step(RIGHT)
    assert env.pointer == (1, 1)
    env.step(JUMP)
    assert env.at == (1, 0), "there is a wall under the pointer"
    env.step(RIGHT)
    assert env.gems == [(1, 2), (8, 8)]
    _, reward, *_ = env.step(JUMP)
    assert env.at == (1, 2)
    assert env.gems == [(8, 8)]
    assert reward > 0


def test_the_pointer_stays_inside() -> None:
    env = game("field cursor collect plain calm hurry")
    env.pointer = (0, 0)
    for move in (1, 3):
        env.step((move, 0, 0))
    assert env.pointer == (0, 0)
    for _ in range(30):
        env.step(RIGHT)
        env.step((2, 0, 0))
    constants = env.step.__func__.__globals__
    assert env.pointer == (constants["ROWS"] - 1, constants["COLUMNS"] - 1)
