"""The goal `match`: what a visit does to a panel, and what is left to do."""

from __future__ import annotations

from tests.plugins.composer.composed import game

LEFT, RIGHT, STAY = (3, 0, 0), (4, 0, 0), (0, 0, 0)


def test_each_visit_turns_a_panel_once_and_the_last_one_wins() -> None:
    env = game("field walker match plain calm hurry")
    env.walls = {place for place in env.walls if place[0] != 1 or not 0 <= place[1] < 3}
    env.at, env.panels, env.shown, env.wants, env.standing = (1, 0), [(1, 1)], [0], [2], -1
    env.fewest = env._remaining()
    assert env.fewest == 2
    _, reward, *_ = env.step(RIGHT)
    assert env.shown == [1]
    assert reward > 0
    env.step(STAY)
    assert env.shown == [1]
    assert env.get_state()["targets"] == [(1, 1)]
    env.step(RIGHT)
    _, _, terminated, _, info = env.step(LEFT)
    assert terminated
    assert info["is_success"]


def test_a_panel_that_turns_too_far_must_be_turned_twice_more() -> None:
    env = game("field walker match plain calm hurry")
    env.walls -= {(1, 0), (1, 1)}
    env.at, env.panels, env.shown, env.wants, env.standing = (1, 0), [(1, 1), (3, 3)], [2, 0], [2, 1], -1
    env.fewest = env._remaining()
    _, reward, *_ = env.step(RIGHT)
    assert env._remaining() == 3
    assert reward < 0


def test_no_panel_matches_at_the_start() -> None:
    env = game("field walker match plain calm hurry")
    for seed in range(20):
        env.reset(seed=seed)
        assert all(shown != want for shown, want in zip(env.shown, env.wants, strict=True))
