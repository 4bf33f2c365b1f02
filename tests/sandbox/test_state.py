"""What a search takes for two states, and what it knows that it cannot see."""

from __future__ import annotations

import enum
import random
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
import pygame
import pytest
from envcraft_sandbox.worker.state import State


@dataclass
class Lock:
    entered: int = 0
    marks: list[Any] = field(default_factory=list)


class Slotted:
    __slots__ = ("__hidden", "shown")

    def __init__(self, value: int) -> None:
        self.shown, self.__hidden = 0, value


class Bag(list[int]):
    def __init__(self, value: int) -> None:
        super().__init__([1])
        self.value = value


class Mode(enum.Enum):
    CALM = 0
    ANGRY = 1


def surface(value: int) -> pygame.Surface:
    made = pygame.Surface((4, 4))
    made.set_at((1, 1), (value, 0, 0))
    return made


def faded(value: int) -> pygame.Surface:
    made = surface(0)
    made.set_alpha(value)
    return made


class Named(np.ndarray[Any, Any]):
    name = ""


class Dice(random.Random):
    thrown = 0


def counted() -> None: ...


vars(counted)["calls"] = 1


class Env:
    def __init__(self, **attributes: Any) -> None:
        vars(self).update(attributes)

    @property
    def unwrapped(self) -> Env:
        return self


def state(value: Any) -> State:
    return State(Env(value=value))


MAKERS: dict[str, Callable[[int], Any]] = {
    "number": lambda n: n,
    "float": lambda n: n + 0.5,
    "attribute": lambda n: Lock(n),
    "list in an attribute": lambda n: Lock(0, [1, 2, n]),
    "far down a long list": lambda n: [0] * 3000 + [n],
    "objects in a dictionary": lambda n: {"a": [Lock(), Lock(n)]},
    "slots": Slotted,
    "subclass of list": Bag,
    "deque": lambda n: deque([1, n], maxlen=4),
    "counter": lambda n: Counter({"a": n}),
    "set": lambda n: {1, 5 + n},
    "array": lambda n: np.full((3, 3), n, np.uint8),
    "array of objects": lambda n: np.array([Lock(n), None], object),
    "rectangle": lambda n: pygame.Rect(n, 0, 3, 3),
    "vector": lambda n: pygame.Vector2(n, 1),
    "picture": surface,
    "how a picture is shown": lambda n: faded(n),
    "a space's number": lambda n: gymnasium.spaces.Discrete(5 + n),
    "a space's bounds": lambda n: gymnasium.spaces.Box(0, 1 + n, (2,)),
    "a space in a space": lambda n: gymnasium.spaces.Dict(a=gymnasium.spaces.Discrete(5 + n)),
    "mode": lambda n: Mode(n),
    "bound method": lambda n: Lock(n).__repr__,
    "built-in method": lambda n: [1, n].pop,
    "number and text": lambda n: "1" if n else 1,
    "function": lambda n: surface if n else state,
    "class": lambda n: Bag if n else Lock,
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_tells_values_apart(make: Callable[[int], Any]) -> None:
    one, same, other = state(make(0)), state(make(0)), state(make(1))
    assert one.values == same.values
    assert one.values != other.values
    assert not one.opaque


def test_a_thing_that_holds_itself() -> None:
    loop: list[Any] = [1]
    loop.append(loop)
    assert state(loop).values == state(loop).values


@pytest.mark.parametrize(
    "make",
    [
        lambda seed: np.random.default_rng(seed),
        lambda seed: random.Random(seed),
        lambda seed: np.random.RandomState(seed),
        lambda seed: Lock(marks=[np.random.default_rng(seed)]),
        lambda seed: gymnasium.spaces.Discrete(5, seed=seed),
    ],
    ids=["numpy", "python", "old numpy", "in an object", "of a space"],
)
def test_generators_are_not_values(make: Callable[[int], Any]) -> None:
    one, other = state(make(1)), state(make(2))
    assert one.values == other.values
    assert one.generators != other.generators


class Stubborn:
    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError


@pytest.mark.parametrize(
    "value",
    [
        (lambda kept: lambda: kept)([1]),
        counted,
        np.zeros(3).view(Named),
        Dice(3),
        Stubborn(),
        {Lock: 1, "a": {Stubborn()}},
        list(range(30_000)),
    ],
    ids=[
        "closure",
        "a function's attributes",
        "an array's attributes",
        "a generator's attributes",
        "not to be copied",
        "objects in a set",
        "very much",
    ],
)
def test_knows_what_it_does_not_see(value: Any) -> None:
    assert state(value).opaque


@pytest.mark.parametrize("value", [object(), open, Lock, {(1, "a"), (2, "b")}, frozenset({Mode.CALM})])
def test_knows_what_it_sees(value: Any) -> None:
    assert not state(value).opaque


def test_one_odd_thing_hides_no_other() -> None:
    one, other = State(Env(odd=Stubborn(), place=1)), State(Env(odd=Stubborn(), place=2))
    assert one.values != other.values
    assert one.opaque


def test_what_refers_back_to_the_environment_adds_nothing() -> None:
    one, other = Env(steps=1), Env(steps=2)
    one.player, other.player = Lock(marks=[one]), Lock(marks=[other])  # type: ignore[attr-defined]
    assert State(one).values["player"] == State(other).values["player"]


def test_equal_places_are_equal_whichever_they_are() -> None:
    place = (1, 2)
    assert State(Env(a=place, b=place)).values == State(Env(a=(1, 2), b=(1, 1 + 1))).values


def test_wrappers_hold_state_too() -> None:
    class Wrapper:
        def __init__(self, env: Env, count: int) -> None:
            self.env, self.count, self.unwrapped = env, count, env

    assert State(Wrapper(Env(a=1), 1)).values != State(Wrapper(Env(a=1), 2)).values
