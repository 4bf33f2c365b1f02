"""The learner on a GPU: it computes what it computes on the CPU, and runs move between the two."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from envcraft_dqn.frames import make_store
from envcraft_dqn.policies import AgentPolicy
from envcraft_dqn.settings import Settings

from envcraft.errors import UsageError

from .conftest import open_corridors
from .test_learner import SMALL, Scripted, batch, returns

SHAPE = (84, 84, 3)
#: A run with all kinds of work of the learner that ends after seconds.
SETTINGS = Settings(
    size="tiny",
    steps=200,
    pretrain_updates=40,
    num_envs=2,
    cycle=50,
    segment=25,
    target_every=20,
    capacity=500,
    demonstrations=50,
)


@pytest.fixture(autouse=True)
def needs_gpu() -> None:
    import torch

    if not torch.cuda.is_available():
        pytest.skip("needs a GPU that torch can use")


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch TF32 off, in which torch computes convolutions on GPUs."""
    import torch

    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("objective", ["dqn", "bc", "dqfd"])
@pytest.mark.parametrize("size", ["tiny", "patches", "cells"])
def test_losses_are_those_of_the_cpu(size: str, objective: str) -> None:
    from envcraft_dqn.learner import Learner

    losses = []
    for device in ("cpu", "cuda"):
        learner = Learner(Settings(size=size, objective=objective, steps=0, precision="fp32", device=device), SMALL)
        losses.append([learner.update(batch())[1] for _ in range(50)])
    # The order of sums differs, and each update amplifies the difference.
    assert losses[1][:10] == pytest.approx(losses[0][:10], rel=1e-4)
    assert losses[1] == pytest.approx(losses[0], rel=2e-2)
    assert losses[0][-1] < losses[0][0]


@pytest.mark.parametrize("kind", ["shift", "colour", "both", "mixed"])
def test_frames_are_augmented_as_on_the_cpu(kind: str) -> None:
    import torch
    from envcraft_dqn.augmentation import augmented

    frames = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (16, *SHAPE), np.uint8))
    here, there = (
        augmented(frames.to(device), kind, torch.Generator().manual_seed(0)).cpu().int() for device in ("cpu", "cuda")
    )
    assert (here != frames).any()
    # A sum in another order may round to the next byte.
    assert (here - there).abs().max() <= 1
    assert (here != there).float().mean() < 0.01


def test_restored_learner_continues() -> None:
    from envcraft_dqn.learner import Learner

    learner, again, elsewhere = (
        Learner(Settings(size="tiny", seed=seed, device=device, precision="fp32"), SMALL)
        for seed, device in ((1, "cuda"), (2, "cuda"), (3, "cpu"))
    )
    for _ in range(3):
        learner.update(batch())
    for other in (again, elsewhere):
        other.restore({name: value.cpu().clone() for name, value in learner.state().items()})
    assert {value.device.type for state in again.optimiser.state.values() for value in state.values()} == {"cuda"}
    for _ in range(2):
        loss = learner.update(batch())[1]
        assert again.update(batch())[1] == pytest.approx(loss, rel=1e-4)
        assert elsewhere.update(batch())[1] == pytest.approx(loss, rel=1e-2)


def test_initial_weights_keep_the_generators_of_the_gpu() -> None:
    import torch
    from envcraft_dqn.network import seeded_weights

    before = torch.cuda.get_rng_state()
    with seeded_weights(3):
        torch.rand(1)
    assert (torch.cuda.get_rng_state() == before).all()


@pytest.mark.parametrize("replay", ["packed", "device"])
def test_run_moves_between_gpu_and_cpu(replay: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch
    from envcraft_dqn.trainer import train

    settings = msgspec.structs.replace(SETTINGS, replay=replay)
    names = ["left", "right"]
    train(settings, names, open_corridors, tmp_path, Scripted(), every=0.0)
    state = tmp_path / "checkpoint" / "state.json"
    precision = json.loads(state.read_text())["numbers"]["precision"]
    assert precision == ("bf16" if torch.cuda.get_device_capability()[0] >= 8 else "fp32")
    # On the CPU, then on the GPU again.
    for steps, there in ((300, False), (400, True)):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        longer = msgspec.structs.replace(settings, steps=steps)
        agent = train(longer, names, open_corridors, tmp_path, Scripted(), every=0.0)
        numbers = json.loads(state.read_text())["numbers"]
        assert steps <= numbers["steps"] < steps + 2
        assert numbers["precision"] == precision
    assert all(np.isfinite(returns(agent, names, SMALL, open_corridors)))


@pytest.mark.usefixtures("exact")
def test_agent_acts_as_on_the_cpu(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    settings = msgspec.structs.replace(SETTINGS, device="cuda", steps=0, pretrain_updates=200, replay="device")
    agent = train(settings, ["left", "right"], open_corridors, tmp_path, Scripted())
    frames = np.random.default_rng(0).integers(0, 256, (500, *SMALL.shape), np.uint8)
    here, there = (AgentPolicy(agent, SMALL, 0, 0.0, device).act(frames) for device in ("cpu", "cuda"))
    assert (here == there).mean() > 0.99


def test_frames_beyond_two_gigabytes_are_found(tmp_path: Path) -> None:
    size = 2**31 // 21168 + 100
    store: Any = make_store("device", size, SHAPE, tmp_path, "cuda")
    frames = np.random.default_rng(0).integers(0, 256, (4, *SHAPE), np.uint8)
    slots = np.array([size - 1, 0, size - 50, 7])
    store.write(slots, frames)
    assert (store.read(slots).cpu().numpy() == frames).all()
    assert (store.dump(size - 1, size)["frames"][0] == frames[0]).all()


def test_frames_that_the_gpu_cannot_hold_are_reported(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--replay device needs 21,168\.0 GB of free memory on cuda"):
        make_store("device", 10**9, SHAPE, tmp_path, "cuda")
