"""Trained policies as players of environments in the sandbox: ``checkpoint:PATH``. Torch is imported when one plays."""

from __future__ import annotations

import contextlib
import importlib.util
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from envcraft.demonstrations.player import Player, PlayerLoader
from envcraft.environments.sandboxed import SubjectEnv
from envcraft.errors import EnvironmentFailed, Skip, UsageError
from envcraft_dqn.env_spec import EnvSpec, spec_of_spaces
from envcraft_dqn.policies import AgentPolicy, agent_file

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_LIBRARIES = ("safetensors", "torch")


class CheckpointLoader(PlayerLoader):
    """Loads what ``envcraft train`` wrote: a folder, or a file in it."""

    name = "checkpoint"
    summary = "a policy that `envcraft train` wrote: its folder, or a file in it"

    def load(self, path: Path) -> Player:
        missing = [name for name in _LIBRARIES if importlib.util.find_spec(name) is None]
        if missing:
            raise UsageError(f"{self.name}:{path} needs {' and '.join(missing)}: `pip install 'envcraft-rl[train]'`")
        try:
            return TrainedPlayer(path)
        except OSError as error:
            raise UsageError(f"{path} is not an agent of `envcraft train`: {error.strerror or error}") from None


class TrainedPlayer(Player):
    """Plays as a trained agent, which sees only frames.

    Args:
        path: The file of the agent, or the folder of ``envcraft train``.

    Raises:
        OSError: The file cannot be read.
    """

    summary = "a trained policy, which sees only frames"

    def __init__(self, path: Path) -> None:
        self.name, self._path = f"checkpoint:{path}", path
        self.version = sha256(agent_file(path).read_bytes()).hexdigest()
        self._policies: dict[EnvSpec, AgentPolicy] = {}

    def play(self, subject: Subject, number: int) -> Trace:
        from envcraft_dqn.network import one_thread

        name = subject.env_class or "the environment"
        try:
            with contextlib.closing(SubjectEnv(name, subject)) as env:
                spec = spec_of_spaces(env.observation_space, env.action_space, name)
                policy = self._policy(spec)
                policy.restart(subject.episode_seed(number))
                # The trace has the failure.
                with one_thread(), contextlib.suppress(EnvironmentFailed):
                    frame, _ = env.reset(seed=subject.episode_seed(number))
                    for _ in range(subject.length):
                        action = spec.split(policy.act(np.asarray(frame)[None]))[0]
                        frame, _, terminated, truncated, _ = env.step(action)
                        if terminated or truncated:
                            break
                return env.finish()
        except UsageError as error:
            raise Skip(str(error)) from None

    def _policy(self, spec: EnvSpec) -> AgentPolicy:
        if spec not in self._policies:
            self._policies[spec] = AgentPolicy(self._path, spec, 0, 0.0, "cpu")
        return self._policies[spec]
