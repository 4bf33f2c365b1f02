"""NewGame keeps its contract, and its own rules."""

from __future__ import annotations

import numpy as np
import pytest
from new_game import NewGame


@pytest.mark.envcraft(target=NewGame, contract="gymnasium")
def test_new_game() -> None:
    """One test for each check of EnvCraft, which runs the game in a sandbox."""


def test_the_door_opens_with_the_key_only() -> None:
    env = NewGame()
    env.reset(seed=0)
    env.you, env.door = (7, 4), (8, 4)
    assert not env.step(np.int64(3))[2]
    env.you, env.has_key = (7, 4), True
    _, reward, terminated, _, info = env.step(np.int64(3))
    assert (round(reward, 2), terminated, info["is_success"]) == (0.99, True, True)
