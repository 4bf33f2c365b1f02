"""What the check lint reports about rewards that an agent earns by waiting, or by holding a button."""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.program import Program
from envcraft_checks.linting.waiting import waiting_pays

GAME = """
import gymnasium as gym
BONUS = 5.0
class Game(gym.Env):
    LIMIT = 200
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.coins, self.steps, self.left, self.won = 0, 0, 0, 300, False
        return self.at, {}
    def step(self, action):
        move, jump, fire = (int(part) for part in action)
        self.steps += 1
        self._tick()
        reward = self._advance(move)
        won = self.at == 30
        lost = self.at < 0
        if won:
            reward += BONUS
        return self.at, %s, won or lost, self.steps >= self.LIMIT, {"is_success": won}
    def _tick(self):
        self.left -= 1
    def _advance(self, move):
        self.at += move - 2
        if self.at == 7:
            self.coins += 1
            return 1.0
        return 0.0
"""


def program(reward: str, old: str = "", new: str = "") -> Program:
    """A game with this reward, and one more change of its text."""
    text = GAME % reward
    assert old in text
    return Program(ast.parse(text.replace(old, new) if old else text))


@pytest.mark.parametrize(
    ("reward", "words"),
    [
        ("reward + 1", "pays 1 in each step: 200 in 200 steps, while success ends the episode and pays at most 6"),
        ("0.25 + reward - 0.15", "pays 0.1 in each step: 20 in 200 steps"),
        ("reward + 0.01 * self.steps", "pays 0.01 * self.steps in each step: 201 in 200 steps"),
        ("reward + self.steps / 100", "pays self.steps / 100 in each step: 201 in 200 steps"),
        ("reward + float(action[1])", "pays float(action[1]) for the action itself: 200 in 200 steps"),
        ("reward + 0.1 * fire", "pays 0.1 * fire for the action itself: 20 in 200 steps"),
        ("reward + float(move == 3)", "pays float(move == 3) for the action itself: 200 in 200 steps"),
    ],
)
def test_waiting_that_pays(reward: str, words: str) -> None:
    [suspect] = waiting_pays(program(reward))
    assert suspect.certain
    assert words in suspect.words


@pytest.mark.parametrize(
    ("reward", "old", "new"),
    [
        # Less than success in the whole episode, or not twice as much.
        ("reward + 0.01", "", ""),
        ("reward + 0.059", "", ""),
        ("reward - 0.5", "", ""),
        # The two sides of the action need not pay.
        ("reward - float(action[1])", "", ""),
        ("reward + 1 - 1", "", ""),
        # A cost of each step that stands elsewhere.
        ("reward + 1", "return 0.0", "return -1.0"),
        # What this pays is not known, and a step may pay 100.
        ("reward + 1", "return 1.0", "return self.worth()"),
        # Success means to last.
        ("reward + 1", "won = self.at == 30", "won = self.steps >= 150"),
        ("reward + 1", "won = self.at == 30", "won = self.left <= 0"),
        ("reward + 1", "won = self.at == 30", "late = self.LIMIT - self.steps\n        won = late < 2 and not self.at"),
        # Success does not end the episode, or nobody reports it.
        ("reward + 1", "won or lost", "lost"),
        ("reward + 1", '{"is_success": won}', "{}"),
        # No limit is known.
        ("reward + 1", "self.steps >= self.LIMIT", "False"),
        # Only some steps come there.
        ("reward + 1", "won = self.at == 30", "if move:\n            return self.at, reward, False, False, {}"),
    ],
)
def test_what_may_pay(reward: str, old: str, new: str) -> None:
    assert not list(waiting_pays(program(reward, old, new)))


def test_a_button_that_pays_in_a_game_of_lasting() -> None:
    game = program("reward + float(action[1])", "won = self.at == 30", "won = self.left <= 0")
    assert len(list(waiting_pays(game))) == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("won = self.at == 30", "if self.at == 30:\n            self.won = True\n        won = self.won"),
        ("return 1.0", "return 10.0 if self.coins < 3 else 0.0"),
        ("return 1.0", "return 10.0 * (self.coins < 3)"),
        ("return 1.0", "return self.worth()"),
    ],
)
def test_what_success_pays(old: str, new: str) -> None:
    assert len(list(waiting_pays(program("reward + 1.5", old, new)))) == 1


def test_success_beside_the_end() -> None:
    game = program("reward + 1", "won = self.at == 30", "if self.at == 30:\n            self.won = self.over = True")
    text = (
        ast.unparse(game.tree)
        .replace("won or lost", "self.over")
        .replace("'is_success': won", "'is_success': self.won")
    )
    assert len(list(waiting_pays(Program(ast.parse(text.replace("if won:", "if self.won:")))))) == 1
