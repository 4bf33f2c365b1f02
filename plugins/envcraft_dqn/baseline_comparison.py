"""Train an agent on one subject in its sandbox, and compare it with baselines. Imports torch."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from envcraft.environments.sandboxed import SubjectEnv
from envcraft.judging.subject import Subject
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.evaluation import Evaluation, evaluate
from envcraft_dqn.network import one_thread
from envcraft_dqn.policies import AgentPolicy, NoopPolicy, Policy, RandomPolicy
from envcraft_dqn.settings import Settings
from envcraft_dqn.trainer import train

#: The rate of random actions in the evaluation of the agent (Mnih et al. 2015, doi:10.1038/nature14236). A greedy agent
#: may repeat an action for ever.
_EPSILON = 0.05


class _TimeBudget(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Starts no episode after the time limit of the subject."""

    def __init__(self, env: SubjectEnv, subject: Subject) -> None:
        super().__init__(env)
        self._subject = subject

    def reset(self, **more: Any) -> Any:
        if self._subject.out_of_time:
            raise self._subject.time_limit.skip()
        return super().reset(**more)


def compare(subject: Subject, env: SubjectEnv, steps: int, episodes: int) -> dict[str, Evaluation]:
    """Compare a trained agent with random play and, if the contract has a no-op, with doing nothing.

    Args:
        subject: The subject.
        env: The environment of the subject.
        steps: The steps of training.
        episodes: The episodes of each policy. All have the same seeds in the same order, and the length limit of the
            subject.

    Returns:
        The results of "the agent", "random play" and "doing nothing".

    Raises:
        UsageError: An agent cannot learn from these observations.
        EnvironmentFailed: The environment fails.
        Skip: The time limit of the subject is over.
    """

    def open_vector(names: Sequence[str]) -> Any:
        return SyncVectorEnv([lambda: TimeLimit(_TimeBudget(env, subject), subject.length)])

    settings = Settings(
        size="tiny",
        seed=subject.seed,
        steps=steps,
        num_envs=1,
        cycle=steps,
        learning_rate=1e-3,
        gamma=0.95,
        target_every=100,
        epsilon_share=0.5,
        capacity=min(steps, 20_000) + 1_000,
        starts=200,
        precision="fp32",
        device="cpu",
        value_rescaling=False,
    )
    spec = EnvSpec.of(open_vector, "the environment")
    with one_thread(), tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        agent = train(settings, [""], open_vector, Path(folder), every=float("inf"))
        policies: dict[str, Policy] = {
            "the agent": AgentPolicy(agent, spec, subject.seed, _EPSILON, "cpu"),
            "random play": RandomPolicy(spec, subject.seed),
        }
        if (noop := subject.contract.noop) is not None:
            policies["doing nothing"] = NoopPolicy(int(spec.join(np.array([noop]))[0]))
        results = {}
        for name, policy in policies.items():
            [results[name]] = evaluate([""], open_vector, policy, episodes, num_envs=1, seed=subject.seed)
    return results
