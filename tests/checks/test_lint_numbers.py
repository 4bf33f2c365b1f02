"""Numbers that the check lint reports: inexact sums, negative indices, rewards without a limit, and what wraps."""

from __future__ import annotations

import pytest
from envcraft_checks.lint import Lint

from envcraft.model.target import Target
from envcraft.model.verdict import Severity
from tests.checks.lint_games import GAME, codes, pressed, subject_of


@pytest.mark.parametrize(
    ("added", "severity"),
    [
        ("0.1", Severity.ERROR),
        ("0.3 if action[0] else 0.1", Severity.WARNING),
        # The speed of an episode stays, and one of the three never meets the number.
        ("self.speed", Severity.ERROR),
        ("(0.1, 0.125, 0.2)[action[0] % 3]", Severity.WARNING),
    ],
)
@pytest.mark.parametrize("decides", ["self.done = self.x == 1.0", "if self.x == 1.0: self.phase = 'won'"])
def test_a_sum_that_only_some_orders_miss_is_a_warning(added: str, severity: Severity, decides: str) -> None:
    speed = "self.speed = (0.1, 0.125, 0.2)[int(self.np_random.integers(3))]"
    source = GAME.format(
        super="super().reset(seed=seed)",
        reset=f"self.x = 0.0; self.done = False; self.phase = ''; {speed}",
        step=f"self.x += {added}\n        {decides}",
        ended="self.done or self.phase == 'won'",
        see="return np.zeros(4)",
        more="",
    )
    with subject_of(Target("game.py", source.encode())) as subject:
        (finding,) = Lint().judge(subject)
    assert finding.severity is severity
    assert "is 0.9999999999999999" in finding.message
    assert ("no other sum is equal" in finding.message) == (severity is Severity.ERROR)


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("x = self.x - int(action[1])\ntry: self.x = int(self.grid[x, 0])\nexcept IndexError: self.x = 0", {}),
        ("x = self.x\nx -= 1\ntry: self.y = self.grid[x][0]\nexcept IndexError: self.y = 0", {}),
        ("dx = (-1, 1)[action[1]]\ntry: self.y = self.grid[self.x + dx][0]\nexcept IndexError: self.y = 0", {}),
        (
            "self._go(self.x - 1)",
            {"go": "\n        try: self.x = self.grid[code, 0]\n        except IndexError: return"},
        ),
    ],
)
def test_a_border_that_only_an_exception_guards(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {"EC058": False}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("x = self.x - 1\ntry: self.x = -9 if x < 0 else self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("x = max(self.x - 1, 0)\ntry: self.x = self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("x = (self.x - 1) % 9\ntry: self.x = self.grid[x, 0]\nexcept IndexError: self.x = 0", {}),
        ("try: self.x = self.grid[self.x + 1, 0]\nexcept IndexError: self.x = 0", {}),
        ("try: self.x = self.record[int(action[0])]\nexcept IndexError: self.x = 0", {}),
        ("x = self.x - 1\ntry: self.x = {1: 2}[x]\nexcept KeyError: self.x = 0", {}),
    ],
)
def test_a_border_that_is_tested(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {}


HIT = "self.streak += 1\nif action[2]: self.streak = 0"


@pytest.mark.parametrize(
    ("step", "certain"),
    [
        (f"{HIT}\nreward += 0.1 * 2 ** (self.streak // 3)", False),
        (f"{HIT}\nreward += 2 ** (0.1 * self.streak)", False),
        (f"{HIT}\nreward += 1.1**self.streak", False),
        ("self.streak += 1\nreward += 2**self.streak", False),
        (f"{HIT}\nbonus = 1.5**self.streak\nreward = bonus if action[1] else 0.0", True),
        (f"{HIT}\nreward += self._go(1)", True),
        (f"{HIT}\nreward += np.power(2.0, self.streak)", True),
        ("self.streak = 1 + self.streak if action[1] else 0\nreward += 2**self.streak", True),
    ],
)
def test_a_reward_that_doubles_without_end(step: str, certain: bool) -> None:
    assert pressed(step, go="return 1 << self.streak") == {"EC071": certain}


@pytest.mark.parametrize(
    "step",
    [
        "self.streak += 1\nreward += min(2**self.streak, 8)",
        "self.streak = min(self.streak + 1, 5)\nreward += 2**self.streak",
        "self.streak += 1\nif self.streak > 4: self.streak = 0\nreward += 2**self.streak",
        "self.streak += 1\nreward += 2**self.streak\nreward = float(np.clip(reward, -1, 1))",
        "self.streak += 1\nreward += 0.9**self.streak",
        "self.streak += 1\nreward += 2 ** (3 - self.streak)",
        "self.streak += 1\nself.x = 2**self.streak\nreward += self.see()",
        "self.streak += 1\nreward += 2 ** min(self.streak, 4)",
        "self.streak += 1\nself.streak %= 4\nreward += 2**self.streak",
        "if self.lamps:\n    self.lamps.pop()\n    self.streak += 1\n    reward += 2**self.streak",
    ],
)
def test_a_reward_with_a_limit(step: str) -> None:
    assert pressed(step) == {}


@pytest.mark.parametrize(
    ("step", "certain"),
    [
        ("self.hearts -= 2\nif self.hearts < 0: self.x = 9", True),
        ("self.hearts -= np.uint8(1)\nreward -= self.hearts < 0", True),
        ("self.hearts -= np.uint8(2 if action[1] else 1)\nif self.hearts == 0: self.x = 9", False),
        ("self.lives[0] -= 3\nself.x = int(self.lives[0] <= 0)", False),
    ],
)
def test_an_unsigned_number_that_wraps(step: str, certain: bool) -> None:
    assert pressed(step) == {"EC059": certain}


@pytest.mark.parametrize(
    "step",
    [
        "self.hearts -= 1\nif self.hearts == 0: self.x = 9",
        "if self.hearts > 1: self.hearts -= 2\nif self.hearts == 0: self.x = 9",
        "self.hearts -= min(self.hearts, 2)\nif self.hearts == 0: self.x = 9",
        "self.hearts = np.uint8(max(0, int(self.hearts) - 2))\nif self.hearts == 0: self.x = 9",
        "self.hearts = int(self.hearts) - 2\nif self.hearts < 0: self.x = 9",
        "self.x -= 2\nif self.x < 0: self.x = 0",
    ],
)
def test_a_number_that_does_not_wrap(step: str) -> None:
    assert pressed(step) == {}


@pytest.mark.parametrize("moved", ["self.w += action[0] - 2", "self.w = self.w + action[0] - 2", "self.w += 1"])
def test_a_number_that_the_next_statement_clips(moved: str) -> None:
    step = f"{moved}\nself.w = min(max(self.w, 0), 9)\nif action[1] and self.w < {{}}: self.y += 1"
    assert pressed(step.format(2), reset="self.w = 5", go="pass") == {}
    assert pressed(step.format(0), reset="self.w = 5", go="pass") == {"EC059": True}


@pytest.mark.parametrize(
    ("test", "expected"),
    [
        ("self.w + 4 >= 20", {"EC059": True}),
        ("20 <= self.w + 4", {"EC059": True}),
        ("self.w - 4 >= 6", {"EC059": True}),
        ("self.w + 11 >= 20", {}),
        ("self.w + self.y >= 20", {}),
    ],
)
def test_a_number_that_is_clipped_after_a_choice_of_moves(test: str, expected: dict[str, bool]) -> None:
    step = f"""if action[0] == 3: self.w -= 2
elif action[0] == 4: self.w += 2
self.w = float(np.clip(self.w, 0, 9))
won = {test}
reward += float(won)"""
    assert pressed(step, reset="self.w = 5.0", go="pass") == expected


FISH = "FISH = {'carp': (2, 'red'), 'pike': (3, 'blue')}"
ROWS = "FISH = [[1, 'a'], [2, 'b']]"


@pytest.mark.parametrize(
    ("table", "added", "expected"),
    [
        (FISH, "self.FISH['pike'][0]", {"EC056"}),
        (FISH, "self.FISH[self.kind][0]", {"EC056"}),
        (ROWS, "self.FISH[action[0] % 2][0]", {"EC056"}),
        (ROWS, "self.FISH[0][0]", set()),
        (FISH, "self.FISH[self.kind][1:]", set()),
        ("FISH = make()", "self.FISH[self.kind][0]", set()),
    ],
)
def test_a_count_that_adds_numbers_of_a_table(table: str, added: str, expected: set[str]) -> None:
    step = f"if action[1]: self.basket += {added}"
    reset = "self.basket, self.kind = 0, 'carp'"
    assert codes(reset=reset, step=step, ended="self.basket == 7", more=table) == expected


@pytest.mark.parametrize(
    ("shade", "expected"),
    [
        ("(40 + 24 * self.heat).astype(np.uint8)", {"EC069": True}),
        ("(self.heat * 24).astype(np.uint8)", {"EC069": True}),
        ("(40 + 19 * self.heat).astype(np.uint8)", {}),
        ("np.clip(40 + 24 * self.heat, 0, 255).astype(np.uint8)", {}),
        ("(40 + 24 * self.heat).astype(np.int64)", {}),
    ],
)
def test_a_shade_that_wraps(shade: str, expected: dict[str, bool]) -> None:
    step = f"self.heat += 1\nif (self.heat >= 12).any(): self.heat[:] = 0\nself.shown = {shade}"
    assert pressed(step, reset="self.heat = np.zeros(4, dtype=np.int64)") == expected
