"""What lint says of tables that a level reads, of copies that share their items, and of loads that skip a number."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import found

GAME = """
import copy
import gymnasium as gym
PRICES, REACH, MORE = (2, 3, 5), (1, 2, 3), (1, 2, 3, 4)
DEAR, MODES, GROWN = (2, 3, float("inf")), ("net", "rod", "magnet"), [1, 2, 3]
GROWN.append(4)
KINDS = {{"plum": {{"speed": 2}}, "pear": {{"speed": 3}}}}
LOAD = 15
class Tower:
    def __init__(self, x):
        self.x, self.level = x, 0
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = self.coins = self.load = 0
        self.tower, self.towers = Tower(3), [Tower(1), Tower(2)]
        self.fruit = []
        {reset}
        return self.t, {{}}
    def step(self, action):
        self.t += 1
        self.coins += int(action[0] == 1)
        {step}
        won = {won}
        return self.t, float(won), won, self.t > 99, {{"is_success": won}}
    def grow(self):
        {grow}
"""
BUY = "if action[1] and {test}:\n    self.tower.level += 1\n"
SHOOT = "self.coins -= REACH[self.tower.level]"
BOUGHT = BUY.format(test="self.tower.level < len(PRICES)")
SCOPE = {"EC053", "EC056", "EC080"}


def codes(step: str, reset: str = "pass", grow: str = "pass", won: str = "self.coins > 20") -> set[str]:
    parts = {"step": step, "reset": reset, "grow": grow}
    return (
        found(GAME.format(won=won, **{name: text.replace("\n", "\n        ") for name, text in parts.items()})) & SCOPE
    )


@pytest.mark.parametrize(
    "test",
    [
        "self.tower.level < len(PRICES)",
        "self.tower.level < 3",
        "self.tower.level <= len(PRICES) - 1",
        "self.tower.level < len(PRICES) and action[2]",
        "len(PRICES) > self.tower.level",
    ],
)
def test_a_level_that_outgrows_a_table(test: str) -> None:
    assert codes(BUY.format(test=test) + SHOOT) == {"EC080"}


@pytest.mark.parametrize(
    "step",
    [
        BOUGHT + "self.coins -= MORE[self.tower.level]",
        BUY.format(test="self.tower.level < len(PRICES) - 1") + SHOOT,
        BUY.format(test="self.tower.level < 2") + SHOOT,
        BUY.format(test="self.tower.level < len(PRICES) or self.t > 4") + SHOOT,
        BUY.format(test="self.t < 5") + SHOOT,
        BOUGHT + "self.coins -= REACH[min(self.tower.level, 2)]",
        BOUGHT + "if self.tower.level < 3:\n    " + SHOOT,
        BUY.format(test="self.tower.level < len(PRICES) and self.coins > PRICES[self.tower.level]"),
        BOUGHT + "self.tower.level %= 3\n" + SHOOT,
        BOUGHT + f"try:\n    {SHOOT}\nexcept IndexError:\n    pass",
        BOUGHT + f"level = self.tower.level\nif level == 3: level = 2\n{SHOOT}",
        BUY.format(test="self.tower.level < len(DEAR)") + SHOOT,
        BOUGHT + "self.coins -= GROWN[self.tower.level]",
        BOUGHT + "if MODES[self.tower.level] == 'magnet' or self.coins < REACH[self.tower.level]: self.coins = 0",
        BOUGHT + f"left = 3 - self.tower.level\nif left: {SHOOT}",
        BOUGHT + f"if not self.best(self.tower.level): {SHOOT}",
        BOUGHT + "    self.bought = True\n" + SHOOT,
        BUY.format(test="self.t % 50 == 0 and self.tower.level < len(PRICES)") + SHOOT,
        BUY.format(test="self.coins >= PRICES[self.tower.level] and self.tower.level < len(PRICES)") + SHOOT,
        BOUGHT + "with contextlib.suppress(IndexError):\n    " + SHOOT,
        BOUGHT.replace("level += 1", "level += 1; self.pay()") + SHOOT,
        BOUGHT + "    self.celebrate()\n" + SHOOT,
        BOUGHT + "for level in self.towers:\n    self.coins -= REACH[level.level]",
        BOUGHT + BUY.format(test="self.tower.level < 1") + SHOOT,
    ],
)
def test_a_level_that_fits(step: str) -> None:
    assert codes(step) == set()


def test_a_level_that_is_paid_for() -> None:
    price = "self.coins -= PRICES[self.tower.level]\n    self.tower.level += 1"
    test = "self.tower.level < len(PRICES) and self.coins >= PRICES[self.tower.level]"
    assert codes(
        BUY.format(test=test).replace("self.tower.level += 1", price) + "self.x = REACH[self.tower.level]"
    ) == {"EC080"}


def test_a_level_that_ends_the_episode() -> None:
    assert codes(BOUGHT + SHOOT, won="self.tower.level == 3") == set()


FASTER = "for kind in self.kinds.values():\n    kind['speed'] = kind['speed'] + 1"


@pytest.mark.parametrize(
    "copied",
    [
        "KINDS",
        "dict(KINDS)",
        "KINDS.copy()",
        "copy.copy(KINDS)",
        "{**KINDS}",
        "{name: kind for name, kind in KINDS.items()}",
    ],
)
@pytest.mark.parametrize(
    "step", [FASTER, "self.kinds['plum']['speed'] = max(4, self.kinds['plum']['speed'] - 1)"], ids=["loop", "item"]
)
def test_copies_with_the_same_items(copied: str, step: str) -> None:
    assert codes(step, reset=f"self.kinds = {copied}") == {"EC053"}


@pytest.mark.parametrize(
    ("step", "copied"),
    [
        (FASTER, "copy.deepcopy(KINDS)"),
        (FASTER, "{name: dict(kind) for name, kind in KINDS.items()}"),
        (FASTER, "{name: {**kind} for name, kind in KINDS.items()}"),
        ("for kind in self.kinds.values():\n    kind['speed'] = self.t", "dict(KINDS)"),
        ("for kind in self.kinds:\n    self.kinds[kind] = {'speed': self.t}", "dict(KINDS)"),
        (FASTER, "dict(KINDS)\nfor name in self.kinds: self.kinds[name] = dict(self.kinds[name])"),
        (FASTER, "dict(KINDS)\nself.__dict__.update(copy.deepcopy(KINDS))"),
        ("for kind in self.kinds.values(): kind.setdefault('tile', 3)", "dict(KINDS)"),
        ("for kind in self.kinds.values():\n    kind['speed'] += 2\n    kind['speed'] -= 2", "dict(KINDS)"),
    ],
)
def test_copies_of_their_own(step: str, copied: str) -> None:
    assert codes(step, reset=f"self.kinds = {copied}") == set()


def test_a_table_that_reset_writes_back() -> None:
    assert (
        codes(FASTER, reset="self.kinds = dict(KINDS)\nfor kind in self.kinds.values():\n    kind['speed'] = 2")
        == set()
    )


GROW = "worth = 3 if self.np_random.random() < 0.5 else 1\nself.fruit.append((self.t, worth))"
TAKE = "for fruit in list(self.fruit):\n    self.fruit.remove(fruit)\n    self.load += fruit[1]\nself.grow()"
NAMED = "for place, worth in self.fruit:\n    self.load += worth\nself.grow()"


@pytest.mark.parametrize("step", [TAKE, NAMED])
def test_a_load_of_two_weights_skips_the_number(step: str) -> None:
    assert codes(step, grow=GROW, won="self.load == LOAD") == {"EC056"}


@pytest.mark.parametrize(
    ("step", "grow", "won"),
    [
        (TAKE, GROW, "self.load >= LOAD"),
        (TAKE, GROW.replace("3 if", "1 if"), "self.load == LOAD"),
        (TAKE, GROW.replace("self.t, worth", "worth, self.t"), "self.load == LOAD"),
        (TAKE, GROW + "\nself.fruit.append(self.other())", "self.load == LOAD"),
        (TAKE, GROW + "\nself.other(self.fruit)", "self.load == LOAD"),
        (TAKE.replace("self.load +=", "if self.load + fruit[1] <= LOAD: self.load +="), GROW, "self.load == LOAD"),
        (TAKE.replace("self.load +=", "if self.t > self.load: self.load +="), GROW, "self.load == LOAD"),
        (TAKE.replace("self.load +=", "if fruit[1] < 2: self.load +="), GROW, "self.load == LOAD"),
        ("room = LOAD - self.load\n" + TAKE, GROW, "self.load == LOAD"),
        ("if action[1]: self.load = 0\n" + TAKE, GROW, "self.load == LOAD"),
        ("if self.load >= 2: self.load -= 2", GROW, "self.load == 1"),
        ("for coin in list(self.towers):\n    self.towers.remove(coin)\n    self.load += 2", GROW, "self.load == 1"),
        (TAKE.replace("\nself.grow()", ""), GROW, "self.load == LOAD"),
    ],
)
def test_a_load_that_may_meet_the_number(step: str, grow: str, won: str) -> None:
    assert codes(step, grow=grow, won=won) == set()
