"""The state machine: resets, steps, rendering, a second instance and closing, in any order."""

from __future__ import annotations

import contextlib
import copy
import functools
import inspect
import itertools
import math
from collections.abc import Callable
from typing import Any, ClassVar

import gymnasium
import numpy as np
from envcraft_protocol.spaces import decode_action, describe
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from envcraft.judging.differences import part
from envcraft.model.rollout import Conditions
from envcraft.model.rollout import Episode as Earlier
from envcraft.model.trace import Divergence
from envcraft.spaces.gymnasium import from_gymnasium
from envcraft.spaces.validation import validate
from envcraft.testing.reproduction import note_episode
from envcraft.testing.strategies import Step, action_space, plain_actions, seeds

#: The number of returned observations that are compared with themselves later.
_KEPT = 16
#: Characters of an observation that a message shows.
_SHOWN = 80
_ACTION = st.runner().flatmap(lambda machine: plain_actions(action_space(machine.make)))


class GymnasiumStateMachine(RuleBasedStateMachine):
    """Plays an environment in any order, and asserts what holds for every environment of Gymnasium.

    Subclass it with an `env_class`, add your own ``@invariant()`` and ``@rule()`` methods, and give pytest its
    ``TestCase``. The machine itself asserts that nothing raises, results have their types, observations are in their
    space and keep their values, and actions do not change. An episode must also be the same when it is played alone
    on a new instance, without a second instance, ``render()`` or earlier episodes.

    The environment runs in the process of the test.

    Attributes:
        env_class: the class, or a function that constructs the environment.
        contract: the contract for the command that a failure prints.
        deterministic: whether a seed and actions determine an episode.
        env: the instance. It has been reset whenever an invariant is checked.
        last: what the last reset or step returned.
        seed: of the current episode.
        actions: of the current episode, as JSON.
    """

    env_class: ClassVar[Callable[..., gymnasium.Env[Any, Any]]]
    contract: ClassVar[str] = "gymnasium"
    deterministic: ClassVar[bool] = True

    env: gymnasium.Env[Any, Any]
    last: Step

    def __init__(self) -> None:
        super().__init__()
        self.seed = 0
        self.actions: list[Any] = []
        self._record: list[Step] = []
        self._kept: list[tuple[Any, Any]] = []
        self._earlier: list[Earlier] = []
        self._other: gymnasium.Env[Any, Any] | None = None
        self._companion: Earlier | None = None
        self._rendered = self._closed = False

    @property
    def make(self) -> Callable[[], gymnasium.Env[Any, Any]]:
        """Constructs an instance, with ``render_mode="rgb_array"`` if the class has that mode."""
        return _maker(type(self).env_class)

    @property
    def ended(self) -> bool:
        """Whether the current episode is over."""
        return bool(self.last.terminated or self.last.truncated)

    @initialize(seed=seeds())
    def construct(self, seed: int) -> None:
        """Construct the instance and reset it."""
        self.env = self.make()
        self._reset(seed)

    @rule(seed=seeds())
    def reset(self, seed: int) -> None:
        """Begin another episode on the same instance."""
        self.play_alone()
        self._earlier.append(Earlier(self.seed, self.actions))
        self._reset(seed)

    @precondition(lambda self: not self.ended)
    @rule(action=_ACTION, times=st.integers(1, 20))
    def step(self, action: Any, times: int) -> None:
        """Take one action several times."""
        for _ in range(times):
            self._step(action)
            if self.ended:
                break

    @precondition(lambda self: self.env.render_mode == "rgb_array")
    @rule()
    def render(self) -> None:
        """Draw the current state."""
        self._rendered = True
        frame = self.env.render()
        assert isinstance(frame, np.ndarray), f"render() returned a {type(frame).__name__}, not an array (EC112)"
        assert frame.dtype == np.uint8, f"render() returned {frame.dtype}, not uint8 (EC112)"
        assert frame.ndim == 3, f"render() returned the shape {frame.shape}, not (height, width, 3) (EC112)"

    @rule(seed=seeds(), action=_ACTION, times=st.integers(0, 5))
    def second_instance(self, seed: int, action: Any, times: int) -> None:
        """Play an episode on a second instance, which stays open."""
        if self._other is None:
            self._other = self.make()
        self._other.reset(seed=seed)
        value = self._value(action)
        played: list[Any] = []
        for _ in range(times):
            _, _, terminated, truncated, _ = self._other.step(copy.deepcopy(value))
            played.append(action)
            if terminated or truncated:
                break
        self._companion = Earlier(seed, played)

    @rule(seed=seeds())
    def close(self, seed: int) -> None:
        """Close the instance twice, and go on with a new one."""
        self.play_alone()
        self.env.close()
        self.env.close()
        self._closed, self._earlier, self._rendered = True, [], False
        self.env = self.make()
        self._reset(seed)

    @rule()
    def play_alone(self) -> None:
        """Play the current episode again on a new instance, and compare. Every reset does, too."""
        if not self.deterministic:
            return
        with contextlib.closing(self.make()) as env:
            results = (env.step(self._value(action)) for action in self.actions)
            played = itertools.chain([_reset_result(env.reset(seed=self.seed))], results)
            for at, (expected, result) in enumerate(zip(self._record, played, strict=True)):
                found = Step(None, *result)
                for name in ("observation", "reward", "terminated", "truncated"):
                    one, two = getattr(expected, name), getattr(found, name)
                    # pytest adds the values to the message of an assert statement: two whole frames.
                    if not same(one, two):
                        difference = part(Divergence(at, name), one, two)
                        raise AssertionError(f"the episode, played alone, differs: {difference}")

    @invariant()
    def observations_keep_their_values(self) -> None:
        """What was returned stays as it was returned."""
        for value, before in self._kept:
            if not same(value, before):
                raise AssertionError("an observation changed after it was returned (EC110)")

    def teardown(self) -> None:
        if hasattr(self, "env"):
            conditions = Conditions(
                before=self._earlier, companion=self._companion, render=self._rendered, closed=self._closed
            )
            note_episode(self.env, self.seed, self.actions, conditions, self.contract)
            for env in (self.env, self._other):
                if env is not None:
                    # What close() raises is found by the rule of that name.
                    with contextlib.suppress(Exception):
                        env.close()

    def _reset(self, seed: int) -> None:
        self.seed, self.actions, self._record = seed, [], []
        self._take(Step(None, *_reset_result(self.env.reset(seed=seed))))

    def _step(self, action: Any) -> None:
        self.actions.append(action)
        value = self._value(action)
        result = self.env.step(value)
        assert same(value, self._value(action)), "step() changed its action (EC111)"
        assert isinstance(result, tuple), f"step() returned a {type(result).__name__} (EC106)"
        assert len(result) == 5, f"step() returned {len(result)} values, not 5 (EC106)"
        self._take(Step(value, *result))

    def _take(self, result: Step) -> None:
        """Assert what holds for the result of every reset and step, and keep it."""
        space = self.env.observation_space
        if not space.contains(result.observation):
            raise AssertionError(f"{_misfit(space, result.observation)} (EC108, EC109)")
        assert isinstance(result.reward, int | float | np.integer | np.floating), f"reward {result.reward!r} (EC302)"
        assert not isinstance(result.reward, bool), "the reward is a bool (EC302)"
        assert math.isfinite(result.reward), f"the reward is {result.reward} (EC301)"
        for name in ("terminated", "truncated"):
            flag = getattr(result, name)
            assert isinstance(flag, bool | np.bool_), f"{name} is {flag!r}, not a bool (EC504)"
        assert isinstance(result.info, dict), f"info is a {type(result.info).__name__} (EC114)"
        assert all(isinstance(key, str) for key in result.info), "info has keys that are not str (EC114)"
        kept = copy.deepcopy(result.observation)
        self.last = result
        self._record.append(result._replace(observation=kept, info=None))
        self._kept = [*self._kept, (result.observation, kept)][-_KEPT:]

    def _value(self, action: Any) -> Any:
        """An action as an agent passes it."""
        return decode_action(describe(self.env.action_space), action)


def same(one: Any, two: Any) -> bool:
    """Whether two values of a space are equal in type and value; NaN equals NaN."""
    if isinstance(one, dict) and isinstance(two, dict):
        return one.keys() == two.keys() and all(same(one[key], two[key]) for key in one)
    if isinstance(one, tuple | list) and isinstance(two, tuple | list):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, np.ndarray) and isinstance(two, np.ndarray):
        return one.dtype == two.dtype and np.array_equal(one, two, equal_nan=one.dtype.kind in "fc")
    return bool(one == two) or bool(one != one and two != two)


def _misfit(space: gymnasium.Space[Any], observation: Any) -> str:
    """Why an observation is not in a space, without printing a whole frame."""
    problem = validate(from_gymnasium(space), observation, exact=False)
    return problem[1] if problem is not None else f"the observation {str(observation)[:_SHOWN]} is not in {space}"


def _reset_result(result: Any) -> tuple[Any, float, bool, bool, Any]:
    assert isinstance(result, tuple), f"reset() returned a {type(result).__name__} (EC105)"
    assert len(result) == 2, f"reset() returned {len(result)} values, not 2 (EC105)"
    return result[0], 0.0, False, False, result[1]


@functools.cache
def _maker(env_class: Callable[..., gymnasium.Env[Any, Any]]) -> Callable[[], gymnasium.Env[Any, Any]]:
    """The one function that constructs instances of a class; its action space is then read once."""
    modes = (getattr(env_class, "metadata", None) or {}).get("render_modes", ())
    takes = inspect.isclass(env_class) and "render_mode" in inspect.signature(env_class).parameters
    options = {"render_mode": "rgb_array"} if takes and "rgb_array" in modes else {}
    return functools.partial(env_class, **options)
