"""Trained policies as players of environments in the sandbox."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from envcraft_dqn.env_spec import EnvSpec

from envcraft.contracts.lookup import contract_named
from envcraft.demonstrations.player import loaded_player
from envcraft.errors import Skip, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target
from evaluation.explorer import GAME

#: The joint action [4, 0, 0].
RIGHT = 16


def agent(folder: Path, shape: tuple[int, ...]) -> str:
    """Write an agent that always goes right, and return its name as a player."""
    import torch
    from envcraft_dqn.checkpoint import save_agent
    from envcraft_dqn.network import Network

    network = Network(shape, (5, 2, 2), "tiny")
    with torch.no_grad():
        network.advantage.weight.zero_()
        network.advantage.bias.copy_(torch.eye(20)[RIGHT])
    save_agent(folder / "agent.safetensors", network, EnvSpec(shape, (5, 2, 2)))
    return f"checkpoint:{folder}"


def test_a_trained_policy_plays_in_the_sandbox(tmp_path: Path) -> None:
    player = loaded_player(agent(tmp_path, (84, 84, 3)))
    target = Target("walk.py", GAME.format(words="", crash=8).encode())
    with (
        closing(driver_named("process")) as driver,
        Subject(target, contract_named("arcade"), WorkerPool(driver).lease(), BUDGETS["quick"]) as subject,
    ):
        trace = player.play(subject, 0)
        assert trace.actions == [[4, 0, 0]] * 8
        assert trace.rollout.seed == subject.episode_seed(0)
        assert trace.fault is not None
        (tmp_path / "other").mkdir()
        with pytest.raises(Skip, match="was trained on"):
            loaded_player(agent(tmp_path / "other", (16, 16, 3))).play(subject, 0)


def test_names_that_load_nothing_are_refused(tmp_path: Path) -> None:
    for name, words in (
        (f"checkpoint:{tmp_path}", "is not an agent of `envcraft train`: No such file"),
        ("checkpoint:", "write it as checkpoint:PATH"),
        ("weights:run", "there is no player weights:run"),
    ):
        with pytest.raises(UsageError, match=words):
            loaded_player(name)
