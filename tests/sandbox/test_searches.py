"""Searches of environments that cannot be copied: each branch plays its path again."""

from __future__ import annotations

import socket
from itertools import accumulate, pairwise
from typing import Any

import pytest
from envcraft_sandbox.worker import search
from envcraft_sandbox.worker.channel import Channel
from envcraft_sandbox.worker.subject import Subject
from envcraft_sandbox.worker.tree import Outcome, Tree

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.model.target import Target

STAIRS = """
import gymnasium as gym
import numpy as np

class Stairs(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (200, 300, 3), np.uint8)
    action_space = gym.spaces.Discrete(3)
    made = 0

    def __init__(self):
        Stairs.made += 1
        self.resets = 0

    def __deepcopy__(self, memo):
        raise TypeError("no copies")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        {reset}
        self.resets += 1
        self.at = 0
        return np.full((200, 300, 3), self.at, np.uint8), {{}}

    def step(self, action):
        self.at += int(action == 2) - int(action == 0)
        {step}
        return np.full((200, 300, 3), self.at % 256, np.uint8), float(action == 2), False, False, {{}}
"""

#: Each step from 1 to 0 pays; 5 is the success.
SPRING = """
import gymnasium as gym
import numpy as np

class Spring(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = gym.spaces.Discrete(3)
    made = 0

    def picture(self):
        return np.full((84, 84, 3), 40 * self.at, np.uint8)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        {reset}
        self.at = self.highest = 1
        return self.picture(), {{}}

    def step(self, action):
        before, highest = self.at, self.highest
        self.at = max(before + (0, 1, -1)[action], 0)
        self.highest = max(self.at, highest)
        {step}
        won = self.at == 5
        return self.picture(), float(self.at < before == 1), won, False, {{"is_success": won}}
"""


class Nobody(Channel):
    """A channel that nobody listens to."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_UNIX) as closed:
            super().__init__(closed)

    def _write(self, parts: list[bytes], size: int) -> None:
        pass


def searched(
    kind: str, reset: str = "pass", step: str = "pass", source: str = STAIRS, **limits: Any
) -> tuple[Outcome, int, Channel]:
    """The outcome of a search, how many instances it made, and its channel."""
    job: Any = {
        "kind": "search",
        "target": Target("stairs.py", source.format(reset=reset, step=step).encode()).for_worker(),
        "search": kind,
        "contract": GYMNASIUM.for_worker(),
        "seed": 0,
        "actions": [0, 1, 2],
        "max_steps": 300,
        "limit": 50,
        **limits,
    }
    channel = Nobody()
    subject = Subject(job, channel)
    subject.load()
    tree = Tree(subject, job)
    search._SEARCHES[kind](tree)
    return tree.out, subject.creator().made, channel


def test_one_instance_plays_all_branches() -> None:
    out, made, channel = searched("greedy")
    assert not out.copies
    assert out.best == [2] * 5
    assert made == 2
    assert channel.steps == out.steps == 15 + 3 * (1 + 2 + 3 + 4)


@pytest.mark.parametrize("kind", ["explore", "greedy"])
def test_an_instance_that_cannot_be_reset_again_is_replaced(kind: str) -> None:
    out, made, _ = searched(kind, reset="assert not self.resets")
    assert made > 5
    assert out.best_return > 0
    assert out.crash is None


def test_an_instance_that_crashed_is_replaced() -> None:
    out, made, _ = searched("greedy", step="assert self.at >= 0")
    assert out.crash == [0]
    assert made == 3


def test_a_loop_that_pays_again_is_found() -> None:
    out, _, _ = searched("explore", source=SPRING)
    assert out.loop is not None
    assert {1, 2} <= set(out.loop[-out.loop_length :])
    assert out.paid > 3
    assert out.json()["loop"] == out.loop


def test_a_loop_that_pays_once_is_none() -> None:
    out, _, _ = searched("explore", source=SPRING.replace("self.at < before == 1", "self.at > highest"))
    assert out.paid > 3
    assert out.loop is None


@pytest.mark.parametrize(("paid", "period"), [("self.on", 4), ("True", 2), ("self.presses < 8", 0)])
def test_a_switch_that_pays_again_is_a_loop(paid: str, period: int) -> None:
    """Action 2 presses a switch that must be let go, and the picture counts what it has paid."""
    switch = SPRING.replace("40 * self.at", "10 * self.presses % 250").replace(
        "float(self.at < before == 1)", f"float(pressed and {paid})"
    )
    step = (
        "pressed = action == 2 and not self.down; self.down = action == 2; self.presses += pressed; self.on ^= pressed"
    )
    out, _, _ = searched("explore", "self.presses = 0; self.on = self.down = False", step, switch)
    assert out.loop_length == period


def test_a_win_is_reached_by_simple_actions() -> None:
    pairs = [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1]]
    source = SPRING.replace("Discrete(3)", "MultiDiscrete([3, 2])").replace("[action]", "[action[0]]")
    out, _, _ = searched("reach", source=source, actions=pairs)
    assert out.win == [[1, 0]] * 4
    both = source.replace("won = self.at == 5", "self.at, won = min(self.at, 6), bool(action[0] and action[1])")
    assert searched("reach", source=both, actions=pairs)[0].win is None


def test_a_search_for_a_win_soon_leaves_out_a_button_without_effect() -> None:
    corridor = SPRING.replace("self.at == 5", "self.at == 60").replace("40 * self.at", "4 * self.at")
    buttons = corridor.replace("Discrete(3)", "MultiDiscrete([3, 9])").replace("[action]", "[action[0]]")
    pairs = [[move, button] for move in range(3) for button in range(9)]
    out, _, _ = searched("reach", source=buttons, actions=pairs, max_steps=10_000, limit=100)
    assert out.win is not None
    assert len(out.win) == 59
    assert out.steps < 20 * 11 + 45 * 3
    # A button that matters in one place only is tried if all else is.
    late = buttons.replace("won = self.at == 60", "self.at = min(self.at, 60); won = self.at == 60 and action[1] == 5")
    win = searched("reach", source=late, actions=pairs, max_steps=10_000, limit=100)[0].win
    assert win is not None
    assert win[-1] == [0, 5]


def test_a_search_that_reaches_no_win_is_exhausted_only_if_all_pictures_were_seen() -> None:
    never = SPRING.replace("won = self.at == 5", "self.at, won = min(self.at, 6), False")
    out, _, _ = searched("reach", source=never)
    assert (out.win, out.exhausted, out.states) == (None, True, 7)
    assert not searched("reach", source=never, max_steps=10)[0].exhausted


def test_an_exploration_sees_draws() -> None:
    assert searched("explore", step="self.np_random.random()", source=SPRING)[0].stochastic
    assert not searched("explore", source=SPRING)[0].stochastic


def test_an_exploration_that_time_ends_tells_new_states_of_its_own_second_half() -> None:
    outcome = searched("explore", step="self.at += 1; __import__('time').sleep(0.005)", max_steps=10_000, seconds=2.0)[
        0
    ]
    assert outcome.steps < 5_000
    assert 0 < outcome.late_states < outcome.states


def test_moves_that_no_picture_shows_lead_to_hidden_states() -> None:
    hidden = SPRING.replace("40 * self.at", "0").replace("won = self.at == 5", "won = False")
    assert searched("react", source=hidden)[0].states == 3
    assert searched("react", source=SPRING)[0].states == 1


def test_one_move_that_is_seen_shows_what_the_moves_control() -> None:
    hidden = SPRING.replace("40 * self.at", "0").replace("won = self.at == 5", "won = False")
    assert searched("vanish", source=hidden)[0].states == 3
    assert searched("vanish", source=SPRING)[0].states == 0
    right = SPRING.replace("40 * self.at", "40 * max(self.at, 0)").replace("won = self.at == 5", "won = False")
    assert searched("vanish", source=right)[0].states == 0


def test_the_last_action_is_no_hidden_state() -> None:
    still = SPRING.replace("(0, 1, -1)[action]", "0")
    assert searched("react", step="self.last = action", source=still)[0].states == 1


def test_the_way_that_a_figure_faces_is_no_hidden_state() -> None:
    still = SPRING.replace("(0, 1, -1)[action]", "0")
    facing = {"reset": "self.facing = 0", "step": "self.facing = action or self.facing"}
    assert searched("react", source=still, **facing)[0].states == 1
    # A move on three lanes reaches its lane at once, too, but the move before it matters.
    lanes = {"reset": "self.lane = 1", "step": "self.lane = min(max(self.lane + (0, 1, -1)[action], 0), 2)"}
    assert searched("react", source=still, **lanes)[0].states == 3


def test_states_that_differ_by_themselves_are_not_known() -> None:
    own = SPRING.replace("import numpy", "import itertools, numpy").replace(
        "class", "COUNT = itertools.count()\n\nclass"
    )
    assert searched("react", step="self.count = next(COUNT)", source=own)[0].states == 0


def test_moves_that_end_the_episode_soon_are_held_for_less_time() -> None:
    hidden = SPRING.replace("40 * self.at", "0").replace("won = self.at == 5", "won = self.moved == 6")
    found = searched("react", reset="self.moved = 0", step="self.moved += int(action > 0)", source=hidden)[0]
    assert found.states == 3


def test_an_exploration_tells_where_one_picture_is_shown_for_long() -> None:
    stuck = SPRING.replace("40 * self.at", "min(40 * self.highest, 120)")
    found = searched("explore", source=stuck.replace("won = self.at == 5", "won = False"))[0]
    assert found.still is not None
    assert found.still_length >= 10
    # The picture shows the highest place, and nothing more from the third on.
    assert max(map(sum, _prefixes([(0, 1, -1)[action] for action in found.still]))) >= 2


@pytest.mark.parametrize(("paid", "loops"), [("crossed", True), ("crossed and self.laps == 1", False)])
def test_two_moves_that_are_held_in_turn_are_a_loop(paid: str, loops: bool) -> None:
    """Each crossing of 0 upwards is a lap, and the speed follows the pushes 1 and 2 slowly."""
    sled = SPRING.replace("float(self.at < before == 1)", f"float({paid})").replace("40 * self.at", "0")
    sled = sled.replace("self.at = self.highest = 1", "self.at, self.highest, self.speed, self.laps = -0.5, 0, 0.0, 0")
    step = (
        "self.speed = 0.9 * self.speed + 0.25 * (0, 1, -1)[action]; self.at = before + self.speed; "
        "crossed = before < 0 <= self.at; self.laps += crossed"
    )
    out, _, _ = searched("rock", step=step, source=sled, path=[1, 1, 1], limit=200)
    turns = [[1, 1, 1, *([one] * 6 + [other] * 6) * 2] for one, other in ((1, 2), (2, 1))]
    assert out.loop in (turns if loops else [None])
    assert out.loop_length == (12 if loops else 0)


@pytest.mark.parametrize(("restarts", "outlasts"), [(9, True), (1, False)])
def test_a_counter_that_starts_again_and_again_outlasts_its_limit(restarts: int, outlasts: bool) -> None:
    """At the height 4 the counter starts again, so often, and 20 steps later the episode ends."""
    source = SPRING.replace("won, False", "won, self.time >= 20")
    step = (
        "again = self.at == 4 > before and self.left > 0; self.left -= again; self.time = 0 if again else self.time + 1"
    )
    reset = f"self.time, self.left = 0, {restarts}"
    out, _, channel = searched("outlast", reset, step, source, limit=50, max_steps=6_000, counter=("time", 20))
    assert len(out.best) == (50 if outlasts else 0)
    assert channel.steps <= 6_000 + 24
    if outlasts:
        heights = list(accumulate(out.best, lambda at, action: max(at + (0, 1, -1)[action], 0), initial=1))
        assert sum(here == 4 > before for before, here in pairwise(heights)) >= 2


def test_restarts_are_not_sought_without_copies() -> None:
    out, _, channel = searched("outlast", counter=("at", 20))
    assert out.best == []
    assert channel.steps == 0


def _prefixes(moves: list[int]) -> list[list[int]]:
    return [moves[:number] for number in range(len(moves) + 1)]
