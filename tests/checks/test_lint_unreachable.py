"""Successes, actions, branches and results that the check lint reports, because play never reaches or uses them."""

from __future__ import annotations

import textwrap

import pytest

from tests.checks.lint_games import codes, found, pressed


def ends(terminated: str, truncated: str, success: str, before: str = "") -> set[str]:
    """The codes that lint reports on a game whose step() returns these flags and this success."""
    end = f"return self.see(), 0.0, {terminated}, {truncated}, {{'is_success': {success}}}"
    statements = f"won = self.x > 9; lost = self.x < 0; late = self.x == 5; {before or 'pass'}; {end}"
    more = "def more(self): return self.np_random.random() < 0.5"
    return codes(reset="self.x = self.np_random.integers(9)", step=statements, more=more)


@pytest.mark.parametrize(
    ("terminated", "truncated", "success", "before"),
    [
        ("won", "late", "False", ""),
        ("(won or lost) and not won", "late and not (won or lost)", "won", ""),
        ("done and not won", "late and not done", "won", "done = bool(won) or lost"),
        ("lost", "late and not won", "won and not lost", ""),
    ],
)
def test_success_that_no_episode_can_end_with(terminated: str, truncated: str, success: str, before: str) -> None:
    assert ends(terminated, truncated, success, before) == {"EC059"}


@pytest.mark.parametrize(
    ("terminated", "truncated", "success", "before"),
    [
        ("won", "late", "won", ""),
        # The episode goes on, and its end may come while success still holds.
        ("lost", "late", "won", ""),
        ("lost", "late", "won and not lost", ""),
        # Survival to the limit.
        ("lost", "late and not lost", "late and not lost", ""),
        # A wrapper truncates.
        ("lost and not won", "False", "won", ""),
        ("False", "False", "won", ""),
        # The text is the same, and the value may not be.
        ("self.x > 9", "late and not won", "won", "self.x += 1"),
        ("lost and not self.more()", "late and lost and not self.more()", "self.more()", ""),
        ("lost", "stop", "won and not lost", "stop = late and not won; won = self.x > 8"),
    ],
)
def test_success_that_an_episode_may_end_with(terminated: str, truncated: str, success: str, before: str) -> None:
    assert ends(terminated, truncated, success, before) == set()


def test_a_game_without_a_notion_of_success_may_deny_it() -> None:
    end = "return self.see(), 0.0, self.x > 9, self.x == 5, {'is_success': False}"
    assert codes(reset="self.x = self.np_random.integers(9)", step=end) == set()


@pytest.mark.parametrize(
    "statements",
    [
        "info = {'is_success': False}; info['is_success'] = won",
        "info = {'is_success': False}; info.update(is_success=won)",
        "info = dict(is_success=False); key = 'is_success'; info[key] = won",
    ],
)
def test_success_that_another_line_reports(statements: str) -> None:
    end = "return self.see(), 0.0, won, self.x == 5, info"
    assert codes(reset="self.x = self.np_random.integers(9)", step=f"won = self.x > 9; {statements}; {end}") == set()


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("if action[2] == 2: self.x += 1", {}),
        ("if int(action[1]) in (2, 3): self.x += 1", {}),
        ("move, jump, bomb = action\nif bomb == 2: self.x += 1", {}),
        ("move, *_ = action\njump = int(action[1])\nself.x += (jump == 1) - (2 == jump)", {}),
        ("move, jump, bomb = (int(one) for one in action)\nself.x += bomb == 2", {}),
        ("move, jump, bomb = map(int, action)\nif jump == 2: self.x += 1", {}),
        (
            "action = np.asarray(action).tolist()\nmatch action[0]:\n    case 1: self.x += 1\n    case 5: self.x -= 1",
            {},
        ),
        ("action = int(action)\nif action == 4: self.x += 1", {"space": "Discrete(4)"}),
        ("if action == 0: self.x += 1", {"space": "Discrete(4, start=1)"}),
        ("if action == Key.JUMP: self.x += 1", {"space": "Discrete(4)"}),
        ("self._go(action[1])", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self._go(action[1] if self.x else 0)", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self.x += MOVES[int(action[0])][0]", {"moves": "1: (1, 0)"}),
        ("move = int(action[0])\nif move >= 3: self.x = int(move > 4)", {}),
        ("self.x += 1 if 2 <= action[1] else 0", {}),
        ("if action[1] > 1: self.x += 1", {}),
    ],
)
def test_an_action_that_the_space_does_not_have(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {"EC059": True}


@pytest.mark.parametrize(
    ("step", "parts"),
    [
        ("if action[2] == 1 or action[0] == 4: self.x += 1", {}),
        ("if action[2] == 2: raise ValueError('no such action')", {}),
        ("if not 0 <= action[0] < 5: raise ValueError('no such action')", {}),
        ("assert action[1] < 2", {}),
        ("assert not action[1] > 1", {}),
        ("move = int(action[0])\nif move > 4: move = 4\nself.x += move", {}),
        ("if action[1] < 0: return self.see(), 0.0, False, False, {}", {}),
        ("if action[1] > 1: raise ValueError(action)", {}),
        ("if action[0] > 3: self.x += 1", {}),
        ("bomb = action[2]\nif self.x: bomb = 2\nif bomb == 2: self.x += 1", {}),
        ("bomb = int(action[2])\nbomb += 1\nif bomb == 2: self.x += 1", {}),
        ("for bomb in range(3): self.x += bomb == 2 and action[0] == 1", {}),
        ("self.x += sum(action == 2 for action in (1, 2))", {}),
        ("if action == 4: self.x += 1", {"space": "Discrete(len(MOVES) + 2)"}),
        ("if action == 4: self.x += 1", {"space": "Discrete(5)"}),
        ("self._go(action[1]); self._go(2)", {"go": "self.x += 1 if code == 2 else 0"}),
        ("self._go(action[1])", {"go": "self.x += 1 if far == 2 or code == 1 else 0"}),
        ("self.x += 1 if action[1] in (1, 2) else 0", {}),
        ("self.x += MOVES[int(action[0])][0]", {"moves": "1: (0, 1)"}),
        (
            "if action == 4: self.x += 1",
            {"space": "Discrete(4)", "more": "class _More(Game):\n    action_space = gym.spaces.Discrete(5)"},
        ),
    ],
)
def test_an_action_that_the_space_may_have(step: str, parts: dict[str, str]) -> None:
    assert pressed(step, **parts) == {}


@pytest.mark.parametrize(
    "step",
    [
        "if action[0] == 1: self.x += 1\nelif action[0] == 2: self.x -= 1\nelif action[0] == 1: self.y += 1",
        "if self.x > 3: self.x = 0\nelif self.x > 3 and self.y: self.y = 0",
        "if self.x in (1, 2): self.x = 0\nelif self.y: self.y = 1\nelif 2 == self.x: self.x = 9",
        "if self.x == 1 or self.x == 2: self.x = 0\nelse:\n    if self.x == 2: self.y = 0",
        "self.x += -1 if action[0] == 3 else 1 if action[0] == 3 else 0",
        "match int(action[0]):\n    case 1 | 2: self.x += 1\n    case 3: self.x -= 1\n    case 2: self.y = 0",
    ],
)
def test_a_branch_that_never_runs(step: str) -> None:
    assert pressed(step) == {"EC059": True}


@pytest.mark.parametrize(
    "step",
    [
        "if action[0] == 1: self.x += 1\nif action[0] == 1: self.y += 1",
        "if action[0] == 1: self.x += 1\nelif self.x == 1: self.y += 1",
        "if self.np_random.random() < 0.5: self.x += 1\nelif self.np_random.random() < 0.5: self.x -= 1",
        "if self.x > 3: self.x = 0\nelif self.see() and self.x: pass\nelif self.x > 3: self.x = 1",
        "if self.x > 3 and self.y: self.x = 0\nelif self.x > 3: self.x = 1",
        "if self.x == 1: self.x = 0\nelif self.x in (1, 2): self.x = 1",
        "if self.x == 1: self.x = 0\nelif self.x == 1: raise RuntimeError",
        "match int(action[0]):\n    case 1 if self.x: self.x += 1\n    case 1: self.x -= 1",
    ],
)
def test_a_branch_that_may_run(step: str) -> None:
    assert pressed(step) == {}


RESULT = "result = self.see(), reward, False, self.y > 99, {}"


@pytest.mark.parametrize(
    "step",
    [
        f"{RESULT}\nif self.x == 9: reward += 5.0\nreturn result",
        f"{RESULT}\nreward = reward + 5.0\nreturn result",
        f"{RESULT}\nfor _ in range(self.x): reward += 1.0\nreturn result",
        "ended = False\nresult = self.see(), reward, ended, False, {}\nif self.y > 9: ended = True\nreturn result",
    ],
)
def test_a_result_that_changes_too_late(step: str) -> None:
    assert pressed(step) == {"EC059": True}


@pytest.mark.parametrize(
    "step",
    [
        f"if self.x == 9: reward += 5.0\n{RESULT}\nreturn result",
        f"{RESULT}\nif self.x == 9:\n    reward += 5.0\n    {RESULT}\nreturn result",
        f"{RESULT}\nreward += 5.0\nreturn result[0], reward, *result[2:]",
        f"{RESULT}\nif self.x == 9:\n    return result\nreward += 5.0",
        f"{RESULT}\nself.x = 3\nreturn result",
        "info = {}\nresult = self.see(), reward, False, self.y > 99, info\ninfo['x'] = 1; info |= {}\nreturn result",
    ],
)
def test_a_result_that_changes_in_time(step: str) -> None:
    assert pressed(step) == {}


DRAWN = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.v, self.t = float(self.np_random.integers(9)), 1.5, 0
        self.frame = self._draw()
        return self.frame, {{}}
    def step(self, action):
        self.v = float(action[0]) - 1.5
{step}
    def _draw(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[int(self.x) % 84, self.t % 84] = 255
        return frame
    def _move(self):
        self.x += self.v
        return float(self.x > 50)
    def _tick(self):
        self.t += 1
    def _hit(self):
        if self.x > 60:
            self.x = 0.0
        return 0.0
"""
_END = ", reward, self.x > 70, self.t > 99, {}"


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        (f"self.frame = self._draw()\nreward = self._move()\nreturn self.frame.copy(){_END}", {"EC059"}),
        (f"frame = self._draw()\nreward = 1.0 + self._move()\nreturn frame{_END}", {"EC059"}),
        (f"reward = self._move()\nframe = self._draw()\nreturn frame{_END}", set()),
        (f"frame = self._draw()\nreward = self._move()\nframe = self._draw()\nreturn frame{_END}", set()),
        # A clock, and what happens now and then.
        (f"reward = self._move()\nframe = self._draw()\nself._tick()\nreturn frame{_END}", set()),
        (f"reward = self._move()\nframe = self._draw()\nself._hit()\nreturn frame{_END}", set()),
    ],
)
def test_a_picture_that_is_drawn_too_early(step: str, expected: set[str]) -> None:
    assert found(DRAWN.format(step=textwrap.indent(step, " " * 8))) == expected
