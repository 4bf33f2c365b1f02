"""What the code says of the step limit: when play can evade it, and when it terminates."""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.evading import restarted, starts_again, unlimited
from envcraft_checks.linting.limits import terminates_at
from envcraft_checks.linting.program import Program

GAME = """
import gymnasium as gym
MAX_STEPS = LIMIT = 1000
FUEL = 400
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        self.steps = self.level_steps = self.level = self.fuel = 0
        self.enter()
        return 0, {{}}
    def enter(self):
        {enter}
    def step(self, action):
        {first}
        {count}
        won = self.level == 9
        {event}
        lost = False
        terminated = {terminated}
        truncated = {truncated}
        return 0, 0.0, terminated, truncated, {{}}
"""

LIMIT = "self.steps >= MAX_STEPS"
SHOP = "pass\n    def shop(self, leave):\n        if {}: self.shops = False"
ON = "\n            return 0, 0.0, False, False, {}"


def program(
    enter: str = "pass",
    first: str = "pass",
    count: str = "self.steps += 1",
    event: str = "pass",
    terminated: str = "won or lost",
    truncated: str = LIMIT,
) -> Program:
    text = GAME.format(enter=enter, first=first, count=count, event=event, terminated=terminated, truncated=truncated)
    return Program(ast.parse(text))


@pytest.mark.parametrize(
    "parts",
    [
        {"event": "if action == 3: self.level += 1; self.steps = 0"},
        {"event": "if action == 3: self.enter()", "enter": "self.steps = 0"},
        {"event": "if action == 3: self.steps = 0", "truncated": f"{LIMIT} and not (won or lost)"},
        {"event": "if action == 3: self.steps = 0", "truncated": "bool(self.steps > 600)"},
        {"event": "if self.rover == self.closest: self.steps = 0"},
        {"count": "if action: self.steps += 1"},
        {"first": "if action == 2: return 0, 0.0, False, False, {}"},
        {"first": "paused = action == 2\n        if paused: return 0, 0.0, False, False, {}"},
        {"first": f"if self.talks:\n            if action: self.talks = False{ON}"},
        {"first": f"if self.shops:\n            self.shop(action){ON}", "enter": SHOP.format("leave")},
        {"truncated": "self.steps == MAX_STEPS", "event": f"if self.fuel > 0:\n            self.fuel -= 1{ON}"},
        {"truncated": "self.steps == MAX_STEPS", "event": "if action == 3: self.steps += 500"},
        {"truncated": "self.steps == MAX_STEPS", "count": "self.steps += 1 + int(action)"},
    ],
)
def test_a_limit_that_play_can_evade(parts: dict[str, str]) -> None:
    assert list(unlimited(program(**parts), 1000))


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"count": "self.steps += 1 + int(action)"},
        {"truncated": "self.steps == MAX_STEPS", "count": "self.steps += 2"},
        # Two levels fit into the limit.
        {"event": "if action == 3: self.steps = 0", "truncated": "self.steps >= 500"},
        # Another count, which nothing sets back, limits the episode, too.
        {"event": "self.level_steps += 1\n        if won: self.level_steps = 0", "truncated": f"{LIMIT} or won"},
        {
            "count": "self.steps += 1\n        self.level_steps += 1",
            "event": "if action == 3: self.level_steps = 0",
            "truncated": f"{LIMIT} or self.level_steps >= 900",
        },
        {"count": "self.steps += 1\n        self.fuel -= 1", "terminated": "won or self.fuel <= -FUEL",
         "event": "if action == 3: self.steps = 0"},
        # The episode ends where the count starts again.
        {"event": "if won: self.steps = 0"},
        {"event": "if self.level == 4: lost = True; self.steps = 0"},
        # A state that ends by itself.
        {"first": f"if self.stun:\n            self.stun -= 1{ON}"},
        {"first": f"if self.talks:\n            if action or self.fuel > 60: self.talks = False{ON}"},
        {"first": f"if self.talks:\n            self.enter(){ON}", "enter": "self.talks = False"},
        {"first": f"if self.shops:\n            self.shop(action){ON}", "enter": SHOP.format("self.fuel")},
        {"first": f"if self.shops:\n            self.shop(True){ON}", "enter": SHOP.format("leave")},
        {"truncated": "self.steps == MAX_STEPS", "event": f"if self.steps <= 10:{ON}"},
        # A pause that ends by itself, which the action does not hold.
        {"first": "if self.fuel > 0: return 0, 0.0, False, False, {}"},
        {"truncated": "self.steps >= MAX_STEPS", "event": "if action == 3: self.steps += 500"},
        # No limit in the code: only play can tell.
        {"truncated": "False"},
        {"event": "if self.matchOver: self.steps = 0"},
        {"event": "if action == 3 and self.steps < 300: self.steps = 0"},
        {"event": "if self.hasEnded or self.roundover: self.steps = 0"},
    ],
)  # fmt: skip
def test_a_limit_that_holds_or_is_not_known(parts: dict[str, str]) -> None:
    assert not list(unlimited(program(**parts), 1000))


@pytest.mark.parametrize("bound", [300, 500])
def test_a_counter_that_must_start_again_more_than_once(bound: int) -> None:
    parts = {"event": "if action == 3: self.enter()", "enter": "self.steps = 0"}
    given = program(**parts, truncated=f"self.steps >= {bound}")
    found = restarted(given, 1000)
    assert found is not None
    assert found[:2] == ("steps", bound)
    assert found[2].line == 1 + GAME.splitlines().index("        {enter}")
    assert list(unlimited(given, 1000)) == []
    assert starts_again(given)


@pytest.mark.parametrize(
    "parts",
    [
        {"event": "if action == 3: self.steps = 0", "truncated": "self.steps >= 501"},
        {"truncated": "self.steps >= 300"},
        {"event": "if won: self.steps = 0", "truncated": "self.steps >= 300"},
        {"event": "if action == 3: self.steps = 0", "truncated": "self.steps >= 300", "terminated": "self.fuel > 900",
         "count": "self.steps += 1\n        self.fuel += 1"},
    ],
)  # fmt: skip
def test_one_restart_is_enough_or_nothing_starts_again(parts: dict[str, str]) -> None:
    assert restarted(program(**parts), 1000) is None


def test_a_time_limit_that_terminates_is_known_by_its_name() -> None:
    found = terminates_at(program(terminated=f"won or {LIMIT}", truncated="False"))
    assert found is not None
    assert found[0] == 1000
    later = terminates_at(program(terminated="won or self.steps > MAX_STEPS", truncated="False"))
    assert later is not None
    assert later[0] == 1001
    plain = program(terminated="won or self.steps >= LIMIT", truncated="False")
    assert terminates_at(plain) is not None


@pytest.mark.parametrize(
    ("terminated", "truncated"),
    [("won or self.steps >= FUEL", "False"), ("won", LIMIT), (f"won or {LIMIT}", LIMIT), ("won or lost", "False")],
)
def test_a_rule_of_the_game_is_no_time_limit(terminated: str, truncated: str) -> None:
    assert terminates_at(program(terminated=terminated, truncated=truncated)) is None
