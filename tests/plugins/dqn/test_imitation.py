"""Objectives that imitate a demonstrator, and the augmentation of frames."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from envcraft_dqn.settings import Settings
from gymnasium.vector import SyncVectorEnv
from numpy.typing import NDArray

from envcraft.errors import UsageError

from .conftest import Corridor, open_corridors
from .test_learner import SMALL, Scripted, batch, returns

NAMES = ["left", "right"]


class Walker:
    """Advises to walk to the end, and knows the way in both corridors."""

    def __init__(self) -> None:
        self.labelled = 0

    def advise(self, episodes: Sequence[tuple[str, int, NDArray[np.int64]]]) -> list[NDArray[np.int64] | None]:
        labels: list[NDArray[np.int64] | None] = []
        for name, seed, actions in episodes:
            env = Corridor(name == "left")
            env.reset(seed=seed)
            # The actions belong to one episode from this seed.
            ends = [bool(flags[0] or flags[1]) for _, _, *flags, _ in map(env.step, actions)]
            assert not any(ends[:-1])
            assert ends[-1]
            self.labelled += len(actions)
            labels.append(np.tile([0 if name == "left" else 4, 0, 0], (len(actions), 1)))
        return labels


def test_dataset_aggregation_learns_from_labels_of_its_own_states(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    settings = Settings(
        size="tiny",
        device="cpu",
        objective="dagger",
        steps=600,
        num_envs=4,
        cycle=20,
        learning_rate=3e-3,
        train_every=3,
        augment="shift",
        capacity=2_000,
    )
    walker = Walker()
    agent = train(settings, NAMES, open_corridors, tmp_path, adviser=walker)
    assert 600 <= walker.labelled < 640
    assert min(returns(agent, NAMES, SMALL, open_corridors)) > 0.9


class Advising(SyncVectorEnv):
    """Corridors that advise: to walk to the end, and sometimes to wait."""

    def advise(self, wanted: NDArray[np.bool_]) -> NDArray[np.float32]:
        corridors: Any = self.envs
        probabilities = np.zeros((self.num_envs, 20), np.float32)
        for index in np.flatnonzero(wanted):
            probabilities[index, 0 if corridors[index]._flip else 16] = 0.75
            probabilities[index, 8] = 0.25
        return probabilities


@pytest.mark.parametrize("lead", [0.0, 0.5])
def test_dataset_aggregation_learns_the_probabilities_of_the_advice(lead: float, tmp_path: Path) -> None:
    import torch
    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.trainer import train

    def open_vector(names: Sequence[str]) -> Any:
        return Advising([partial(Corridor, name == "left") for name in names])

    settings = Settings(
        size="tiny",
        device="cpu",
        objective="dagger",
        lead=lead,
        steps=900,
        num_envs=4,
        cycle=20,
        learning_rate=3e-3,
        train_every=2,
        capacity=2_000,
    )
    agent = train(settings, NAMES, open_vector, tmp_path)
    assert min(returns(agent, NAMES, SMALL, open_corridors)) > 0.9
    frame = torch.from_numpy(Corridor(False).reset(seed=0)[0][None])
    learned = load_agent(agent)[0](frame).softmax(1)[0].detach().numpy()
    assert learned[16] == pytest.approx(0.75, abs=0.15)
    assert learned[8] == pytest.approx(0.25, abs=0.15)


def test_behaviour_cloning_and_fine_tuning_from_its_agent(tmp_path: Path) -> None:
    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.trainer import train

    common: dict[str, Any] = {"size": "tiny", "device": "cpu", "learning_rate": 3e-3, "target_every": 50}
    cloning = Settings(objective="bc", steps=0, pretrain_updates=150, **common)
    cloned = train(cloning, ["right"], open_corridors, tmp_path / "bc", Scripted())
    assert returns(cloned, ["right"], SMALL, open_corridors)[0] > 0.9
    tuning = Settings(objective="dqfd", steps=40, num_envs=2, cycle=20, starts=1_000, **common)
    tuned = train(tuning, ["right"], open_corridors, tmp_path / "dqfd", Scripted(), initial=cloned)
    # There was no update, so that the weights are still those of the first agent.
    theirs, ours = (load_agent(one)[0].state_dict() for one in (cloned, tuned))
    assert all((theirs[name] == ours[name]).all() for name in theirs)
    with pytest.raises(UsageError, match=r"a run with other initial \(.*, not random\); choose another --output"):
        train(tuning, ["right"], open_corridors, tmp_path / "dqfd", Scripted())


def test_large_margin_loss_is_that_of_hester() -> None:
    import torch
    from envcraft_dqn.learner import Learner, large_margin

    values = torch.tensor([[1.0, 0.5, 0.9], [3.0, 0.0, 0.0]])
    assert large_margin(values, torch.tensor([0, 1]), 0.8).tolist() == pytest.approx([0.7, 3.8])
    assert large_margin(values, torch.tensor([0, 0]), 0.1)[0].item() == 0
    given = batch()
    found = {}
    for objective in ("dqn", "bc", "dqfd"):
        learner = Learner(Settings(size="tiny", device="cpu", objective=objective, steps=0, precision="fp32"), SMALL)
        with torch.no_grad():
            now = learner.network(torch.from_numpy(given.frames)).numpy()
        errors, loss = learner.update(given)
        found[objective] = loss
        rows = np.arange(len(given.labels))
        margins = now + 0.8
        margins[rows, given.labels] -= 0.8
        wanted = margins.max(1) - now[rows, given.labels]
        if objective == "bc":
            entropies = np.log(np.exp(now).sum(1)) - now[rows, given.labels]
            assert errors == pytest.approx(entropies * (given.labels >= 0), abs=1e-5)
    labelled = (given.weights * wanted * (given.labels >= 0)).mean()
    assert found["dqfd"] - found["dqn"] == pytest.approx(float(labelled), rel=0.05)


def test_augmentation_keeps_the_picture_but_for_shift_and_colour() -> None:
    import torch
    from envcraft_dqn.augmentation import augmented

    frames = torch.zeros((64, 16, 16, 3), dtype=torch.uint8)
    frames[:, 6:9, 6:9] = torch.tensor([200, 100, 0], dtype=torch.uint8)
    generator = torch.Generator().manual_seed(0)
    shifted = augmented(frames, "shift", generator)
    assert (shifted.sum((1, 2)) == frames.sum((1, 2))).all()
    assert len({tuple(one.nonzero()[0].tolist()) for one in shifted}) > 30
    coloured = augmented(frames, "colour", generator)
    # The shape stays, and two of the three channels are not black.
    assert ((coloured.sum(3) > 0) == (frames.sum(3) > 0)).all()
    assert ((coloured[:, 7, 7] > 0).sum(1) == 2).all()
    assert len({tuple(one.tolist()) for one in coloured[:, 7, 7]}) > 50
    assert augmented(frames, "none", generator) is frames


def test_mixed_colours_keep_shapes_and_forget_colours() -> None:
    import torch
    from envcraft_dqn.augmentation import augmented

    frames = torch.full((64, 16, 16, 3), 40, dtype=torch.uint8)
    frames[:, 6:9, 6:9] = torch.tensor([200, 100, 0], dtype=torch.uint8)
    mixed = augmented(frames, "mixed", torch.Generator().manual_seed(0)).int()
    inside, outside = mixed[:, 6:9, 6:9].flatten(1, 2), mixed[:, :6].flatten(1, 2)
    assert (inside == inside[:, :1]).all()
    assert (outside == outside[:, :1]).all()
    steps = inside[:, 0] - outside[:, 0]
    # The block is brighter than the ground about as often as darker, and seldom as bright.
    assert 0.35 < (steps > 0).float().mean() < 0.65
    assert (steps == 0).float().mean() < 0.05


def test_agent_draws_actions_at_its_temperature(tmp_path: Path) -> None:
    import torch
    from envcraft_dqn.checkpoint import load_agent, save_agent
    from envcraft_dqn.learner import Learner
    from envcraft_dqn.policies import AgentPolicy

    settings = Settings(size="tiny", device="cpu", objective="bc", steps=0, temperature=0.5, precision="fp32")
    learner = Learner(settings, SMALL)
    network = learner.network
    values = torch.zeros((4_000, 20))
    values[:, 3] = 1.0
    drawn = np.bincount(network.choose(values, np.random.default_rng(0)), minlength=20) / 4_000
    # The softmax of a value at the temperature.
    chances = np.exp(values[0].numpy() / 0.5)
    assert drawn == pytest.approx(chances / chances.sum(), abs=0.03)
    with torch.no_grad():
        network.advantage.weight.mul_(5)
    file = save_agent(tmp_path / "agent.safetensors", network, SMALL)
    assert load_agent(file)[0].temperature == 0.5
    frames = np.random.default_rng(0).integers(0, 256, (200, *SMALL.shape), np.uint8)
    policy = AgentPolicy(file, SMALL, 1, 0.0, "cpu")
    first, second = policy.act(frames), policy.act(frames)
    policy.restart(1)
    assert (first != second).any()
    assert (policy.act(frames) == first).all()
    greedy, leads = learner.decide(frames)
    assert (learner.act(frames) == greedy).all()
    sampled, same = learner.decide(frames, np.random.default_rng(0))
    assert (sampled != greedy).any()
    assert (leads == same).all()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (Settings(objective="bc", pretrain_updates=5), "makes no online steps: use --steps 0, not 1,000,000"),
        (Settings(objective="dagger"), "needs a player that advises: name it by --demos"),
        (Settings(objective="dqfd"), "--objective dqfd needs demonstrations"),
        (Settings(temperature=1.0), "--objective dqn learns values, not probabilities: use temperature 0"),
        (Settings(objective="cloning"), "unknown objective 'cloning'; choose from dqn, bc, dagger, dqfd"),
    ],
)
def test_incompatible_objectives_are_reported(settings: Settings, words: str, tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    with pytest.raises(UsageError, match=words):
        train(settings, ["right"], open_corridors, tmp_path)
