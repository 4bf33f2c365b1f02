"""A validation takes at most the steps of its budget, and plays short episodes more often than long ones."""

from __future__ import annotations

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Finished
from envcraft.model.rollout import Conditions
from envcraft.model.target import Target
from envcraft.model.trace import digest
from envcraft.model.verdict import SubjectReport

CATCH = '''
"""Catch the fruit; forty catches win."""
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Catch(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    LIMIT = 1000

    def __init__(self, render_mode="rgb_array"):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.caught, self.x = 0, 0, 5
        self.fruit = int(self.np_random.integers(12))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.x = min(max(self.x + int(action[0] == 4) - int(action[0] == 3), 0), 11)
        reward = 0.0
        if self.steps % 12 == 0:
            reward = 1.0 if self.x == self.fruit else -0.1
            self.caught += self.x == self.fruit
            self.fruit = int(self.np_random.integers(12))
        won = self.caught == 40
        return self.render(), reward, won, self.steps >= self.LIMIT and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[7 * (self.steps % 12) :, 7 * self.fruit : 7 * self.fruit + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
'''
DEFECTS = {
    "EC107": CATCH.replace("        reward = 0.0\n", "        reward = 0.0\n        1 / (700 - self.steps)\n"),
    "EC204": CATCH.replace("int(self.np_random.integers(12))", "int(np.random.randint(12))"),
    "EC501": CATCH.replace("self.steps >= self.LIMIT", "False"),
    "EC602": CATCH.replace("self.caught == 40", "False")
    .replace("1.0 if self.x == self.fruit else -0.1", "1.0")
    .replace('{"is_success": won}', "{}"),
}


def judged(source: str, budget: str) -> SubjectReport:
    target = Target("catch.py", source.encode())
    *_, last = validate(Plan([target], ARCADE, driver_named("process"), default_checks(), BUDGETS[budget]))
    assert isinstance(last, Finished)
    (report,) = last.report.reports
    return report


def codes(report: SubjectReport) -> set[str]:
    return {finding.code for check in report.checks for finding in check.findings}


@pytest.mark.parametrize("budget", BUDGETS)
def test_a_game_of_1000_steps_stays_within_its_budget(budget: str) -> None:
    report = judged(CATCH, budget)
    assert not codes(report)
    assert 0.75 * BUDGETS[budget].steps < report.steps <= BUDGETS[budget].steps


def test_a_game_that_no_search_wins_is_undecided() -> None:
    difficulty = next(check for check in judged(CATCH, "quick").checks if check.check == "difficulty")
    assert difficulty.verdict == "skip"
    assert difficulty.undecided


@pytest.mark.parametrize("code", DEFECTS)
def test_a_defect_of_a_long_game_stays_within_its_budget(code: str) -> None:
    report = judged(DEFECTS[code], "standard")
    assert code in codes(report)
    assert report.steps <= BUDGETS["standard"].steps


def subject_of(source: str, budget: str) -> Subject:
    target = Target("catch.py", source.encode())
    return Subject(target, ARCADE, WorkerPool(driver_named("process")).lease(), BUDGETS[budget])


def test_episodes_that_are_short_are_all_whole() -> None:
    with subject_of(CATCH.replace("1000", "60"), "standard") as subject:
        traces = [*subject.played(), *subject.episodes.rotations]
        assert len(traces) > 45
        assert all(trace.ended for trace in traces)


def test_only_two_episodes_and_a_held_action_that_earns_most_are_whole() -> None:
    with subject_of(CATCH, "standard") as subject:
        traces = [*subject.played(), *subject.episodes.rotations]
        ended = [trace.rollout.player for trace in traces if trace.ended]
        assert ended == ["random play", "doing nothing", "holding [3, 0, 0]"]
        assert sum(trace.steps for trace in traces) <= BUDGETS["standard"].play
        more = list(subject.episodes.more_whole())
        assert all(trace.ended for trace in more)
        assert subject.steps <= BUDGETS["standard"].steps


def test_a_plain_rollout_is_a_part_of_a_longer_one() -> None:
    with subject_of(CATCH, "quick") as one, subject_of(CATCH, "quick") as other:
        one.random(0)
        steps = one.steps
        for length in (0, 1, 40, 999, 1000):
            part = one.probes.random(0).cut(length)
            assert digest(one.rollout(part)) == digest(other.rerun(part))
            assert one.rollout(part).rollout == part
        assert one.steps == steps
        one.rollout(one.probes.random(0).cut(40).under(Conditions(render=True)))
        one.rollout(one.probes.random(1).cut(40))
        assert one.steps == steps + 80


def test_an_episode_that_ended_needs_no_more_actions() -> None:
    with subject_of(CATCH.replace("1000", "60"), "quick") as subject:
        short = subject.rollout(subject.probes.random(0).cut(100))
        steps = subject.steps
        assert (short.steps, short.ended) == (60, True)
        assert digest(subject.random(0)) == digest(short)
        assert subject.steps == steps


def test_a_compared_rollout_is_no_part_of_one_that_followed_another() -> None:
    with subject_of(CATCH, "quick") as subject:
        subject.random(1)
        subject.random(0)
        steps = subject.steps
        subject.rollout(subject.probes.random(0).cut(50), alone=True)
        assert subject.steps == steps + 50
