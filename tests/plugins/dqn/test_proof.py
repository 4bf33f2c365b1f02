"""That it learns: two small games, from their frames alone, to a stated return."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from envcraft_dqn.evaluation import AgentPlayer, RandomPlayer, evaluate
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface
from gymnasium.spaces import Box
from gymnasium.wrappers.vector import TransformObservation

import envcraft
from envcraft.stats import Mean

from .conftest import GAMES

pytestmark = pytest.mark.slow
BASE = Settings(
    size="tiny",
    device="cpu",
    precision="fp32",
    replay="ram",
    lanes=8,
    capacity=20_000,
    learning_rate=1e-3,
    target_every=200,
    epsilon_share=0.4,
    starts=400,
)
#: Every fourth pixel shows all there is to see, at a sixteenth of the arithmetic.
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


def mean_return(name: str, player: Any) -> Mean:
    [one] = evaluate([name], open_games, player, EPISODES)
    return one.total


@pytest.mark.parametrize(
    ("name", "steps", "gamma", "stated"),
    [
        # Of 1, where chance gets about -0.7.
        ("catch.py", 12_000, 0.9, 0.8),
        # Of 8, where chance gets 2. What is shown next hangs on nothing that is done, so that looking far ahead only
        # drowns what a button is worth.
        ("lamps.py", 5_000, 0.5, 7.0),
    ],
)
def test_it_solves_a_small_game(name: str, steps: int, gamma: float, stated: float, tmp_path: Path) -> None:
    from envcraft_dqn.learner import train

    surface = Surface.of(open_games, name)
    means = []
    for done in (0, steps):
        settings = msgspec.structs.replace(BASE, steps=done, gamma=gamma)
        agent = train(settings, [name], open_games, tmp_path / str(done))
        means.append(mean_return(name, AgentPlayer(agent, surface, 0, 0.0, "cpu")))
    untrained, trained = means
    chance = mean_return(name, RandomPlayer(surface, 0))
    assert trained.low > stated > max(chance.high, untrained.high)
