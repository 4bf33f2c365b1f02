"""The learner: what an update computes, and that it learns to play."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.evaluation import AgentPlayer, Played, RandomPlayer, evaluate
from envcraft_dqn.replay import Batch
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface
from gymnasium.spaces import MultiDiscrete
from gymnasium.vector import SyncVectorEnv

from envcraft.errors import UsageError

from .conftest import Corridor, open_corridors

PAD = Surface((84, 84, 3), (5, 2, 2))
SMALL = Surface((16, 16, 3), (5, 2, 2))


def test_the_reference_network_has_about_twelve_million_parameters() -> None:
    from envcraft_dqn.network import Network

    network = Network(PAD.shape, PAD.choices, "reference")
    assert network.parameter_count == 12_163_355
    assert Network(PAD.shape, PAD.choices, "small").parameter_count < 2_000_000


def test_a_branching_head_adds_up_its_parts() -> None:
    import torch
    from envcraft_dqn.network import Network

    network = Network(SMALL.shape, SMALL.choices, "tiny", "branching")
    frames = torch.randint(0, 256, (3, *SMALL.shape), dtype=torch.uint8)
    values = network(frames)
    assert values.shape == (3, 20)
    table = values.reshape(3, 5, 2, 2)
    # What the third part adds is the same whatever the others are.
    assert torch.allclose((table[..., 1] - table[..., 0]).std((1, 2)), torch.zeros(3), atol=1e-5)
    joint = torch.tensor([7])
    assert SMALL.split(joint.numpy()).tolist() == [[1, 1, 1]]
    assert SMALL.join(np.array([[1, 1, 1]])).tolist() == [7]


@pytest.mark.parametrize("head", ["joint", "branching"])
def test_the_best_action_is_that_of_the_highest_value(head: str) -> None:
    import torch
    from envcraft_dqn.network import Network, weights_from

    with weights_from(3):
        network = Network(SMALL.shape, SMALL.choices, "tiny", head)
    # So large that actions differ: at first, biases outweigh what is seen.
    pixels = 1_000 * torch.randn((64, 3, 16, 16), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        values, best = network.values(pixels), network.best(pixels)
    assert best.tolist() == values.argmax(1).tolist()
    assert len(set(best.tolist())) > 1


def batch(count: int = 8) -> Batch:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2 * count, *SMALL.shape), np.uint8)
    return Batch(
        np.arange(count),
        frames[:count],
        frames[count:],
        rng.integers(0, 20, count),
        rng.normal(size=count).astype(np.float32),
        np.where(np.arange(count) % 2, 0.97, 0.0).astype(np.float32),
        rng.random(count).astype(np.float32),
    )


def test_the_errors_are_those_of_double_q_learning() -> None:
    import torch
    from envcraft_dqn.learner import Learner

    learner = Learner(Settings(size="tiny", device="cpu", precision="fp32"), SMALL)
    other = Learner(Settings(size="tiny", device="cpu", seed=1), SMALL)
    learner.target.load_state_dict(other.network.state_dict())
    given = batch()
    with torch.no_grad():
        online = learner.network(torch.from_numpy(given.next_frames)).numpy()
        target = learner.target(torch.from_numpy(given.next_frames)).numpy()
        now = learner.network(torch.from_numpy(given.frames)).numpy()
    assert (online.argmax(1) != target.argmax(1)).any()
    rows = np.arange(8)
    wanted = given.returns + given.discounts * target[rows, online.argmax(1)]
    errors = wanted - now[rows, given.actions]
    huber = np.where(np.abs(errors) < 1, errors**2 / 2, np.abs(errors) - 0.5)
    found, loss = learner.update(given)
    assert found == pytest.approx(errors, abs=1e-5)
    assert loss == pytest.approx(float((given.weights * huber).mean()), abs=1e-5)


def test_a_learner_that_is_put_back_goes_on_bit_by_bit() -> None:
    from envcraft_dqn.learner import Learner

    learner, again = (Learner(Settings(size="tiny", seed=seed, device="cpu"), SMALL) for seed in (1, 2))
    for _ in range(3):
        learner.update(batch())
    again.restore({name: value.clone() for name, value in learner.state().items()})
    for _ in range(2):
        assert learner.update(batch())[1] == again.update(batch())[1]
    assert all((learner.state()[name] == value).all() for name, value in again.state().items())


def test_what_another_network_left_is_refused() -> None:
    from envcraft_dqn.learner import Learner

    settings = [Settings(size="tiny", head=head, device="cpu") for head in ("branching", "joint")]
    branching, joint = (Learner(one, SMALL) for one in settings)
    with pytest.raises(UsageError, match="train in another folder"):
        joint.restore(branching.state())


def test_every_environment_has_its_turn_in_each_cycle() -> None:
    from envcraft_dqn.learner import schedule

    settings = Settings(lanes=4, cycle=25, leg=10)
    names = [f"e{number}" for number in range(8)]
    legs = list(islice(schedule(names, settings), 12))
    assert [leg.steps for leg in legs[:6]] == [10, 10, 5, 10, 10, 5]
    for cycle in (legs[:6], legs[6:]):
        assert sorted({name for leg in cycle for name in leg.names}) == names
    assert [leg.names for leg in legs[:6]] != [leg.names for leg in legs[6:]]
    seeds = [seed for leg in legs for seed in leg.seeds]
    assert len(set(seeds)) == len(seeds)
    assert list(islice(schedule(names, settings), 12)) == legs


class Scripted:
    """Demonstrations of somebody who walks to the end, and every other step anywhere: TD errors alone say nothing of
    actions that nobody takes.
    """

    def episodes(self, name: str) -> Iterator[Episode]:
        env, rng = Corridor(name == "left"), np.random.default_rng(0)
        for seed in range(1000):
            frame, _ = env.reset(seed=seed)
            frames, actions, rewards, won, truncated = [frame], [], [], False, False
            while not (won or truncated):
                action = rng.integers([5, 2, 2])
                if rng.random() < 0.5:
                    action[0] = 0 if name == "left" else 4
                frame, reward, won, truncated, _ = env.step(action)
                frames.append(frame)
                actions.append(action)
                rewards.append(reward)
            yield Episode(np.stack(frames), np.array(actions), np.array(rewards), won)


def returns(agent: Path, names: list[str], surface: Surface, open_vector: Any) -> list[float]:
    """The mean return in each environment."""
    player = AgentPlayer(agent, surface, 0, 0.0, "cpu")
    return [one.total.mean for one in evaluate(names, open_vector, player, 100, 32)]


def test_demonstrations_alone_teach_a_corridor(tmp_path: Path) -> None:
    from envcraft_dqn.learner import train

    settings = Settings(size="tiny", device="cpu", steps=0, pretrain_updates=400, target_every=50, learning_rate=1e-3)
    agent = train(settings, ["right"], open_corridors, tmp_path, Scripted())
    assert (tmp_path / "pretrained.safetensors").read_bytes() == agent.read_bytes()
    assert json.loads((tmp_path / "checkpoint" / "state.json").read_text())["numbers"]["updates"] == 400
    assert returns(agent, ["right"], SMALL, open_corridors)[0] > 0.9


def test_what_cannot_be_trained_is_told(tmp_path: Path) -> None:
    from envcraft_dqn.learner import train

    with pytest.raises(UsageError, match="need demonstrations"):
        train(Settings(pretrain_updates=5), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="there is no size 'huge'; there are tiny"):
        train(Settings(size="huge"), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="too small for 16 environments"):
        train(Settings(capacity=100), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="no room for all demonstrations"):
        train(Settings(capacity=200, lanes=2, device="cpu"), ["right"], open_corridors, tmp_path, Scripted())
    with pytest.raises(UsageError, match="--device nonsense cannot be used here"):
        train(Settings(device="nonsense"), ["right"], open_corridors, tmp_path)


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"steps": -1},
        {"gamma": math.nan},
        {"epsilon_last": -0.1},
        {"beta": 1.1},
        {"alpha": -1.0},
        {"demonstration_share": 1.01},
        {"learning_rate": math.inf},
    ],
)
def test_settings_out_of_bounds_are_told(wrong: dict[str, Any]) -> None:
    [name] = wrong
    with pytest.raises(UsageError, match=f"{name} is .*; it must "):
        Settings(**wrong).check()


def test_more_actions_than_a_replay_tells_apart_are_refused(tmp_path: Path) -> None:
    from envcraft_dqn.learner import train

    def opened(names: Sequence[str]) -> Any:
        vector = open_corridors(names)
        vector.single_action_space = MultiDiscrete([2] * 15)
        return vector

    with pytest.raises(UsageError, match="32,768 combinations of its buttons, and an agent learns 32,767"):
        train(Settings(size="tiny", device="cpu"), ["right"], opened, tmp_path)


def test_epsilon_falls_and_beta_rises() -> None:
    settings = Settings(steps=1000, pretrain_updates=250, epsilon_share=0.5)
    assert [settings.epsilon(steps) for steps in (0, 250, 500, 1000)] == pytest.approx([1.0, 0.55, 0.1, 0.1])
    assert [settings.annealed(updates) for updates in (0, 250, 500)] == pytest.approx([0.4, 0.7, 1.0])
    assert math.isclose(Settings(steps=0).epsilon(0), 1.0)


@pytest.mark.parametrize(("lanes", "starts"), [(2, 0), (64, 50)])
def test_nothing_is_learnt_before_something_can_be_drawn(tmp_path: Path, lanes: int, starts: int) -> None:
    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.learner import train

    settings = Settings(size="tiny", device="cpu", steps=300, lanes=lanes, leg=20, starts=starts, capacity=2_000)
    network, _ = load_agent(train(settings, ["right"], open_corridors, tmp_path))
    assert all(parameter.isfinite().all() for parameter in network.parameters())
    numbers = json.loads((tmp_path / "checkpoint" / "state.json").read_text())["numbers"]
    assert numbers["updates"] == (numbers["steps"] - starts) // settings.train_every


class Infinite(Corridor):
    """Pays more than there is after some episodes."""

    def step(self, action: Any) -> Any:
        frame, reward, *rest = super().step(action)
        return frame, reward if self.np_random.random() < 0.99 else float("inf"), *rest


def test_a_loss_that_is_no_number_ends_the_run(tmp_path: Path) -> None:
    from envcraft_dqn.learner import Diverged, train

    settings = Settings(size="tiny", device="cpu", steps=2_000, lanes=2, leg=20, starts=0, capacity=2_000)
    with pytest.raises(Diverged, match=r"the loss of update [\d,]+ is inf.* are all rewards finite"):
        train(settings, ["right"], lambda names: SyncVectorEnv([Infinite] * len(names)), tmp_path)
    assert not (tmp_path / "agent.safetensors").exists()


def test_an_agent_of_no_numbers_is_refused(tmp_path: Path) -> None:
    import torch
    from envcraft_dqn.checkpoint import load_agent, save_agent
    from envcraft_dqn.network import Network

    network = Network(SMALL.shape, SMALL.choices, "tiny")
    with torch.no_grad():
        next(network.parameters()).view(-1)[0] = float("nan")
    with pytest.raises(UsageError, match="has weights that are no finite numbers"):
        load_agent(save_agent(tmp_path / "agent.safetensors", network, SMALL))


def open_overwriting(names: Sequence[str]) -> Any:
    """Corridors whose frames lie where the next step writes its own."""
    return SyncVectorEnv([partial(Corridor, name == "left") for name in names], copy=False)


def test_frames_are_kept_before_a_vector_overwrites_them(tmp_path: Path) -> None:
    from envcraft_dqn.learner import train

    short = Settings(size="tiny", device="cpu", steps=400, lanes=2, leg=50, starts=50, capacity=500)
    agents, demonstrated = [], []
    for name, opened in (("copies", open_corridors), ("overwrites", open_overwriting)):
        agents.append(train(short, ["left", "right"], opened, tmp_path / name).read_bytes())
        demonstrated.append(list(Played(opened, RandomPlayer(SMALL, 0), 30).episodes("right")))
    assert agents[0] == agents[1]
    assert all((one.frames == other.frames).all() for one, other in zip(*demonstrated, strict=True))
