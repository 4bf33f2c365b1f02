"""Equal values that the check lint reports: changes that are always zero, and one part of an action under two names."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import pressed

COUNT = (
    "\n    def count(self):\n        return int(self.grid.sum()) + self.x\n    def move(self):\n        self.x += 1\n"
)
DECIDES = "\nif before > after: self.x = 0"


@pytest.mark.parametrize(
    "step",
    [
        "before = self.count()\nafter = self.count()",
        "before, after = self.x, self.x",
        "before = abs(self.x - 3)\nafter = abs(self.x - 3)",
        "self.x += 1\nbefore = self.x\nself.streak = 2\nafter = self.x",
        "before = self.count()\nif action[0]: reward = 1.0\nafter = self.count()",
        "before = self.x\nfor _ in range(2):\n    after = self.x\n    if before < after: reward = 1",
        "self.move()\nbefore = self.x\nprint(before)\nafter = before",
        "before = self.x\nif action[0]:\n    self.move()\n    return 0, 0.0, False, False, {}\nafter = self.x",
    ],
)
def test_values_with_no_change_in_between(step: str) -> None:
    assert pressed(step + DECIDES, more=COUNT) == {"EC059": True}


def test_a_difference_from_a_value_that_is_read_too_late() -> None:
    assert pressed("self.x += int(action[0])\nold = self.x\nreward = float(self.x - old)") == {"EC059": True}
    assert pressed("old = self.x\nself.x += int(action[0])\nreward = float(self.x - old)") == {}


@pytest.mark.parametrize(
    "step",
    [
        "before = self.count()\nself.move()\nafter = self.count()",
        "before = self.count()\nself.grid[0, 0] = action[1]\nafter = self.count()",
        "before = self.x\nif action[0]: self.move()\nafter = self.x",
        "before = after = self.x\nif action[0]: after += 1",
        "before, after = self.x, self.x\nif action[0]: after = 3",
        "after = self.count()\nfor _ in range(2):\n    before = after\n    self.move()\n    after = self.count()",
        "before = self.x\nfor _ in range(2):\n    after = self.x\n    if after > before: reward += 1\n    self.x += 1",
        "before = self.np_random.integers(6)\nafter = self.np_random.integers(6)",
        "rolls = iter((1, 2))\nbefore = next(rolls)\nafter = next(rolls)",
        "rolls = [int(self.x), 2]\nbefore = rolls.pop()\nafter = rolls.pop()",
        "before = self.count()\nunknown(self)\nafter = self.count()",
        "before = self.grid.sum()\ngrid = self.grid\ngrid += 1\nafter = self.grid.sum()",
        "before = self.grid.tolist()\nafter = self.grid.tolist()\nafter.append([self.x])",
        "before = self.x\ntry:\n    self.move()\n    self.y //= 2\nexcept ValueError: pass\nafter = self.x",
        "self.kept = self.grid.tolist()\nafter = self.grid.tolist()\nself.kept.append(1)\nbefore = self.kept",
        # Neither is a change: the one is a constant of the game, the other a number.
        "before, after = self.total, self.total",
        "before = 3\nafter = 3",
    ],
)
def test_values_with_a_possible_change_in_between(step: str) -> None:
    assert "EC059" not in pressed(step + DECIDES, more=COUNT)


def test_a_property_may_have_changed() -> None:
    more = "\n    @property\n    def far(self):\n        self.x += 1\n        return self.x\n"
    assert "EC059" not in pressed("before = self.far\nafter = self.far" + DECIDES, more=more)


USED = "\nself._go(int(action[0]), one + two)"


@pytest.mark.parametrize(
    ("step", "certain"),
    [
        ("one, two = int(action[1]), int(action[1])", True),
        ("one = action[-1] == 1\ntwo = action[-1] == 1", True),
        ("keys = np.asarray(action)\none = bool(keys[2])\ntwo = bool(keys[2])", True),
        # The same button may have two names by design.
        ("one = int(action[1])\ntwo = int(action[1])\nself.y += int(action[1])", False),
    ],
)
def test_one_part_of_the_action_under_two_names(step: str, certain: bool) -> None:
    assert pressed(step + USED, go="self.x += code * far") == {"EC059": certain}


@pytest.mark.parametrize(
    "step",
    [
        "one, two = int(action[1]), 0",
        "one, two = int(action[1]), int(action[2])",
        "one, two = int(action[1]), int(action[1])\nself.y += int(action[2])",
        "one, two = int(action[1]), int(action[1])\nself.y = sum(int(part) for part in action)",
        "one, two = int(action[1]), int(action[1])\n_, _, self.y = action",
        "one, two = int(action[1]), int(action[1])\nself.y = int(action[1:].sum())",
        "one, two = int(action[1]), int(action[1])\nself.y = unknown(action)",
        "one, two = int(action[1]), int(action[1])\nself.y = int(action[self.x])",
        "one, last_two = int(action[1]), int(action[1])\ntwo = last_two",
        "one = two = 0\nif self.y: one = int(action[1])\nelse: two = int(action[1])",
        "one, two = int(action[1]), int(action[1]) and not self.y",
    ],
)
def test_parts_of_the_action_that_the_code_may_read(step: str) -> None:
    assert "EC059" not in pressed(step + USED, go="self.x += code * far")
