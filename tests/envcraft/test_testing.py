"""Hypothesis strategies and the state machine for authors: what they draw, find, shorten and print."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import HealthCheck, Phase, find, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import run_state_machine_as_test

import envcraft
from envcraft.errors import UsageError
from envcraft.testing import Episode, GymnasiumStateMachine, actions, episodes, seeds
from envcraft.testing.machine import same

SPACES = [
    spaces.Discrete(4),
    spaces.Discrete(3, start=-5),
    spaces.MultiDiscrete([5, 2, 2]),
    spaces.MultiDiscrete(np.array([[2, 3], [4, 5]]), np.int32, start=np.array([[1, 2], [3, 4]])),
    spaces.MultiDiscrete([3] * 100),
    spaces.MultiBinary([2, 3]),
    spaces.Box(-1.0, 2.0, (2, 2), np.float32),
    spaces.Box(0, 255, (3,), np.uint8),
    spaces.Box(0, 255, (84, 84, 3), np.uint8),
    spaces.Box(-np.inf, np.inf, (2,), np.float64),
    spaces.Box(np.array([0.1, -np.inf]), np.array([np.inf, -5e9]), dtype=np.float64),
    spaces.Box(-1.0, 1.0, (), np.float16),
    spaces.Text(5, min_length=2, charset="xyz"),
    spaces.Dict({"move": spaces.Discrete(4), "aim": spaces.Box(-1, 1, (2,))}),
    spaces.Tuple([spaces.Discrete(2), spaces.MultiBinary(3)]),
    spaces.OneOf([spaces.Discrete(2), spaces.Box(-1, 1, (2,))]),
    spaces.Sequence(spaces.Discrete(3)),
    spaces.Graph(spaces.Discrete(3), spaces.Discrete(2)),
]


class Own(spaces.Space[Any]):
    """A space of a package of its own."""

    def sample(self, mask: Any = None, probability: Any = None) -> Any:
        return int(self.np_random.integers(7))

    def contains(self, x: Any) -> bool:
        return isinstance(x, int) and 0 <= x < 7


class Line(gymnasium.Env[Any, Any]):
    """A line of ten cells; the subclasses have one defect each."""

    observation_space = spaces.Box(0, 1, (10,), np.int64)
    action_space = spaces.Discrete(2)
    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(5))
        return self._see(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.at = max(self.at + 2 * int(action) - 1, 0)
        return self._see(), float(self.at == 9), self.at == 9, False, {}

    def _see(self) -> Any:
        return (np.arange(10) == self.at).astype(np.int64)

    def render(self) -> Any:
        return np.zeros((4, 4, 3), np.uint8)


class Crashes(Line):
    def step(self, action: Any) -> Any:
        result = super().step(action)
        if self.at == 7:
            raise RuntimeError("a hole in the floor")
        return result


class Shares(Line):
    cell = [0]

    def reset(self, **kwargs: Any) -> Any:
        self.cell[0] = 0
        return super().reset(**kwargs)

    def step(self, action: Any) -> Any:
        self.cell[0] += 1
        observation, _, terminated, truncated, info = super().step(action)
        return observation, float(self.cell[0]), terminated, truncated, info


class Aliases(Line):
    def reset(self, **kwargs: Any) -> Any:
        self.cells = np.zeros(10, np.int64)
        return super().reset(**kwargs)

    def _see(self) -> Any:
        self.cells[:] = np.arange(10) == self.at
        return self.cells


class Jumps(Line):
    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = super().step(action)
        return observation * (1 + (self.at == 6)), reward, terminated, truncated, info


class Draws(Line):
    def render(self) -> Any:
        self.at = 0
        return super().render()


class Closes(Line):
    def close(self) -> None:
        del self.at


class Pays(Line):
    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, None if self.at == 4 else reward, terminated, truncated, info


def machine_of(env: type[Line]) -> type[GymnasiumStateMachine]:
    return type(f"{env.__name__}Machine", (GymnasiumStateMachine,), {"env_class": env})


QUICK = settings(
    max_examples=60,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[*HealthCheck],
    phases=[Phase.generate, Phase.shrink],
    report_multiple_bugs=False,
)


@pytest.mark.parametrize("space", SPACES, ids=str)
@settings(max_examples=25)
@given(data=st.data())
def test_actions_are_in_the_space_and_of_its_type(space: spaces.Space[Any], data: st.DataObject) -> None:
    drawn = data.draw(actions(space))
    assert space.contains(drawn)
    assert type(drawn) is type(space.sample())


@given(data=st.data())
def test_actions_of_a_space_of_its_own(data: st.DataObject) -> None:
    env = Line()
    env.action_space = Own()  # type: ignore[assignment]
    assert env.action_space.contains(data.draw(actions(env)))


def test_the_simplest_action_is_the_first_one() -> None:
    assert find(actions(spaces.MultiDiscrete([5, 2, 2])), lambda action: True).tolist() == [0, 0, 0]
    assert find(seeds(), lambda seed: True) == 0


def test_episodes_shrink_to_the_steps_that_matter() -> None:
    def wins(episode: Episode) -> bool:
        return any(step.terminated for step in episode.play(Line()))

    # The seed with the nearest start is not searched: five to nine steps to the right are left.
    shortest = find(episodes(Line), wins, settings=QUICK)
    assert set(shortest.actions) == {1}
    assert 5 <= len(shortest.actions) <= 9


def test_episodes_are_long_enough_to_play_and_bounded() -> None:
    lengths: list[int] = []

    @settings(max_examples=200, derandomize=True, database=None, phases=[Phase.generate])
    @given(episodes(Line, max_steps=40))
    def play(episode: Episode) -> None:
        lengths.append(len(episode.actions))

    play()
    assert max(lengths) == 40
    assert sum(length >= 20 for length in lengths) > len(lengths) // 4


def test_actions_of_an_unknown_space_make_no_episodes() -> None:
    def make() -> Line:
        env = Line()
        env.action_space = Own()  # type: ignore[assignment]
        return env

    with pytest.raises(UsageError, match="no actions can be drawn"):
        find(episodes(make), lambda episode: True)


def test_a_good_environment_passes() -> None:
    run_state_machine_as_test(machine_of(Line), settings=QUICK)


@pytest.mark.parametrize(
    ("env", "words", "most"),
    [
        (Crashes, "a hole in the floor", 7),
        (Shares, "played alone, differs: reward differs at step", 2),
        (Aliases, "changed after it was returned", 1),
        (Jumps, "EC108, EC109", 6),
        (Draws, r"played alone, differs: observation differs at step 1 in 2 of 10 values, first at", 1),
        (Closes, "at", 0),
        (Pays, "EC302", 4),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else None,
)
def test_a_planted_defect_is_found_and_shrinks_to_few_steps(env: type[Line], words: str, most: int) -> None:
    with pytest.raises((AssertionError, RuntimeError, AttributeError), match=words) as raised:
        run_state_machine_as_test(machine_of(env), settings=QUICK)
    notes = "\n".join(raised.value.__notes__)
    repro = json.loads(shlex.split(notes[notes.index("envcraft replay") :].splitlines()[0])[-1])
    assert len(repro["actions"]) <= most
    assert set(repro["conditions"]) <= {"before", "companion", "render", "closed"}


class Noise(Line):
    """Frames that another instance does not draw again."""

    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)

    def _see(self) -> Any:
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[77:84, 30:40] = np.random.randint(1, 255, 3)
        return frame


class Wide(Line):
    observation_space = spaces.Box(0, 1, (84, 84, 3), np.float32)

    def _see(self) -> Any:
        frame = np.zeros((84, 84, 3), np.float32)
        frame[77, 35] = 2
        return frame


@pytest.mark.parametrize(
    ("env", "words"),
    [
        (Noise, r"the reset in rows 77 to 83 and columns 30 to 39, first at \[77, 30\] \(\[\d"),
        (Wide, r"^observation\[77, 35, 0\] is 2.0, outside Box"),
    ],
)
def test_a_failure_prints_no_frames(env: type[Line], words: str) -> None:
    with pytest.raises(AssertionError, match=words) as raised:
        run_state_machine_as_test(machine_of(env), settings=QUICK)
    assert str(raised.value).count("\n") < 12


SUITE = """
from hypothesis import settings
from hypothesis.stateful import invariant
from envcraft.testing import GymnasiumStateMachine
from hole import Hole

class HoleMachine(GymnasiumStateMachine):
    env_class = Hole

    @invariant()
    def it_stays_on_the_line(self):
        assert self.env.unwrapped.at < 6

TestHole = HoleMachine.TestCase
TestHole.settings = settings(max_examples=200, derandomize=True, database=None, deadline=None)
"""
HOLE = """
import gymnasium as gym

class Hole(gym.Env):
    observation_space = gym.spaces.Discrete(10)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = 0
        return self.at, {}

    def step(self, action):
        self.at = max(self.at + 2 * int(action) - 1, 0)
        return self.at, [0.0, None][self.at == 6], False, False, {}
"""


def test_a_suite_of_an_author_prints_a_command_that_replays(tmp_path: Path, invoke: Any) -> None:
    (tmp_path / "hole.py").write_text(HOLE)
    (tmp_path / "test_hole.py").write_text(SUITE)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_hole.py"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout
    (printed,) = set(re.findall(r"(envcraft replay .*)", done.stdout))
    arguments = shlex.split(printed)[1:]
    assert arguments[:5] == ["replay", "hole.py", "--class", "Hole", "--contract"]
    assert json.loads(arguments[-1])["actions"] == [1] * 6
    result = invoke(*arguments, "--sandbox", "process")
    assert result.exit_code == 1
    assert "6 actions" in result.stdout
    assert "EC302" in result.stdout


@pytest.mark.parametrize(
    ("repro", "words"),
    [
        ("{", "is not a reproduction"),
        ('{"actions": 3}', "is not a reproduction"),
        ('{"conditions": {"clock": 1}}', "is not a reproduction"),
        ('{"seed": -1}', "invalid seed"),
        ('{"actions": [7]}', "7, outside Discrete(2)"),
    ],
)
def test_what_is_no_reproduction_is_a_usage_error(tmp_path: Path, invoke: Any, repro: str, words: str) -> None:
    (tmp_path / "hole.py").write_text(HOLE)
    result = invoke("replay", "hole.py", "--contract", "gymnasium", "--sandbox", "process", "--repro", repro)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


def test_equal_values() -> None:
    assert same({"a": (np.array([1.0, np.nan]), 1)}, {"a": (np.array([1.0, np.nan]), 1)})
    assert not same(np.zeros(1, np.float32), np.zeros(1))
    assert not same((1,), (1, 2))
    assert same(float("nan"), float("nan"))


def test_the_module_is_imported_only_when_it_is_used() -> None:
    script = "import sys, envcraft; assert 'hypothesis' not in sys.modules; envcraft.testing.seeds()"
    subprocess.run([sys.executable, "-c", script], check=True)
    assert "testing" in dir(envcraft)


def test_without_hypothesis_the_next_step_is_named() -> None:
    script = "import sys; sys.modules['hypothesis'] = None; import envcraft.testing"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "pip install 'envcraft-rl[test]'" in done.stderr
