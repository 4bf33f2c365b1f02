"""Tests of an agent during its training, in environments that it does not train on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envcraft_dqn.env_spec import EnvSpec, OpenVector
from envcraft_dqn.evaluation import evaluate
from envcraft_dqn.files import write_atomically
from envcraft_dqn.policies import RandomPolicy

if TYPE_CHECKING:
    from envcraft_dqn.learner import Learner


class HeldOut:
    """Tests an agent every so many updates, and keeps the best one in ``best.safetensors``.

    The score is the mean over environments of the agent's lead in mean return over random play, in standard deviations
    of the returns of random play. Returns of different environments are thus comparable without a privileged player.

    Args:
        names: The held-out environments.
        open_vector: Makes a vector of named environments.
        folder: The folder of the run. ``held-out.json`` has the scores by update.
        every: The updates between two tests.
        episodes: The episodes of each environment, at least two.
        seed: The seed of the episodes.
    """

    def __init__(
        self, names: Sequence[str], open_vector: OpenVector, folder: Path, every: int, episodes: int, seed: int
    ) -> None:
        self._names, self._open, self._folder = names, open_vector, folder
        self.every, self._episodes, self._seed = every, episodes, seed
        self._file = folder / "held-out.json"
        self._random: dict[str, tuple[float, float]] = {}

    def test(self, learner: Learner, spec: EnvSpec, updates: int) -> float:
        """Test the agent after `updates` updates, and return its score."""
        from envcraft_dqn.checkpoint import save_agent

        if not self._random:
            chance = RandomPolicy(spec, self._seed)
            for one in evaluate(self._names, self._open, chance, self._episodes, seed=self._seed):
                # Equal returns have no spread; their unit is 1.
                self._random[one.name] = one.total.mean, float(np.std(one.returns)) or 1.0
        leads = []
        for one in evaluate(self._names, self._open, learner, self._episodes, seed=self._seed):
            mean, spread = self._random[one.name]
            leads.append((one.total.mean - mean) / spread)
        score = float(np.mean(leads))
        # A resumed run repeats the tests after its checkpoint.
        known: dict[str, float] = json.loads(self._file.read_text("utf-8")) if self._file.is_file() else {}
        earlier = {at: value for at, value in known.items() if int(at) < updates}
        if score > max(earlier.values(), default=-np.inf):
            save_agent(self._folder / "best.safetensors", learner.network, spec, learner.precision)
        write_atomically(self._file, json.dumps({**earlier, str(updates): score}, indent=1))
        return score
