"""A short training on one subject in its sandbox, and what the agent comes to beside others. Imports torch."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from envcraft.check import Skip
from envcraft.subject import Subject
from envcraft.using.sandboxed import SubjectEnv
from envcraft_dqn.evaluation import AgentPlayer, Evaluation, NoopPlayer, Player, RandomPlayer, evaluate
from envcraft_dqn.learner import train
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface

#: Random actions of the agent that is tested, as Mnih et al. 2015 (doi:10.1038/nature14236) have them: a greedy one may
#: do the same thing for ever.
_EPSILON = 0.05


class _Within(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Begins no episode once the subject's have taken all the time that they may."""

    def __init__(self, env: SubjectEnv, subject: Subject) -> None:
        super().__init__(env)
        self._subject = subject

    def reset(self, **more: Any) -> Any:
        if self._subject.overrun:
            raise Skip(f"its episodes took {self._subject.seconds:.0f} s together, before the training was done")
        return super().reset(**more)


def compare(subject: Subject, env: SubjectEnv, steps: int, episodes: int) -> dict[str, Evaluation]:
    """What an agent comes to after `steps` steps of training, and chance and, where the contract knows it, doing
    nothing: each in `episodes` episodes of the same seeds in the same order, cut at the subject's length.

    Raises UsageError where an agent cannot learn from frames, EnvironmentFailed, Skip.
    """

    def open_vector(names: Sequence[str]) -> Any:
        return SyncVectorEnv([lambda: TimeLimit(_Within(env, subject), subject.length)])

    settings = Settings(
        size="tiny",
        seed=subject.seed,
        steps=steps,
        lanes=1,
        cycle=steps,
        learning_rate=1e-3,
        gamma=0.95,
        target_every=100,
        epsilon_share=0.5,
        capacity=min(steps, 20_000) + 1_000,
        starts=200,
        precision="fp32",
        device="cpu",
    )
    surface = Surface.of(open_vector, "the environment")
    with one_thread(), tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        agent = train(settings, [""], open_vector, Path(folder), every=float("inf"))
        players: dict[str, Player] = {
            "the agent": AgentPlayer(agent, surface, subject.seed, _EPSILON, "cpu"),
            "random play": RandomPlayer(surface, subject.seed),
        }
        if (noop := subject.contract.noop) is not None:
            players["doing nothing"] = NoopPlayer(int(surface.join(np.array([noop]))[0]))
        found = {}
        for name, player in players.items():
            [found[name]] = evaluate([""], open_vector, player, episodes, lanes=1, seed=subject.seed)
    return found


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """The cores are the subjects' that are judged side by side; and how many there are shall decide no verdict."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
