"""Strategies for seeds, actions and episodes."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from envcraft_protocol.spaces import decode_action, describe
from gymnasium import spaces
from hypothesis import strategies as st

from envcraft.errors import UsageError
from envcraft.spaces import spec
from envcraft.spaces.sampling import sample
from envcraft.spaces.spec import SpaceSpec, read_space
from envcraft.testing.reproduction import note_episode

#: Arrays of more elements are drawn as a whole, from one seed: Hypothesis is slow to shorten them.
_MAX_ELEMENTS = 64
#: The largest number of a Box without a bound.
_FAR = 1000
#: The most steps for which one action is drawn.
_HELD = 16

MakeEnv = Callable[[], gymnasium.Env[Any, Any]]


class Step(NamedTuple):
    """What a reset or a step returned.

    Attributes:
        action: what was passed to ``step``; None for the reset.
        observation: as the environment returned it.
        reward: 0 for the reset.
        terminated: False for the reset.
        truncated: False for the reset.
        info: as the environment returned it.
    """

    action: Any
    observation: Any
    reward: Any
    terminated: Any
    truncated: Any
    info: Any


class Episode(NamedTuple):
    """A seed, and actions as JSON: lists stand for arrays and tuples."""

    seed: int
    actions: list[Any]

    def play(self, env: gymnasium.Env[Any, Any]) -> Iterator[Step]:
        """Reset an environment, step it until the episode or the actions end, and yield each result, the reset's first.

        If the test fails, Hypothesis prints the shortened episode as a command that plays it in a sandbox.
        """
        note_episode(env, self.seed, self.actions)
        observation, info = env.reset(seed=self.seed)
        yield Step(None, observation, 0, False, False, info)
        described = describe(env.action_space)
        for action in self.actions:
            value = decode_action(described, action)
            taken = Step(value, *env.step(value))
            yield taken
            if taken.terminated or taken.truncated:
                return


def seeds() -> st.SearchStrategy[int]:
    """Seeds for ``reset(seed=...)``; 0 is the simplest."""
    return st.integers(0, 2**31 - 1)


def actions(env: gymnasium.Env[Any, Any] | spaces.Space[Any]) -> st.SearchStrategy[Any]:
    """Values of an action space, as an agent passes them to ``step``.

    Args:
        env: an environment, or a space. Values of a space that Gymnasium does not define are its own samples.
    """
    space = env if isinstance(env, spaces.Space) else env.action_space
    described = describe(space)
    if not read_space(described).known:
        return seeds().map(lambda seed: _drawn(space, seed))
    return plain_actions(read_space(described)).map(lambda action: decode_action(described, action))


def episodes(make: MakeEnv, *, max_steps: int = 200) -> st.SearchStrategy[Episode]:
    """Episodes of an environment: a seed, and actions that are each held for up to 16 steps.

    Args:
        make: the environment's class, or a function that constructs it. One instance gives the action space.
        max_steps: the largest number of actions.
    """
    return st.deferred(lambda: _episodes(action_space(make), max_steps))


def _episodes(space: SpaceSpec, max_steps: int) -> st.SearchStrategy[Episode]:
    held = st.tuples(plain_actions(space), st.integers(1, _HELD))
    return st.builds(
        Episode,
        seeds(),
        st.lists(held, max_size=max_steps).map(
            lambda parts: [action for action, times in parts for _ in range(times)][:max_steps]
        ),
    )


@functools.cache
def action_space(make: MakeEnv) -> SpaceSpec:
    """The action space of what a function constructs.

    Raises:
        UsageError: Gymnasium does not define the space.
    """
    env = make()
    try:
        space = read_space(describe(env.action_space))
    finally:
        env.close()
    if not space.known:
        raise UsageError(f"no actions can be drawn from the action space, {space}")
    return space


def plain_actions(space: SpaceSpec) -> st.SearchStrategy[Any]:
    """The values of a space as JSON, which :func:`envcraft_protocol.spaces.decode_action` reads."""
    match space:
        case spec.Discrete():
            return st.integers(space.start, space.start + space.n - 1)
        case spec.MultiDiscrete() if space.limits[0].size <= _MAX_ELEMENTS:
            nvec, start = space.limits
            parts = zip(nvec.ravel().tolist(), start.ravel().tolist(), strict=True)
            return _shaped([st.integers(low, low + count - 1) for count, low in parts], nvec.shape)
        case spec.MultiBinary() if np.prod(space.shape) <= _MAX_ELEMENTS:
            return _shaped([st.integers(0, 1)] * int(np.prod(space.shape)), space.shape)
        case spec.Box() if space.bounded and np.prod(space.shape) <= _MAX_ELEMENTS:
            low, high = space.arrays()
            bounds = zip(low.ravel().tolist(), high.ravel().tolist(), strict=True)
            return _shaped([_number(np.dtype(space.dtype), *bound) for bound in bounds], space.shape)
        case spec.Text():
            return st.text(sorted(space.charset), min_size=space.min_length, max_size=space.max_length)
        case spec.Dict():
            return st.fixed_dictionaries({name: plain_actions(item) for name, item in space.spaces})
        case spec.Tuple():
            return st.tuples(*map(plain_actions, space.spaces)).map(list)
        case spec.OneOf():
            return st.integers(0, len(space.spaces) - 1).flatmap(
                lambda index: plain_actions(space.spaces[index]).map(lambda value: [index, value])
            )
        case spec.Sequence():
            return st.lists(plain_actions(space.space), max_size=10)
    return seeds().map(lambda seed: sample(space, np.random.default_rng(seed)))


def _shaped(elements: list[st.SearchStrategy[Any]], shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    return st.tuples(*elements).map(lambda flat: np.array(flat).reshape(shape).tolist())


def _number(dtype: np.dtype[Any], low: float, high: float) -> st.SearchStrategy[Any]:
    """Numbers of one element of a Box. A side without a bound ends at `_FAR`, or as far beyond the other bound."""
    least = min(-_FAR, high - _FAR) if not np.isfinite(low) else low
    most = max(_FAR, low + _FAR) if not np.isfinite(high) else high
    if dtype.kind in "iub":
        return st.integers(int(least), int(most))
    least, most = (float(np.clip(bound, np.finfo(dtype).min, np.finfo(dtype).max)) for bound in (least, most))
    width = {2: 16, 4: 32}.get(dtype.itemsize, 64)
    return st.floats(float(dtype.type(least)), float(dtype.type(most)), width=width)  # type: ignore[arg-type]


def _drawn(space: spaces.Space[Any], seed: int) -> Any:
    own = copy.deepcopy(space)
    own.seed(seed)
    return own.sample()
