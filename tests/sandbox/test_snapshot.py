"""What a search returns to: as `copy.deepcopy` would have it."""

from __future__ import annotations

import copy
import random
import sys
from collections import deque
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pygame
import pytest
from envcraft_sandbox.worker.snapshot import Snapshot
from envcraft_sandbox.worker.state import State
from gymnasium import spaces

from tests.sandbox.test_state import Bag, Env, Lock, Mode, Slotted, surface


class OwnCopy:
    """Copies itself with a mark."""

    def __init__(self) -> None:
        self.copies = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> OwnCopy:
        made = OwnCopy()
        made.copies = self.copies + 1
        return made


class Uncopied:
    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError("not to be copied")


class Knot:
    def __init__(self) -> None:
        self.self, self.items = self, [self]


class Sub(np.ndarray[Any, Any]):
    pass


def local_class() -> Any:
    class Local:
        def __init__(self) -> None:
            self.values = [1, [2]]

    return Local()


def drawn(space: spaces.Space[Any]) -> spaces.Space[Any]:
    space.seed(5)
    space.sample()
    return space


def again(value: Any) -> Any:
    return Snapshot(Env(value=value)).restore().value


HELD: dict[str, Callable[[], Any]] = {
    "nested": lambda: {"rows": [[1, 2], (3, {4})], "name": "x", "none": None},
    "array": lambda: np.arange(12, dtype=np.int16).reshape(3, 4).T,
    "a view": lambda: np.arange(12)[::2],
    "an array of objects": lambda: np.array([[1, "a"], [None, (2,)]], dtype=object),
    "an array of a class of its own": lambda: np.arange(3).view(Sub),
    "a number of NumPy": lambda: np.float32(0.1),
    "generator": lambda: np.random.default_rng(7),
    "another kind of generator": lambda: np.random.Generator(np.random.MT19937(7)),
    "an older generator": lambda: np.random.RandomState(7),
    "a generator of the library": lambda: random.Random(7),
    "a space": lambda: spaces.Dict(a=spaces.Box(0, 1, (2,)), b=spaces.Discrete(3)),
    "a space that was drawn from": lambda: drawn(spaces.Discrete(100)),
    "a picture": lambda: surface(9),
    "slots": lambda: Slotted(3),
    "a list with more": lambda: Bag(3),
    "a record": lambda: Lock(2, [1]),
    "member of an enumeration": lambda: Mode.ANGRY,
    "a class inside a function": local_class,
    "a deque": lambda: deque([1, [2]], maxlen=3),
    "a function": lambda: len,
    "a function without a name": lambda: lambda: 3,
    "a module": lambda: np,
    "a class": lambda: Lock,
    "a list's method": lambda: Lock(4).marks.append,
    "a generator's method": lambda: np.random.default_rng(7).random,
    "a method": lambda: Lock(4).__repr__,
}


@pytest.mark.parametrize("make", HELD.values(), ids=HELD)
def test_is_as_it_was(make: Callable[[], Any]) -> None:
    value = make()
    held, restored = State(Env(value=value)), State(Env(value=again(value)))

    assert type(again(value)) is type(value)
    assert (restored.values, restored.generators) == (held.values, held.generators)


CHANGED: dict[str, tuple[Callable[[], Any], Callable[[Any], Any]]] = {
    "a list inside": (lambda: [[1], 2], lambda held: held[0].append(3)),
    "array": (lambda: np.zeros(3), lambda held: held.fill(1)),
    "an array of objects": (lambda: np.array([[1]], dtype=object), lambda held: held.fill(3)),
    "generator": (lambda: np.random.default_rng(7), lambda held: held.random()),
    "what a generator spawns": (lambda: np.random.default_rng(7), lambda held: held.spawn(1)),
    "a generator's method": (lambda: np.random.default_rng(7).random, lambda held: held()),
    "a list's method": (lambda: [1].append, lambda held: held(3)),
    "a space that was drawn from": (lambda: drawn(spaces.Discrete(100)), lambda held: held.sample()),
    "a picture": (lambda: surface(9), lambda held: held.fill((1, 2, 3))),
    "slots": (lambda: Slotted(3), lambda held: setattr(held, "shown", 9)),
    "a class inside a function": (local_class, lambda held: held.values[1].append(3)),
}


def told(value: Any) -> Any:
    """The state, and what comes of it next where that is not seen in it."""
    seeds = value.bit_generator.seed_seq if isinstance(value, np.random.Generator) else None
    spawned = seeds.n_children_spawned if isinstance(seeds, np.random.SeedSequence) else None
    state = State(Env(value=value))
    return state.values, state.generators, spawned


@pytest.mark.parametrize(("make", "change"), CHANGED.values(), ids=CHANGED)
def test_nothing_that_changes_is_shared(make: Callable[[], Any], change: Callable[[Any], Any]) -> None:
    value = make()
    before = told(value)
    snapshot = Snapshot(Env(value=value))
    first, second = snapshot.restore().value, snapshot.restore().value

    change(first)
    assert told(first) != before
    assert told(second) == told(value) == before
    change(value)
    assert told(snapshot.restore().value) == before


def test_one_object_stays_one() -> None:
    shared = np.zeros(3)
    restored = Snapshot(Env(knot=Knot(), first=shared, second=[shared])).restore()

    assert restored.knot.self is restored.knot
    assert restored.knot.items[0] is restored.knot
    assert restored.first is restored.second[0]
    assert restored.first is not shared


def test_a_spawned_generator_is_as_in_the_original() -> None:
    generator = np.random.default_rng(3)
    generator.spawn(2)
    restored = again(generator)

    assert restored.spawn(1)[0].random() == copy.deepcopy(generator).spawn(1)[0].random()


def test_spaces_and_code_are_shared() -> None:
    space, code = spaces.Box(0, 255, (4, 4, 3), np.uint8), local_class

    assert again(space) is space
    assert again(code) is code


def test_who_copies_itself_does_so() -> None:
    restored = again([OwnCopy(), 1])

    assert restored[0].copies == copy.deepcopy(copy.deepcopy(OwnCopy())).copies


def test_what_cannot_be_copied_says_so() -> None:
    with pytest.raises(TypeError, match="not to be copied"):
        Snapshot(Env(value=Uncopied()))


def test_a_restored_episode_goes_on_as_the_original() -> None:
    env = gymnasium.make("CartPole-v1")
    env.reset(seed=3)
    env.step(1)
    restored = Snapshot(env).restore()
    for action in (0, 1, 1, 0, 1):
        here, there = env.step(action), restored.step(action)
        assert np.array_equal(here[0], there[0])
        assert here[1:] == there[1:]


def test_pictures_without_pygame_are_no_question(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, pygame.__name__)

    assert again([1, 2]) == [1, 2]
