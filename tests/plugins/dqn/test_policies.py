"""Controls that do not look at the frame."""

from __future__ import annotations

import numpy as np
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.policies import CoinPolicy, CountingPolicy, RandomPolicy, ShuffledPolicy

ARCADE = EnvSpec((84, 84, 3), (5, 2, 2))
FRAMES = np.zeros((4_000, 1, 1, 3), np.uint8)


def test_coin_moves_at_random_and_presses_no_button() -> None:
    actions = ARCADE.split(CoinPolicy(ARCADE, 0).act(FRAMES))
    assert not actions[:, 1:].any()
    assert np.bincount(actions[:, 0]).min() > 700


def test_shuffled_actions_have_the_frequencies_of_the_other_policy() -> None:
    counts = [0] * 20
    counts[3], counts[7] = 30, 10
    drawn = np.bincount(ShuffledPolicy(counts, 0).act(FRAMES), minlength=20)
    assert drawn[3] + drawn[7] == len(FRAMES)
    assert abs(drawn[3] / len(FRAMES) - 0.75) < 0.03


def test_actions_are_counted() -> None:
    policy = CountingPolicy(RandomPolicy(ARCADE, 0), 20)
    actions = np.concatenate([policy.act(FRAMES[:50]) for _ in range(3)])
    assert policy.counts.tolist() == np.bincount(actions, minlength=20).tolist()
