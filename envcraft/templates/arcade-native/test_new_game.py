"""NewGame keeps its contract, and its own rules."""

from __future__ import annotations

import numpy as np
import pytest
from new_game import NewGame


@pytest.mark.envcraft(target=NewGame, contract="arcade-native")
def test_new_game() -> None:
    """One test for each check of EnvCraft, which runs the game in a sandbox."""


def test_the_third_plum_on_the_grass_loses() -> None:
    env = NewGame()
    env.reset(seed=0)
    env.lost, env.basket, env.plum, env.height = 2, 0, 100, 78
    _, reward, terminated, truncated, info = env.step(np.array([0, 0, 0]))
    assert (reward, terminated, truncated) == (-1.0, True, False)
    assert not info["is_success"]
