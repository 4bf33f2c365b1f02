"""Successes that the check lint reports, because info is made too early, or because they end no episode."""

from __future__ import annotations

import textwrap

import pytest

from tests.checks.lint_games import found

GAME = """
import gymnasium as gym
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.coins, self.oil, self.picked, self.steps = 0, [3, 5], 60, 0, 0
        self.won = self.lost = self.over = False
        self.phase = "play"
        return self.at, {{}}
    def step(self, action):
        self.steps += 1
        self.at += int(action)
{step}
    def _info(self):
        return {{"is_success": {success}}}
    def _pick(self):
        if self.at in self.coins:
            self.coins.remove(self.at)
            self.picked += 1
    def _is_over(self):
        return self.picked == 2 or self.oil <= 0
{more}
"""


def codes(step: str, success: str = "self.won", more: str = "") -> set[str]:
    """The codes that lint reports on a game with these statements in step(), without those of methods that it lacks."""
    parts = {"step": textwrap.indent(step, " " * 8), "more": textwrap.indent(more, " " * 4)}
    return found(GAME.format(success=success, **parts)) - {"EC076"}


END = "\nreturn self.at, 0.0, {}, self.steps >= 99, {}"


@pytest.mark.parametrize(
    ("step", "success"),
    [
        ("info = self._info()\nself._pick()" + END.format("self._is_over()", "info"), "self.picked == 2"),
        ("info = self._info()\nself._pick()" + END.format("not self.coins", "info"), "len(self.coins) == 0"),
        (
            "info = {'is_success': self.won}\nif self.at > 9:\n    self.won = True"
            + END.format("self.won or self.at < 0", "info"),
            "",
        ),
        ("won = self.picked == 2\nself._pick()" + END.format("self.picked == 2", "{'is_success': won}"), ""),
        (
            "info = self._info()\nended = False\nif self.at > 9:\n    self.won = True\n    ended = True"
            + END.format("ended", "info"),
            "self.won",
        ),
        (
            "info = self._info()\nif self.at > 9:\n    self.over = True\n    self.won = True"
            + END.format("self.over", "info"),
            "self.won",
        ),
        (
            "info = {}\ninfo['is_success'] = self.won\nended = self._check()" + END.format("ended", "info"),
            "self.won",
        ),
        (
            "info = self._info()\nif self.at > 9:\n    self.won = True"
            "\n    return self.at, 1.0, True, False, info" + END.format("self.at < 0", "self._info()"),
            "self.won",
        ),
    ],
)
def test_info_that_is_made_before_the_success(step: str, success: str) -> None:
    more = (
        "def _check(self):\n    if self.at > 9:\n        self.won = True\n        return True\n    return self.at < 0"
    )
    assert "EC059" in codes(step, success or "self.won", more)


@pytest.mark.parametrize(
    ("step", "success"),
    [
        # The key is stored again, or the whole made anew.
        (
            "info = self._info()\nself._pick()\ninfo['is_success'] = self.picked == 2"
            + END.format("self._is_over()", "info"),
            "self.picked == 2",
        ),
        (
            "info = self._info()\nself._pick()\ninfo.update(self._info())" + END.format("self._is_over()", "info"),
            "self.picked == 2",
        ),
        ("info = self._info()\nself._pick()" + END.format("self._is_over()", "self._info()"), "self.picked == 2"),
        # The object that info has changes itself.
        ("info = self._info()\nself._pick()" + END.format("not self.coins", "info"), "self.coins"),
        # No change that makes success true.
        (
            "info = self._info()\nif self.steps > 50:\n    self.phase = 'lost'"
            + END.format("self.phase != 'play' or self.at > 9", "info"),
            "self.phase == 'won' or self.at > 9",
        ),
        (
            "info = self._info()\nself.oil -= 1" + END.format("self.oil <= 0 or self.at > 9", "info"),
            "self.oil > 0 and self.at > 9",
        ),
        # The change is on another path.
        (
            "if self.won:\n    info = self._info()\n    return self.at, 0.0, True, False, info\nif self.at > 9:"
            "\n    self.won = True" + END.format("self.won", "self._info()"),
            "self.won",
        ),
        # Both are decided at once, and the game changes later.
        (
            "won = self.picked == 2\nself._pick()\nlost = not won and self.picked > 1"
            + END.format("won or lost", "{'is_success': won}"),
            "",
        ),
        # The end is decided early, too.
        (
            "info = self._info()\nover = self._is_over()\nself._pick()" + END.format("over", "info"),
            "self.picked == 2",
        ),
        # A bid is won, not the game.
        (
            "bid = min(action, self.oil)\nwon = bid > 3\nif won:\n    self.oil -= bid"
            + END.format("self.oil <= 0", "{'won': won}"),
            "",
        ),
    ],
)
def test_info_that_is_made_in_time(step: str, success: str) -> None:
    assert "EC059" not in codes(step, success or "self.won")


WON = "if self.at == 9:\n    self.won = True\n"


@pytest.mark.parametrize(
    ("step", "success"),
    [
        ("self.oil -= 1\n" + WON + END.format("self.oil <= 0", "self._info()"), "self.won"),
        ("self.oil -= 1" + END.format("self.oil <= 0", "self._info()"), "self.at == 9"),
        (WON + END.format("False", "self._info()"), "self.won"),
        (
            "if self.at == 9:\n    self.won = True\nelif self.at == 4:\n    self.lost = True"
            + END.format("self.lost", "self._info()"),
            "self.won",
        ),
        (
            "self.oil -= 1\nself._pick()\nif self.oil in (4, 6):\n    self.over = True"
            + END.format("self.over", "self._info()"),
            "self.picked == 2",
        ),
    ],
)
def test_a_success_that_ends_no_episode(step: str, success: str) -> None:
    assert codes(step, success) == {"EC060"}


@pytest.mark.parametrize(
    ("step", "success"),
    [
        (WON + END.format("self.won or self.oil <= 0", "self._info()"), "self.won"),
        # An action that ends the episode, won or not.
        (
            "dived = bool(action)\nself.won = dived and self.at == 9" + END.format("dived", "self._info()"),
            "self.won",
        ),
        # A return before the flags.
        (
            WON + "if self.won:\n    return self._end()" + END.format("self.oil <= 0", "self._info()"),
            "self.won",
        ),
        (
            WON + "if self.won:\n    return self.at, 1.0, True, False, self._info()"
            "\nself.oil -= 1" + END.format("self.oil <= 0", "self._info()"),
            "self.won",
        ),
        # One branch changes both.
        ("self._pick()" + END.format("not self.coins", "self._info()"), "self.picked == 2"),
        (
            "if self.at == 9:\n    self.won = True\n    self._stop()" + END.format("self.over", "self._info()"),
            "self.won",
        ),
        # The same test, twice, and one that asks less.
        (WON + "if self.at == 9:\n    self.over = True" + END.format("self.over", "self._info()"), "self.won"),
        (
            "self.oil -= 1\nif self.at > 8 and self.oil > 3:\n    self.won = True"
            "\nself.over = self.oil <= 0 or self.at > 8" + END.format("self.over", "self._info()"),
            "self.won",
        ),
        # Success sets in motion what ends the episode.
        (
            WON + "if self.won:\n    self.oil -= 10" + END.format("self.oil <= 0", "self._info()"),
            "self.won",
        ),
        # Survival.
        (END.format("self.at == 4", "self._info()").strip(), "self.steps >= 99"),
        ("if self.steps >= 99:\n    self.won = True" + END.format("self.at == 4", "self._info()"), "self.won"),
        # What the file does not show.
        (WON + "self.unknown(self)" + END.format("self.oil <= 0", "self._info()"), "self.won"),
        (WON + "setattr(self, action, 0)" + END.format("self.oil <= 0", "self._info()"), "self.won"),
        (WON + END.format("self.oil <= 0", "self.unknown()"), "self.won"),
    ],
)
def test_a_success_that_may_end_the_episode(step: str, success: str) -> None:
    more = "def _end(self):\n    return self.at, 1.0, True, False, {}\ndef _stop(self):\n    self.over = True"
    assert codes(step, success, more) == set()
