"""The update of the learner, and the training loop."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from envcraft_dqn.demo_sources import PolicyDemonstrations
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.evaluation import evaluate
from envcraft_dqn.policies import AgentPolicy, RandomPolicy
from envcraft_dqn.replay import Batch
from envcraft_dqn.settings import Settings
from gymnasium.spaces import MultiDiscrete
from gymnasium.vector import SyncVectorEnv

from envcraft.errors import UsageError

from .conftest import Corridor, open_corridors

PAD = EnvSpec((84, 84, 3), (5, 2, 2))
SMALL = EnvSpec((16, 16, 3), (5, 2, 2))


def test_reference_network_has_twelve_million_parameters() -> None:
    from envcraft_dqn.network import Network

    network = Network(PAD.shape, PAD.choices, "reference")
    assert network.parameter_count == 12_163_355
    assert Network(PAD.shape, PAD.choices, "small").parameter_count < 2_000_000


def test_branching_head_adds_components() -> None:
    import torch
    from envcraft_dqn.network import Network

    network = Network(SMALL.shape, SMALL.choices, "tiny", "branching")
    frames = torch.randint(0, 256, (3, *SMALL.shape), dtype=torch.uint8)
    values = network(frames)
    assert values.shape == (3, 20)
    table = values.reshape(3, 5, 2, 2)
    # The advantage of the third component does not depend on the others.
    assert torch.allclose((table[..., 1] - table[..., 0]).std((1, 2)), torch.zeros(3), atol=1e-5)
    joint = torch.tensor([7])
    assert SMALL.split(joint.numpy()).tolist() == [[1, 1, 1]]
    assert SMALL.join(np.array([[1, 1, 1]])).tolist() == [7]


@pytest.mark.parametrize("head", ["joint", "branching"])
def test_greedy_action_has_the_highest_value(head: str) -> None:
    import torch
    from envcraft_dqn.network import Network, seeded_weights

    with seeded_weights(3):
        network = Network(SMALL.shape, SMALL.choices, "tiny", head)
    # Large inputs outweigh the biases, so that greedy actions differ.
    pixels = 1_000 * torch.randn((64, 3, 16, 16), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        values, best = network.values(pixels), network.greedy(pixels)
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
        rng.integers(-1, 20, count),
        np.ones(count, np.float32),
        np.zeros((count, 0), np.float32),
    )


def test_errors_match_double_q_learning() -> None:
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
    # Pohlen et al. 2018, in 64-bit floats.
    scaled = target[rows, online.argmax(1)].astype(float)
    values = np.sign(scaled) * ((((1 + 0.04 * (np.abs(scaled) + 1.01)) ** 0.5 - 1) / 0.02) ** 2 - 1)
    wanted = given.returns + given.discounts * values
    wanted = np.sign(wanted) * ((np.abs(wanted) + 1) ** 0.5 - 1) + 0.01 * wanted
    errors = wanted - now[rows, given.actions]
    huber = np.where(np.abs(errors) < 1, errors**2 / 2, np.abs(errors) - 0.5)
    found, loss = learner.update(given)
    assert found == pytest.approx(errors, abs=1e-5)
    assert loss == pytest.approx(float((given.weights * huber).mean()), abs=1e-5)


def test_rescaling_has_an_inverse() -> None:
    import torch
    from envcraft_dqn.learner import rescale, unrescale

    values = torch.tensor([-1000.0, -3.0, -0.01, 0.0, 0.5, 8.0, 1e5])
    assert torch.allclose(unrescale(rescale(values)), values, rtol=1e-3, atol=1e-4)
    assert rescale(torch.tensor(3.0)).item() == pytest.approx(1.03)


def test_errors_have_full_precision_under_bf16() -> None:
    from envcraft_dqn.learner import Learner

    learner = Learner(Settings(size="tiny", device="cpu", precision="bf16"), SMALL)
    errors, _ = learner.update(batch(256))
    assert len(np.unique(errors)) > 250
    assert learner.precision == "bf16"


@pytest.mark.parametrize(("capability", "fast"), [((7, 5), False), ((8, 0), True), ((9, 0), True)])
def test_gpus_without_instructions_for_bf16_do_not_use_it(
    capability: tuple[int, int], fast: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    import torch
    from envcraft_dqn.learner import _faster_in_bf16

    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device=None: capability)
    assert _faster_in_bf16(torch.device("cuda")) is fast


def test_initial_weights_do_not_seed_other_generators(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch
    from envcraft_dqn.network import seeded_weights

    seeds: list[int] = []
    monkeypatch.setattr(torch.cuda, "manual_seed_all", seeds.append)
    before = torch.get_rng_state()
    with seeded_weights(3):
        first = torch.rand(3)
    assert (torch.get_rng_state() == before).all()
    with seeded_weights(3):
        assert (torch.rand(3) == first).all()
    assert not seeds


def test_standardised_network_sees_the_same_under_other_brightness_and_contrast() -> None:
    import torch
    from envcraft_dqn.network import Network

    rng = np.random.default_rng(0)
    frames = torch.from_numpy(rng.integers(0, 100, (3, *SMALL.shape), np.uint8))
    network, plain = (Network(SMALL.shape, SMALL.choices, size) for size in ("patches", "tiny"))
    pixels = network.preprocess(frames)
    assert pixels[:, :, ::4, ::4].mean((2, 3)).abs().max() < 1e-5
    assert pixels[:, :, ::4, ::4].std((2, 3), unbiased=False).mean(1).numpy() == pytest.approx(1, abs=0.25)
    assert torch.allclose(network.preprocess(frames + 100), pixels, atol=1e-5)
    assert (network.preprocess(2 * frames) - pixels).abs().mean() < 0.2
    assert network.preprocess(torch.zeros_like(frames)).abs().max() == 0
    assert (plain.preprocess(frames + 100) - plain.preprocess(frames)).mean() > 0.3
    # One cell of the map for each patch of four by four pixels, and half as many twice.
    assert network.streams.in_features == 64
    assert 0.01 < network(frames).std() < 1


def test_learning_rate_falls_to_zero_over_all_updates() -> None:
    from envcraft_dqn.learner import Learner

    for decay, wanted in ((True, [1e-2, 5e-3, 0.0]), (False, [1e-2] * 3)):
        learner = Learner(Settings(size="tiny", device="cpu", learning_rate=1e-2, decay=decay), SMALL)
        rates = []
        for done in (0.0, 0.5, 1.2):
            learner.anneal(done)
            rates.append(learner.optimiser.param_groups[0]["lr"])
        assert rates == pytest.approx(wanted)


@pytest.mark.parametrize("size", ["tiny", "patches", "cells"])
def test_restored_learner_continues_bit_for_bit(size: str) -> None:
    from envcraft_dqn.learner import Learner

    learner, again = (Learner(Settings(size=size, seed=seed, device="cpu"), SMALL) for seed in (1, 2))
    for _ in range(3):
        learner.update(batch())
    again.restore({name: value.clone() for name, value in learner.state().items()})
    for _ in range(2):
        assert learner.update(batch())[1] == again.update(batch())[1]
    assert all((learner.state()[name] == value).all() for name, value in again.state().items())


def test_state_of_another_network_is_refused() -> None:
    from envcraft_dqn.learner import Learner

    settings = [Settings(size="tiny", head=head, device="cpu") for head in ("branching", "joint")]
    branching, joint = (Learner(one, SMALL) for one in settings)
    with pytest.raises(UsageError, match="train in another folder"):
        joint.restore(branching.state())


def test_every_environment_has_a_turn_in_each_cycle() -> None:
    from envcraft_dqn.trainer import schedule

    settings = Settings(num_envs=4, cycle=25, segment=10)
    names = [f"e{number}" for number in range(8)]
    turns = list(islice(schedule(names, settings), 4))
    for cycle in (turns[:2], turns[2:]):
        assert sorted({name for one in cycle for name in one.names}) == names
    assert [one.names for one in turns[:2]] != [one.names for one in turns[2:]]
    seeds = [seed for one in turns for seed in one.seeds]
    assert len(set(seeds)) == len(seeds)
    assert list(islice(schedule(names, settings), 4)) == turns


class Scripted:
    """Demonstrations that walk to the end, with half of the actions random, so that all actions have TD errors."""

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


def returns(agent: Path, names: list[str], spec: EnvSpec, open_vector: Any) -> list[float]:
    """The mean return in each environment."""
    policy = AgentPolicy(agent, spec, 0, 0.0, "cpu")
    return [one.total.mean for one in evaluate(names, open_vector, policy, 100, 32)]


def test_demonstrations_alone_solve_a_corridor(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    settings = Settings(size="tiny", device="cpu", steps=0, pretrain_updates=400, target_every=50, learning_rate=1e-3)
    agent = train(settings, ["right"], open_corridors, tmp_path, Scripted())
    assert (tmp_path / "pretrained.safetensors").read_bytes() == agent.read_bytes()
    assert json.loads((tmp_path / "checkpoint" / "state.json").read_text())["numbers"]["updates"] == 400
    assert returns(agent, ["right"], SMALL, open_corridors)[0] > 0.9


def test_unusable_settings_are_reported(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    with pytest.raises(UsageError, match="need demonstrations"):
        train(Settings(pretrain_updates=5), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="unknown size 'huge'; choose from tiny"):
        train(Settings(size="huge"), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="too small for 16 environments"):
        train(Settings(capacity=100), ["right"], open_corridors, tmp_path)
    with pytest.raises(UsageError, match="too small for all demonstrations"):
        train(Settings(capacity=200, num_envs=2, device="cpu"), ["right"], open_corridors, tmp_path, Scripted())
    for device, words in (
        ("tpu", "is not a device of torch; name one such as cpu"),
        ("mps", "is not available on this mac"),
    ):
        with pytest.raises(UsageError, match=f"^--device {device} {words}"):
            train(Settings(device=device), ["right"], open_corridors, tmp_path)


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
def test_settings_out_of_bounds_are_reported(wrong: dict[str, Any]) -> None:
    [name] = wrong
    with pytest.raises(UsageError, match=f"{name} is .*; it must "):
        Settings(**wrong).check()


def test_too_many_actions_are_refused(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    def opened(names: Sequence[str]) -> Any:
        vector = open_corridors(names)
        vector.single_action_space = MultiDiscrete([2] * 15)
        return vector

    with pytest.raises(UsageError, match="32,768 joint actions, and an agent supports at most 32,767"):
        train(Settings(size="tiny", device="cpu"), ["right"], opened, tmp_path)


def test_keys_in_files_are_stable() -> None:
    from envcraft_dqn.study.presets import PRESETS
    from envcraft_dqn.trainer import Position

    keys = "size head seed steps pretrain_updates lanes cycle leg batch learning_rate decay gamma n_step train_every "
    keys += "target_every epsilon_first epsilon_last epsilon_share alpha beta capacity demonstrations starts "
    keys += "demonstration_share replay precision compiled device value_rescaling objective margin balanced "
    keys += "temperature augment lead"
    assert list(msgspec.to_builtins(Settings())) == keys.split()
    assert list(msgspec.to_builtins(Position())) == ["steps", "updates", "turns"]
    plan = msgspec.json.decode(msgspec.json.encode(PRESETS["smoke"]))
    assert plan["lanes"] == 12
    assert plan["settings"]["lanes"] == 2


def test_epsilon_falls_and_beta_rises() -> None:
    settings = Settings(steps=1000, pretrain_updates=250, epsilon_share=0.5)
    assert [settings.epsilon(steps) for steps in (0, 250, 500, 1000)] == pytest.approx([1.0, 0.55, 0.1, 0.1])
    assert [settings.annealed_beta(updates) for updates in (0, 250, 500)] == pytest.approx([0.4, 0.7, 1.0])
    assert math.isclose(Settings(steps=0).epsilon(0), 1.0)


@pytest.mark.parametrize(("num_envs", "starts"), [(2, 0), (64, 50)])
def test_updates_start_when_a_transition_is_complete(tmp_path: Path, num_envs: int, starts: int) -> None:
    from envcraft_dqn.checkpoint import load_agent
    from envcraft_dqn.trainer import train

    settings = Settings(
        size="tiny", device="cpu", steps=300, num_envs=num_envs, segment=20, starts=starts, capacity=2_000
    )
    network, _ = load_agent(train(settings, ["right"], open_corridors, tmp_path))
    assert all(parameter.isfinite().all() for parameter in network.parameters())
    numbers = json.loads((tmp_path / "checkpoint" / "state.json").read_text())["numbers"]
    assert numbers["updates"] == (numbers["steps"] - starts) // settings.train_every


def test_segments_do_not_cut_episodes(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    resets: list[int | None] = []

    class Counted(Corridor):
        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            resets.append(seed)
            return super().reset(seed=seed, options=options)

    settings = Settings(size="tiny", device="cpu", steps=200, num_envs=2, cycle=50, segment=7, capacity=500, starts=150)
    train(settings, ["right"], lambda names: SyncVectorEnv([Counted] * len(names)), tmp_path, every=0.0)
    # Two environments have three turns: the resets of episodes that end are not counted.
    assert len([seed for seed in resets if seed is not None]) == 2 * 3


class Infinite(Corridor):
    """Returns an infinite reward at random."""

    def step(self, action: Any) -> Any:
        frame, reward, *rest = super().step(action)
        return frame, reward if self.np_random.random() < 0.99 else float("inf"), *rest


def test_infinite_loss_ends_the_run(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import Diverged, train

    settings = Settings(size="tiny", device="cpu", steps=2_000, num_envs=2, segment=20, starts=0, capacity=2_000)
    with pytest.raises(Diverged, match=r"the loss of update [\d,]+ is inf: are all rewards finite"):
        train(settings, ["right"], lambda names: SyncVectorEnv([Infinite] * len(names)), tmp_path)
    assert not (tmp_path / "agent.safetensors").exists()


def test_agent_with_nan_is_refused(tmp_path: Path) -> None:
    import torch
    from envcraft_dqn.checkpoint import load_agent, save_agent
    from envcraft_dqn.network import Network

    network = Network(SMALL.shape, SMALL.choices, "tiny")
    with torch.no_grad():
        next(network.parameters()).view(-1)[0] = float("nan")
    with pytest.raises(UsageError, match="has weights that are not finite"):
        load_agent(save_agent(tmp_path / "agent.safetensors", network, SMALL))


def open_overwriting(names: Sequence[str]) -> Any:
    """Corridors whose frames are overwritten by the next step."""
    return SyncVectorEnv([partial(Corridor, name == "left") for name in names], copy=False)


def test_frames_are_copied_before_a_vector_overwrites_them(tmp_path: Path) -> None:
    from envcraft_dqn.trainer import train

    short = Settings(size="tiny", device="cpu", steps=400, num_envs=2, segment=50, starts=50, capacity=500)
    agents, demonstrated = [], []
    for name, opened in (("copies", open_corridors), ("overwrites", open_overwriting)):
        agents.append(train(short, ["left", "right"], opened, tmp_path / name).read_bytes())
        demonstrated.append(list(PolicyDemonstrations(opened, RandomPolicy(SMALL, 0), 30).episodes("right")))
    assert agents[0] == agents[1]
    assert all((one.frames == other.frames).all() for one, other in zip(*demonstrated, strict=True))
