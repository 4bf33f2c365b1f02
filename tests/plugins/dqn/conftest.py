"""Tiny environments for tests of the trainer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

GAMES = Path(__file__).parent / "games"


class Corridor(gymnasium.Env[Any, Any]):
    """A corridor of six cells with a reward at the right end. It truncates after ten steps; `flip` mirrors it."""

    def __init__(self, flip: bool = False) -> None:
        self.observation_space = gymnasium.spaces.Box(0, 255, (16, 16, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])
        self._flip = flip

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self._place, self._steps = int(self.np_random.integers(3)), 0
        return self._frame(), {}

    def step(self, action: Any) -> Any:
        self._place = max(self._place + (1 if (action[0] == 4) != self._flip else -1), 0)
        self._steps += 1
        won = self._place >= 5
        return self._frame(), float(won) - 0.01, won, not won and self._steps >= 10, {}

    def _frame(self) -> Any:
        frame = np.zeros((16, 16, 3), np.uint8)
        frame[:, 2 * self._place : 2 * self._place + 3] = (250, 120, 40) if self._flip else (40, 250, 120)
        return frame


def open_corridors(names: Sequence[str]) -> Any:
    return SyncVectorEnv([partial(Corridor, name == "left") for name in names])


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run these tests last: torch adds half a gigabyte to the process, which slows the forks of other tests."""
    items.sort(key=lambda item: Path(__file__).parent in item.path.parents)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, because the number of threads affects the order of sums."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
