"""The trainer solves two small games from their frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.evaluation import evaluate
from envcraft_dqn.policies import AgentPolicy, RandomPolicy
from envcraft_dqn.settings import Settings
from gymnasium.spaces import Box
from gymnasium.wrappers.vector import TransformObservation

import envcraft
from envcraft.judging.statistics import Mean

from .conftest import GAMES

pytestmark = pytest.mark.slow
BASE = Settings(
    size="tiny",
    device="cpu",
    precision="fp32",
    replay="ram",
    num_envs=8,
    capacity=20_000,
    learning_rate=1e-3,
    target_every=200,
    epsilon_share=0.4,
    starts=400,
)
#: Every fourth pixel has all information, at a sixteenth of the cost.
STRIDE = 4
EPISODES = 200


def open_games(names: Sequence[str]) -> Any:
    vector = envcraft.make_vec([GAMES / name for name in names], trust=True, workers=0)
    side = 84 // STRIDE
    return TransformObservation(
        vector,
        lambda frames: np.ascontiguousarray(frames[:, ::STRIDE, ::STRIDE]),
        Box(0, 255, (len(names), side, side, 3), np.uint8),
        Box(0, 255, (side, side, 3), np.uint8),
    )


def mean_return(name: str, policy: Any) -> Mean:
    [one] = evaluate([name], open_games, policy, EPISODES)
    return one.total


@pytest.mark.parametrize(
    ("name", "steps", "gamma", "stated"),
    [
        # The maximum is 1, and chance reaches about -0.7.
        ("catch.py", 12_000, 0.9, 0.8),
        # The maximum is 8, and chance reaches 2. Actions do not affect later frames, so that a long horizon only adds
        # noise to the value of a button.
        ("lamps.py", 5_000, 0.5, 7.0),
    ],
)
def test_solves_a_small_game(name: str, steps: int, gamma: float, stated: float, tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    spec = EnvSpec.of(open_games, name)
    means = []
    for done in (0, steps):
        settings = msgspec.structs.replace(BASE, steps=done, gamma=gamma)
        agent = train(settings, [name], open_games, tmp_path / str(done))
        means.append(mean_return(name, AgentPolicy(agent, spec, 0, 0.0, "cpu")))
    untrained, trained = means
    chance = mean_return(name, RandomPolicy(spec, 0))
    assert trained.low > stated > max(chance.high, untrained.high)
