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
    "body",
    [
        [LOOP, "    if item.end == self.t:", REMOVE],
        [LOOP, "    if item:", REMOVE, "        continue"],
        [LOOP, "    if item:", REMOVE, "    else:", "        self.left = 2"],
        ["for number, item in enumerate(self.items):", "    if item == self.t:", "        self.items.pop(number)"],
        ["for number, item in enumerate(self.items):", "    if item == self.t:", "        del self.items[number]"],
        ["for other in [1, 2]:", "    for item in self.items:", "        if item:", f"    {REMOVE}", "    break"],
    ],
)
def test_a_list_skips_the_next_item(body: list[str]) -> None:
    [suspect] = suspects(body)
    assert not suspect.certain
    assert suspect.words == "removes an item of self.items in a loop over it, so the loop skips the next item"


@pytest.mark.parametrize(
    ("made", "body"),
    [
        ("{1: 2, 3: 4}", [LOOP, "    if item > self.t:", "        del self.items[item]"]),
        ("{1: 2, 3: 4}", ["for key, item in self.items.items():", "    if item:", "        self.items.pop(key)"]),
        ("{1, 2}", [LOOP, "    if item > self.t:", "        self.items.discard(item)"]),
        ("deque([1, 2])", [LOOP, "    self.items.popleft()"]),
    ],
)
def test_a_dict_a_set_or_a_deque_raises(made: str, body: list[str]) -> None:
    [suspect] = suspects(body, made)
    assert suspect.certain
    assert "RuntimeError" in suspect.words


@pytest.mark.parametrize("made", ["[1, 2]", "{1, 2}"])
@pytest.mark.parametrize(
    "body",
    [
        ["for item in list(self.items):", "    if item.end == self.t:", REMOVE],
        ["for item in self.items[:]:", "    if item.end == self.t:", REMOVE],
        ["for item in self.items.copy():", "    if item.end == self.t:", REMOVE],
        ["for item in self.others:", "    if item.end == self.t:", REMOVE],
        ["while self.items:", "    item = self.items[0]", "    self.items.remove(item)"],
        # The loop ends.
        [LOOP, "    if item.end == self.t:", REMOVE, "        break"],
        [LOOP, "    if item:", "        if self.t:", f"    {REMOVE}", "        break"],
        [LOOP, "    if item:", "        return self.items.remove(item), 0.0, True, False, {}"],
        [LOOP, "    if item:", REMOVE, "    if self.t not in self.items:", "        break"],
        [LOOP, "    try:", REMOVE, "    except KeyError:", "        continue", "    else:", "        break"],
        # The removal comes after the loop, or later.
        [LOOP, "    self.left = item", "else:", "    item = 3", "    self.items.remove(item)"],
        [LOOP, "    self.later.append(lambda item=item: self.items.remove(item))"],
        [LOOP, "    def forget():", REMOVE, "    self.later.append(forget)"],
        # The loop has another object, or the item is another one.
        [LOOP, "    if item:", "        self.items = type(self.items)(self.items)", REMOVE],
        [LOOP, "    self.items.remove(item)", "    self.items[0] = item"],
        [LOOP, "    item.parts.remove(item)"],
        [LOOP, "    if item is self.last:", "        self.items.remove(self.first)"],
        [
            "for number, item in enumerate(self.items):",
            "    self.items.pop(number)",
            "    self.items.insert(number, 3)",
        ],
    ],
)
def test_loops_that_lose_nothing(body: list[str], made: str) -> None:
    assert suspects(body, made) == []


@pytest.mark.parametrize(
    "made", ["pygame.sprite.Group()", "unknown()", "[1, 2] if options else unknown()", "OrderedDict()"]
)
def test_other_containers_may_allow_it(made: str) -> None:
    assert suspects([LOOP, "    if item:", REMOVE], made) == []
