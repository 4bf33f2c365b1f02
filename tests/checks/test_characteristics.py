"""The statistical rules err as seldom as promised, and decide as the exact figures of the documentation say."""

from __future__ import annotations

import itertools
import random
import re
from math import sqrt

import pytest
from envcraft_checks.difficulty import Difficulty
from envcraft_checks.instadeath import MOST, degenerate_code
from envcraft_checks.instawin import InstaWin

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.judging.statistics import Exact, settle
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport, Verdict
from evaluation import characteristics

#: Random play and every held action win on 19 of 20 seeds, at step LENGTH; the corner shows the step.
LOTTERY = '''
"""Wait for the draw."""
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Lottery(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.won = bool(self.np_random.random() < 0.95)
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        ended = self.steps == LENGTH
        won = ended and self.won
        return self.render(), float(won), won, ended and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[: 1 + self.steps % 80] = 200
        return frame
'''


def drawn(rate: float, rng: random.Random) -> list[bool]:
    return [rng.random() < rate for _ in range(96)]


def judged(check: Check, length: int, budget: str, rate: float = 0.95) -> SubjectReport:
    target = Target("lottery.py", LOTTERY.replace("LENGTH", str(length)).replace("0.95", str(rate)).encode())
    *_, last = validate(Plan([target], ARCADE, driver_named("process"), [check], BUDGETS[budget]))
    assert isinstance(last, Finished)
    return last.report.reports[0]


@pytest.mark.parametrize("budget", BUDGETS)
def test_no_rule_errs_more_often_than_promised(budget: str) -> None:
    for threshold in (MOST, ARCADE.consistently):
        # Every number of looks, not only those of the tables.
        for steps in (1, 80, 1000):
            found = characteristics.above(threshold, threshold, BUDGETS[budget].looks_for(steps))
            assert 0 < found <= characteristics.PROMISED
    assert 0 < characteristics.wrong_held()[budget] <= characteristics.PROMISED_HELD
    for code in characteristics.DEGENERATE:
        assert 0 < characteristics.wrong_seeds(code)[budget] <= characteristics.PROMISED


def test_a_lower_rate_is_reported_less_often() -> None:
    rates = [number / 20 for number in range(21)]
    for looks in {budget.looks_for(steps) for budget in BUDGETS.values() for steps in (1, 1000)}:
        found = [characteristics.above(rate, ARCADE.consistently, looks) for rate in rates]
        assert found == sorted(found)
        assert found[0] == 0
        assert found[-1] == pytest.approx(1)


def test_looks_of_a_small_budget_are_the_first_ones_of_a_larger_budget() -> None:
    budgets = sorted(BUDGETS.values(), key=lambda budget: budget.steps)
    for steps in range(1, 1001):
        designs = [budget.looks_for(steps) for budget in budgets]
        assert all(large[: len(small)] == small for small, large in itertools.pairwise(designs))


@pytest.mark.parametrize("budget", BUDGETS)
def test_an_additional_look_takes_a_quarter_of_the_steps_at_most(budget: str) -> None:
    spent = {steps: BUDGETS[budget].looks_for(steps)[-1] for steps in range(1, 1001)}
    usual = BUDGETS[budget].looks[-1]
    assert all(steps * last <= BUDGETS[budget].steps / 4 for steps, last in spent.items() if last > usual)
    assert spent[1000] == usual


@pytest.mark.parametrize("rate", [0.5, 0.7, 0.9])
def test_exact_probability_is_the_sum_over_all_sequences(rate: float) -> None:
    looks, total = (4, 8, 12), 0.0
    for outcomes in itertools.product([False, True], repeat=12):
        if settle(outcomes.__getitem__, 0.5, looks)[0]:
            total += rate ** sum(outcomes) * (1 - rate) ** (12 - sum(outcomes))
    assert characteristics.above(rate, 0.5, looks) == pytest.approx(total)
    assert total > 0


@pytest.mark.parametrize(("rate", "threshold", "steps"), [(0.95, 0.8, 1000), (0.95, 0.8, 100), (0.7, 0.5, 30)])
def test_exact_probability_agrees_with_simulated_rules(rate: float, threshold: float, steps: int) -> None:
    rng, looks, times = random.Random(1), BUDGETS["standard"].looks_for(steps), 1500
    found = sum(
        settle(drawn(rate, rng).__getitem__, threshold, looks, affords=lambda: True)[0] is True for _ in range(times)
    )
    exact = characteristics.above(rate, threshold, looks)
    assert abs(found / times - exact) < 4 * sqrt(exact * (1 - exact) / times) + 1 / times


def test_exact_probability_of_degenerate_seeds_agrees_with_simulated_ones() -> None:
    rng, seeds, times = random.Random(3), BUDGETS["quick"].session[0], 1500
    codes = [degenerate_code(Exact(sum(rng.random() < 0.15 for _ in range(seeds)), seeds)) for _ in range(times)]
    exact = characteristics.degenerate(0.15, seeds, ["EC702"])
    assert abs(codes.count("EC702") / times - exact) < 4 * sqrt(exact * (1 - exact) / times)


@pytest.mark.parametrize(("check", "code"), [(InstaWin(), "EC601"), (Difficulty(), "EC802")])
def test_short_episodes_are_played_until_a_rare_loss_settles_nothing(check: Check, code: str) -> None:
    findings = {finding.code: finding for each in judged(check, 8, "quick").checks for finding in each.findings}
    assert code in findings
    rate = findings[code].evidence["rate"]
    assert rate["hits"] < rate["n"]
    assert rate["n"] in (48, 96)


def test_long_episodes_are_played_no_more_often_than_the_budget_allows() -> None:
    report = judged(InstaWin(), 900, "quick")
    assert not [finding for each in report.checks for finding in each.findings if finding.code == "EC601"]
    assert report.steps <= BUDGETS["quick"].steps


def test_random_play_that_always_wins_is_played_on_before_other_play() -> None:
    (check, *_) = judged(InstaWin(), 380, "standard", rate=1.0).checks
    assert [finding.code for finding in check.findings][:1] == ["EC601"]


def test_wins_that_the_budget_cannot_settle_are_undecided() -> None:
    (check, *_) = judged(InstaWin(), 900, "standard", rate=1.0).checks
    assert check.verdict is Verdict.SKIP
    assert re.search(r"random play wins all of \d+ episodes?, and the budget standard allows too few", check.reason)
