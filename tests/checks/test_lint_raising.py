"""What lint says of lines that raise, results that are dropped, and numbers that are not what their names say."""

from __future__ import annotations

import numpy as np
import pytest
from envcraft_checks.linting.undefined import OUTDATED

from tests.checks.lint_games import found

GAME = """
import enum
import math
import numpy as np
import gymnasium as gym
PRICES = {{"jam": 1, "tea": 2}}
class Kind(enum.Enum):
    JAM = 1
class Colours:
    RED = 1
class Cart:
    def __init__(self, x, load=0):
        self.x, self.load = x, load
def near(one, other, reach=3, *, strict=False):
    return abs(one - other) < reach
class Game(gym.Env):
    {head}
    RADIUS, AREA = 30, 25
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = self.x = self.y = self.score = self.paid = 0
        self.shots, self.birds = [1], [2]
        self.wind = self.np_random.uniform(-1, 1)
        return self.x, {{}}
    def step(self, action):
        self.t += 1
        {step}
        return self.x, 0.0, False, self.t > 99, {{}}
    def move(self, by, twice=False):
        {move}
    @property
    def area(self):
        return 3
    def disc(self, radius):
        return radius
    def draw(self):
        return self.disc(self.RADIUS)
"""
CODES = {"EC059", "EC062", "EC076", "EC077", "EC078", "EC079"}


def filled(step: str, move: str = "pass", head: str = "pass") -> str:
    parts = {"step": step.replace("\n", "\n        "), "move": move.replace("\n", "\n        ")}
    return GAME.format(**parts, head=head)


def codes(step: str, move: str = "pass", head: str = "pass") -> set[str]:
    return found(filled(step, move, head)) & CODES


@pytest.mark.parametrize(
    "line",
    [
        "self.x = speed",
        "self.x = self.spede",
        "self.jump()",
        "self.x = RADIUS",
        "self.x = Kind.TEA",
        "self.x = Colours.BLUE",
        "self.x = math.sign(self.x)",
        "self.x = np.flaot64(3)",
        "self.x = self.np_random.randint(3)",
        "self.x = [one for one in self.shots if one > limit]",
    ],
)
def test_what_nothing_defines(line: str) -> None:
    assert codes(f"if self.x > 9:\n    {line}") == {"EC076"}
    assert codes(f"if self.x > 9:\n    try:\n        {line}\n    except Exception:\n        self.x = 0") == set()


@pytest.mark.parametrize(
    ("step", "move", "head"),
    [
        ("self.x = self.area + self.RADIUS + self.np_random.integers(3)", "pass", "pass"),
        ("self.x = self.speed", "setattr(self, 'speed', 3)", "pass"),
        ("self.x = self.speed", "for name in self.shots: setattr(self, name, 3)", "pass"),
        ("self.x = self.speed", "pass", "speed: int = 3"),
        ("self.x = self.speed", "pass", "def __getattr__(self, name): return 3"),
        ("self.x = getattr(self, 'speed', 3) or self.speed", "pass", "pass"),
        ("self.x = Kind['TEA'] or Kind.JAM.value or Colours.RED", "pass", "pass"),
        ("speed: Velocity = 3\nself.x = speed", "pass", "pass"),
        ("self.x = math.hypot(3, 4) + np.int64(3)", "pass", "pass"),
        ("self.x = self.spec.max_episode_steps or self.unwrapped.x", "pass", "pass"),
        ("self.x = self.rng.randint(3)", "self.rng = Dice()", "pass"),
    ],
)
def test_what_something_defines(step: str, move: str, head: str) -> None:
    assert codes(step, move, head) - {"EC076"} == set()
    assert "EC076" not in codes(step, move.replace("Dice()", "Cart(3)"), head)


def test_outdated_methods_are_those_that_only_old_generators_have() -> None:
    assert OUTDATED.isdisjoint(dir(np.random.Generator))
    assert {name for name in OUTDATED if hasattr(np.random.RandomState, name)} >= {"rand", "randint", "randn", "seed"}


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("self.move()", {"EC077"}),
        ("self.move(1, True, 3)", {"EC077"}),
        ("self.move(1, thrice=True)", {"EC077"}),
        ("self.move(1, by=3)", {"EC077"}),
        ("near(1)", {"EC077"}),
        ("near(1, 2, 3, True)", {"EC077"}),
        ("self.carts = [Cart()]", {"EC077"}),
        ("self.move(1)", set()),
        ("self.move(1, twice=True)", set()),
        ("self.move(*self.shots)", set()),
        ("self.move(**PRICES)", set()),
        ("near(1, 2, strict=True)", set()),
        ("self.carts = [Cart(1), Cart(x=1, load=2)]", set()),
        ("self.move = near\nself.move()", set()),
    ],
)
def test_arguments_that_a_function_does_not_take(line: str, expected: set[str]) -> None:
    assert codes(line) & {"EC077"} == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("np.clip(self.x, 0, 80)", {"EC078"}),
        ("sorted(self.birds)", {"EC078"}),
        ("self.np_random.permutation(self.birds)", {"EC078"}),
        ("self.x == 3", {"EC078"}),
        ("self.draw", {"EC078"}),
        ("np.clip(self.y, 0, 80, out=self.y)", set()),
        ("self.birds.sort()", set()),
        ("self.np_random.shuffle(self.birds)", set()),
        ("self.np_random.integers(3)", set()),
        ("self.move(3)", set()),
        ("self.area", set()),
    ],
)
def test_results_that_nothing_takes(line: str, expected: set[str]) -> None:
    assert codes(line) == expected


@pytest.mark.parametrize(
    ("test", "expected"),
    [
        ("self.x ** 2 + self.y ** 2 <= self.RADIUS", {"EC079"}),
        ("self.RADIUS > self.x * self.x + self.y * self.y", {"EC079"}),
        ("np.sum((self.x - 3) ** 2) < self.RADIUS", {"EC079"}),
        ("self.x ** 2 + self.y ** 2 <= self.RADIUS ** 2", set()),
        ("self.x ** 2 + self.y ** 2 <= self.AREA", set()),
        ("math.hypot(self.x, self.y) <= self.RADIUS", set()),
    ],
)
def test_squared_distances(test: str, expected: set[str]) -> None:
    assert codes(f"self.draw()\nif {test}:\n    self.x = 0") == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("int(self.wind)", {"EC059"}),
        ("3 * int(self.np_random.random())", {"EC059"}),
        ("int(self.wind * 3)", set()),
        ("int(self.np_random.uniform(0, 3))", set()),
        ("round(self.wind)", set()),
        ("int(self.y)", set()),
    ],
)
def test_fractions_that_vanish(value: str, expected: set[str]) -> None:
    assert codes(f"self.x += {value}") == expected


PAID = "reward = self.score - self.paid\nself.paid = self.score\n"


def test_a_change_that_is_paid_too_early() -> None:
    game = GAME.replace("return self.x, 0.0", "return self.x, reward")
    early = game.format(step=PAID.replace("\n", "\n        ") + "self.move(3)", move="self.score += by", head="pass")
    late = game.format(
        step="self.move(3)\n        " + PAID.replace("\n", "\n        "), move="self.score += by", head="pass"
    )
    assert found(early) & CODES == {"EC062"}
    assert found(late) & CODES == set()
