"""Detection of degenerate repairs, and of none among proper ones."""

from __future__ import annotations

import pytest
from envcraft_llm.degenerate import degenerate_reason, structure

from envcraft.generation.stages import Attempt

from .content import GAME, GUTTED, brief
from .scripted import PROFILE, finding, report

BRIEF = brief() + "\nThe numbers are 7, 12, 200, 3, 10, 5, 4, 6, 90, 220, 120, 150, 40, 82 and 30.\n"
ONE_LINE = "class GameEnv(gym.Env):\n    def step(self, action):\n        return 0\n"

BAD = {
    "everything": (GUTTED, "rewards"),
    "an empty game": (ONE_LINE, "size"),
    "no reward on the way": (
        GAME.replace("reward += HIT_PAY", "pass").replace("reward += self._grab(grab)", "self._grab(grab)"),
        "rewards",
    ),
    "no win": (
        GAME.replace("self.over = self.won = True", "self.over = True")
        .replace('"is_success": bool(self.won)', '"is_success": False')
        .replace("self.over = self.won = False", "self.over = False"),
        "winning",
    ),
    "no chance": (GAME.replace("self.np_random.integers", "self._middle"), "chance"),
    "no second button": (GAME.replace("int(action[2])", "1"), "controls"),
    "no buttons": (GAME.replace("int(action[1]), int(action[2])", "1, 1"), "controls"),
    "the numbers of another game": (
        GAME.replace("(90, 220, 120)", "(9, 9, 9)")
        .replace("(120, 220, 250)", "(8, 8, 8)")
        .replace("LIMIT = 200", "LIMIT = 900")
        .replace("(150, 90, 40)", "(7, 7, 7)")
        .replace("KEY_PAY = 3.0", "KEY_PAY = 1.5")
        .replace("DOOR_PAY = 10.0", "DOOR_PAY = 1.0")
        .replace("30, np.uint8", "31, np.uint8")
        .replace("(220, 40, 40)", "(6, 6, 6)")
        .replace("= 200\n        if", "= 201\n        if")
        .replace("(240, 220, 60)", "(1, 1, 1)")
        .replace("(70, 70, 40)", "(1, 1, 1)")
        .replace("-5.0", "-1.0"),
        "parameters",
    ),
}
GOOD = {
    "nothing changed": GAME,
    "a limit": GAME.replace("LIMIT = 200", "LIMIT = 300"),
    "a guard for the edge": GAME.replace(
        "self.guard += self.heading", "self.guard = min(max(self.guard + self.heading, 0), 6)"
    ),
    "another generator": GAME.replace("self.np_random.integers(0, SIZE)", "self.np_random.integers(SIZE)"),
    "the global generator": GAME.replace("self.np_random.integers", "np.random.randint"),
    "a helper less": GAME.replace("    def close(self):\n        pass\n", ""),
    "a reward less": GAME.replace("            reward += HIT_PAY\n", ""),
    "actions taken apart at once": GAME.replace(
        "move, grab, light = int(action[0]), int(action[1]), int(action[2])",
        "move, grab, light = (int(part) for part in action)",
    ),
    "actions under another name": GAME.replace(
        "move, grab, light = int(action[0]), int(action[1]), int(action[2])",
        "a = [int(v) for v in action]\n        move, grab, light = a",
    ),
    "a syntax error": GAME.replace("def step(self", "def step(self:"),
}


def caught(source: str, first: str = GAME, profile: dict[str, int] | None = None, codes: str = "") -> str:
    found = [finding(codes)] if codes else []
    before = Attempt(0, first, profile=dict(PROFILE), report=report(first, *found))
    return degenerate_reason(BRIEF, before, before, Attempt(1, source, profile=dict(PROFILE) | (profile or {})))


@pytest.mark.parametrize("name", BAD)
def test_degenerate_repairs_are_detected(name: str) -> None:
    source, words = BAD[name]
    assert source != GAME
    assert caught(source).startswith(words)


@pytest.mark.parametrize("name", GOOD)
def test_proper_repairs_are_not_degenerate(name: str) -> None:
    assert (GOOD[name] != GAME) == (name != "nothing changed")
    assert caught(GOOD[name]) == ""


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        ({"frames": 150}, "play: the same moves lead to 150 different frames"),
        ({"rewards": 1}, "play: the same moves earn 1 different"),
        ({"moves": 2}, "play: 2 of the moves differ"),
        ({"frames": 250}, ""),
        ({"frames": 150, "steps": 350}, ""),
        ({"frames": 500, "steps": 9000}, ""),
        ({"rewards": 2}, ""),
        ({"moves": 5}, ""),
        ({"steps": 5, "frames": 1, "rewards": 0, "moves": 0}, ""),
    ],
)
def test_degenerate_behaviour_is_detected(profile: dict[str, int], words: str) -> None:
    said = caught(GAME, profile=profile)
    assert said.startswith(words) if words else said == ""


def test_removed_noise_is_not_degenerate() -> None:
    assert caught(GAME, profile={"frames": 150}, codes="EC402") == ""


def test_small_steps_are_compared_with_the_first_attempt() -> None:
    def attempt(number: int, lines: int) -> Attempt:
        return Attempt(
            number, GAME + "".join(f"\n\ndef rule_{n}(x):\n    y = x + 1\n    return y\n" for n in range(lines))
        )

    whole, most, half = attempt(0, 100), attempt(1, 57), attempt(2, 28)
    assert degenerate_reason("", whole, whole, half).startswith("size")
    assert degenerate_reason("", whole, whole, most) == ""
    assert degenerate_reason("", most, most, half) == ""
    assert degenerate_reason("", whole, most, half).endswith("of the first attempt")


def test_a_source_that_does_not_parse_is_compared_by_lines() -> None:
    broken = GAME.replace("def step(self", "def step(self:")
    assert caught(GAME, first=broken) == ""
    assert caught(ONE_LINE, first=broken).startswith("size: 3 lines are left of the ")
    assert caught("pass", first=broken).startswith("size: 1 line is left of the ")


def test_structures() -> None:
    found = structure(GAME)
    assert found is not None
    assert found.parts == {0, 1, 2}
    assert found.random
    assert structure("def f(:") is None


def test_deeply_nested_code_has_a_structure() -> None:
    found = structure(f"def step(action):\n    a = action[1]\n    b = grid{'[0]' * 400}\n")
    assert found is not None
    assert found.parts == {1}
