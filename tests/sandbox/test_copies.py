"""Copies of an environment are those of `copy.deepcopy`."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from envcraft_sandbox.worker.copies import Copies
from envcraft_sandbox.worker.state import State
from gymnasium import spaces

from tests.sandbox.test_state import Env, Lock, Slotted, surface

WORD = " ".join(("empty", "hands"))


def drawn(space: spaces.Space[Any]) -> spaces.Space[Any]:
    space.seed(5)
    space.sample()
    return space


def spawned(count: int) -> np.random.Generator:
    made = np.random.default_rng(3)
    made.spawn(count)
    return made


HELD: dict[str, tuple[Callable[[], Any], Callable[[Any], Any]]] = {
    "a list inside": (lambda: [[1], 2], lambda held: held[0].append(3)),
    "an array": (lambda: np.zeros(3), lambda held: held.fill(1)),
    "a generator": (lambda: np.random.default_rng(7), lambda held: held.random()),
    "another kind of generator": (lambda: np.random.Generator(np.random.MT19937(7)), lambda held: held.random()),
    "an older generator": (lambda: np.random.RandomState(7), lambda held: held.random()),
    "a generator that spawned others": (lambda: spawned(2), lambda held: held.spawn(1)),
    "a space that was drawn from": (lambda: drawn(spaces.Discrete(100)), lambda held: held.sample()),
    "spaces in a space": (lambda: spaces.Dict(a=drawn(spaces.Discrete(9))), lambda held: held["a"].sample()),
    "a picture": (lambda: surface(9), lambda held: held.fill((1, 2, 3))),
    "slots": (lambda: Slotted(3), lambda held: setattr(held, "shown", 9)),
    "a record": (lambda: Lock(2, [1]), lambda held: held.marks.append(3)),
}


def image(value: Any) -> Any:
    """The state, and what comes of it next where that is not seen in it."""
    seeds = value.bit_generator.seed_seq if isinstance(value, np.random.Generator) else None
    count = seeds.n_children_spawned if isinstance(seeds, np.random.SeedSequence) else None
    state = State(Env(value=value))
    return state.values, state.generators, count


@pytest.mark.parametrize(("make", "change"), HELD.values(), ids=HELD)
def test_nothing_that_changes_is_shared(make: Callable[[], Any], change: Callable[[Any], Any]) -> None:
    env: Any = Env(value=make())
    before = image(env.value)
    copies = Copies(env)
    first, second = copies.of(env).value, copies.of(env).value
    assert type(first) is type(env.value)
    assert image(first) == image(copy.deepcopy(env.value)) == before

    change(first)
    assert image(first) != before
    assert image(second) == image(env.value) == before
    change(env.value)
    assert image(env.value) == image(first)
    assert image(second) == before


def test_what_belongs_together_stays_together() -> None:
    generator, items = np.random.default_rng(3), [1]
    made: Any = Env(rng=generator, bits=generator.bit_generator, draw=[generator], items=items, again={"items": items})
    copied = Copies(made).of(made)

    assert copied.rng.bit_generator is copied.bits
    assert copied.draw[0] is copied.rng
    assert copied.rng is not generator
    assert copied.items is copied.again["items"]
    assert copied.items is not items


def test_constants_are_still_the_same_objects() -> None:
    copied = Copies(Env()).of(Env(held=WORD, of=(0, -1), code=len))

    assert copied.held is WORD
    assert copied.code is len


def test_spaces_are_shared_unless_copies_are_to_be_exact() -> None:
    made: Any = Env(space=spaces.Box(0, 1, (2,)), drawn=drawn(spaces.Discrete(3)))
    shared, exact = Copies(made).of(made), Copies(made, exact=True).of(made)

    assert shared.space is made.space
    assert shared.drawn is not made.drawn
    assert exact.space is not made.space
    assert exact.space == made.space


def test_what_cannot_be_copied_says_so() -> None:
    made: Any = Env(value=(number for number in range(3)))
    with pytest.raises(TypeError):
        Copies(made).of(made)


def test_a_copied_episode_goes_on_as_the_original() -> None:
    env = gymnasium.make("CartPole-v1")
    env.reset(seed=3)
    env.step(1)
    copied = Copies(env).of(env)
    for action in (0, 1, 1, 0, 1):
        here, there = env.step(action), copied.step(action)
        assert np.array_equal(here[0], there[0])
        assert here[1:] == there[1:]
