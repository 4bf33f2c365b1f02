"""What lint says of loops that remove items from what they iterate over."""

from __future__ import annotations

import ast
from collections.abc import Sequence

import pytest
from envcraft_checks.linting.iterated import shrinking_loops
from envcraft_checks.linting.program import Program, Suspect

GAME = """
import gymnasium as gym
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.items, self.t, self.left = {made}, 0, 3
        return 0, {{}}
    def step(self, action):
        self.t += 1
        {body}
        return 0, 0.0, False, self.t >= 100, {{}}
"""
REMOVE = "        self.items.remove(item)"
LOOP = "for item in self.items:"


def suspects(body: Sequence[str], made: str = "[1, 2]") -> list[Suspect]:
    return list(shrinking_loops(Program(ast.parse(GAME.format(made=made, body="\n        ".join(body))))))


@pytest.mark.parametrize(
    ("body", "certain"),
    [
        ([LOOP, "    if item.end == self.t:", REMOVE], True),
        ([LOOP, "    if self.t == item['end']:", REMOVE], True),
        (
            ["for number, item in enumerate(self.items):", "    if item == self.t:", "        self.items.pop(number)"],
            True,
        ),
        ([LOOP, "    if item.end <= self.t:", REMOVE], False),
        ([LOOP, "    if item.end == self.left:", REMOVE, "self.left -= 1"], False),
        ([LOOP, "    if item.end == action:", REMOVE], False),
        ([LOOP, "    if item:", REMOVE, "        continue"], False),
        ([LOOP, "    if item:", "        del self.items[0]"], False),
    ],
)
def test_removals_from_a_list_in_a_loop_over_it(body: list[str], certain: bool) -> None:
    [suspect] = suspects(body)
    assert suspect.certain is certain
    assert "skips the next item" in suspect.words
    assert ("holds only once" in suspect.words) is certain


@pytest.mark.parametrize(
    ("made", "body"),
    [
        ("{1: 2, 3: 4}", [LOOP, "    if item > self.t:", "        del self.items[item]"]),
        ("unknown()", ["for key, item in self.items.items():", "    if item:", "        self.items.pop(key)"]),
        ("{1, 2}", [LOOP, "    if item > self.t:", "        self.items.discard(item)"]),
        ("deque([1, 2])", [LOOP, "    self.items.popleft()"]),
    ],
)
def test_containers_that_must_keep_their_size(made: str, body: list[str]) -> None:
    [suspect] = suspects(body, made)
    assert suspect.certain
    assert "RuntimeError" in suspect.words


@pytest.mark.parametrize(
    "body",
    [
        ["for item in list(self.items):", "    if item.end == self.t:", REMOVE],
        ["for item in self.items[:]:", "    if item.end == self.t:", REMOVE],
        ["for item in self.items.copy():", "    if item.end == self.t:", REMOVE],
        [LOOP, "    if item.end == self.t:", REMOVE, "        break"],
        [LOOP, "    if item:", "        if self.t:", f"    {REMOVE}", "        break"],
        [LOOP, "    if item:", "        return self.items.pop(), 0.0, True, False, {}"],
        ["for item in self.others:", "    if item.end == self.t:", REMOVE],
        [LOOP, "    item.parts.remove(self.t)"],
        [LOOP, "    self.items.append(item)", "    break"],
        ["while self.items:", "    item = self.items[0]", "    self.items.remove(item)"],
    ],
)
def test_loops_that_lose_nothing(body: list[str]) -> None:
    assert suspects(body) == []
