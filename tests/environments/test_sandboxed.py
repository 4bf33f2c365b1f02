"""Environments that run in a sandbox while an agent steps them: the same values, and failures that cost one episode."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import ResetNeeded

import envcraft
from envcraft.corpus.store import Store
from envcraft.errors import EnvironmentFailed, UsageError
from envcraft.spaces.gymnasium import from_gymnasium, to_gymnasium
from envcraft.spaces.spec import Discrete, Sequence

from .conftest import game

Opened = Callable[..., gymnasium.Env[Any, Any]]


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Opened]:
    """Open a file's text in the sandbox."""
    envs: list[gymnasium.Env[Any, Any]] = []

    def run(text: str, **more: Any) -> gymnasium.Env[Any, Any]:
        (tmp_path / "game.py").write_text(text)
        envs.append(envcraft.make(tmp_path / "game.py", sandbox="process", **more))
        return envs[-1]

    yield run
    for env in envs:
        env.close()


@pytest.mark.parametrize("name", ["native", "point"])
def test_episodes_are_those_of_the_trusted_environment(corpus: Path, name: str) -> None:
    trusted = envcraft.make(corpus, name)
    env = envcraft.make(corpus, name, sandbox="process", render_mode="rgb_array" if name == "native" else None)
    assert (env.observation_space, env.action_space) == (trusted.observation_space, trusted.action_space)
    env.action_space.seed(0)
    for seed in (5, 6):
        ours, theirs = env.reset(seed=seed), trusted.reset(seed=seed)
        assert np.array_equal(ours[0], theirs[0])
        for _ in range(12):
            action = env.action_space.sample()
            told, wanted = env.step(action), trusted.step(action)
            assert told[0].dtype == wanted[0].dtype
            assert np.array_equal(told[0], wanted[0])
            assert told[1:4] == wanted[1:4]
            assert {key: told[4][key] for key in ("score",) if key in wanted[4]} == {
                key: wanted[4][key] for key in ("score",) if key in wanted[4]
            }
            if told[2] or told[3]:
                break
        if name == "native":
            assert np.array_equal(env.render(), told[0])  # type: ignore[arg-type]
    env.close()
    env.close()


class TestEpisodes:
    def test_after_the_end_and_before_the_beginning(self, opened: Opened) -> None:
        env = opened(game("Game", "self.steps >= 2"))
        with pytest.raises(ResetNeeded):
            env.step([0, 0, 0])
        # What was observed is the caller's own.
        first = env.reset()[0]
        first[:] = 0
        env.step(np.array([0, 0, 0]))
        assert env.step(np.array([0, 0, 0]))[2] is True
        with pytest.raises(ResetNeeded):
            env.step(np.array([0, 0, 0]))
        env.reset()
        with pytest.raises(ValueError, match=r"action array\(\[5, 0, 0\]\) is not in MultiDiscrete"):
            env.step(np.array([5, 0, 0]))
        env.step(np.array([4, 0, 0]))

    def test_resets_without_a_seed_follow_from_the_last_seed(self, opened: Opened) -> None:
        env = opened(game())
        series = []
        for _ in range(2):
            env.reset(seed=2)
            series.append([env.reset()[0].tobytes() for _ in range(3)])
        assert series[0] == series[1]
        assert len(set(series[0])) == 3

    def test_unsupported_arguments_are_usage_errors(self, opened: Opened) -> None:
        env = opened(game(), start=7)
        with pytest.raises(UsageError, match="no options"):
            env.reset(options={"level": 2})
        env.reset(seed=0)
        env.step(np.array([0, 0, 0]))
        assert env.step(np.array([0, 0, 0]))[2]
        with pytest.raises(UsageError, match="must be JSON"):
            opened(game(), start=object())
        with pytest.raises(UsageError, match="'human'"):
            opened(game(), render_mode="human")


class TestFailures:
    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("raise ZeroDivisionError('by none')", "failed in step 2: ZeroDivisionError: by none"),
            ("import os; os._exit(3)", "died"),
            ("return self.render()[:80], 0.0, False, False, {}", r"shape \(80, 84, 3\), not"),
            ("return 1, 2", "returned a tuple of 2"),
            ("return self.render(), np.ones(1), False, False, {}", "at step 2 reward is of type numpy.ndarray"),
            ("return self.render(), 0.0, 'no', False, {}", "at step 2 terminated is of type str"),
            ("return self.render(), 0.0, False, None, {}", "at step 2 truncated is of type None"),
        ],
    )
    def test_a_failure_ends_the_episode_and_the_next_one_begins(self, opened: Opened, body: str, words: str) -> None:
        env = opened(game("Game", "self.steps >= 9", f"if action[2]:\n            {body}"))
        env.reset(seed=0)
        env.step(np.array([0, 0, 0]))
        with pytest.raises(EnvironmentFailed, match=words):
            env.step(np.array([0, 0, 1]))
        env.reset(seed=0)
        env.step(np.array([0, 0, 0]))

    def test_a_class_that_cannot_be_made(self, opened: Opened) -> None:
        with pytest.raises(EnvironmentFailed, match="cannot be constructed: RuntimeError: early"):
            opened("import gymnasium\nraise RuntimeError('early')")
        with pytest.raises(EnvironmentFailed, match="no environment class"):
            opened("import gymnasium")


class TestSpaces:
    @pytest.mark.parametrize(
        "space",
        [
            spaces.Box(-1, 1, (2, 3), np.float64),
            spaces.Box(np.array([0, -np.inf], np.float32), np.array([np.inf, 5], np.float32)),
            spaces.Box(0, 2**64 - 1, (2,), np.uint64),
            spaces.Discrete(4, start=-2),
            spaces.MultiDiscrete(np.array([[2, 3], [4, 5]]), start=np.array([[1, 1], [0, 0]])),
            spaces.MultiBinary([2, 2]),
            spaces.Text(5, charset="ab"),
            spaces.Dict({"b": spaces.Discrete(2), "a": spaces.Tuple([spaces.MultiBinary(3), spaces.Discrete(3)])}),
        ],
        ids=str,
    )
    def test_descriptions_give_the_same_space_again(self, space: spaces.Space[Any]) -> None:
        assert to_gymnasium(from_gymnasium(space), "it") == space

    def test_kinds_that_cannot_be_sent(self) -> None:
        with pytest.raises(UsageError, match=r"the action space of x is Sequence"):
            to_gymnasium(
                Sequence(Discrete(2, 0), stack=False),
                "the action space of x",
            )


def test_a_vector_of_sandboxes_gives_what_one_of_trusted_environments_does(corpus: Path) -> None:
    names = ["ant", "bee"]
    vectors = [
        envcraft.make_vec(names, corpus=corpus, workers=1, autoreset_mode="SameStep", sandbox=sandbox)
        for sandbox in (None, "process")
    ]
    told = [vector.reset(seed=4)[0] for vector in vectors]
    assert np.array_equal(*told)
    actions = np.random.default_rng(0).integers(0, [5, 2, 2], (4, 2, 3))
    for action in actions:
        ours, theirs = ([*vector.step(action)] for vector in vectors)
        assert all(np.array_equal(ours[at], theirs[at]) for at in range(4))
    for vector in vectors:
        vector.close()


@pytest.mark.parametrize("workers", [0, 2])
def test_options_that_sandboxes_refuse_end_no_vector(corpus: Path, workers: int) -> None:
    vector = envcraft.make_vec(["ant", "bee"], corpus=corpus, workers=workers, sandbox="process")
    first, _ = vector.reset(seed=4)
    with pytest.raises(UsageError, match="takes no options"):
        vector.reset(options={"level": 2})
    assert not np.array_equal(vector.step(np.ones((2, 3), np.int64))[0], first)
    assert np.array_equal(vector.reset(seed=4)[0], first)
    vector.close()


def test_what_is_sandboxed_needs_no_trust(corpus: Path) -> None:
    with Store(corpus, write=True) as store:
        store.add("plain.py", game("Plain").encode())
    env = envcraft.make(corpus, "plain", sandbox="process")
    env.reset(seed=0)
    env.close()
    assert not [name for name in sys.modules if name.endswith(hashlib.sha256(game("Plain").encode()).hexdigest())]
