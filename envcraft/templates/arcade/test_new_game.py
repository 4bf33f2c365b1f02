"""NewGame keeps its contract, and its own rules."""

from __future__ import annotations

import numpy as np
import pytest
from new_game import NewGame


@pytest.mark.envcraft(target=NewGame, contract="arcade")
def test_new_game() -> None:
    """One test for each check of EnvCraft, which runs the game in a sandbox."""


def test_the_last_lamp_wins() -> None:
    env = NewGame()
    env.reset(seed=0)
    env.you, env.lamps, env.owls = (5, 11), {(6, 11)}, []
    _, reward, terminated, truncated, info = env.step(np.array([4, 0, 0]))
    assert (reward, terminated, truncated) == (3.0, True, False)
    assert info["is_success"]
