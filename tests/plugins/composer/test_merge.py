"""The goal `merge`: how drops are pushed, merge and start."""

from __future__ import annotations

from tests.plugins.composer.composed import game

RIGHT = (4, 0, 0)


def test_a_drop_is_pushed_and_merges_with_the_next() -> None:
    env = game("field walker merge plain calm hurry")
    env.walls -= {(1, column) for column in range(5)}
    env.at, env.drops, env.fewest = (1, 0), {(1, 1), (1, 3)}, 1
    env.step(RIGHT)
    assert env.at == (1, 1)
    assert env.drops == {(1, 2), (1, 3)}
    _, reward, terminated, _, info = env.step(RIGHT)
    assert env.drops == {(1, 3)}
    assert terminated
    assert info["is_success"]
    assert reward > 0


def test_a_drop_in_front_of_a_wall_stays() -> None:
    env = game("field walker merge plain calm hurry")
    env.walls = env.walls - {(1, 0), (1, 1)} | {(1, 2)}
    env.at, env.drops = (1, 0), {(1, 1), (5, 5)}
    env.step(RIGHT)
    assert env.at == (1, 0)
    assert env.drops == {(1, 1), (5, 5)}


def test_all_drops_can_be_walked_to_at_the_start() -> None:
    for world in ("field", "rooms", "torus"):
        env = game(f"{world} walker merge plain calm hurry")
        for seed in range(10):
            env.reset(seed=seed)
            assert len(env.drops) == env.total + 1
            env.walls = env.walls | env.drops
            reached = set(env._reachable())
            assert all(any(env._shift(drop, move) in reached for move in range(1, 5)) for drop in env.drops)
