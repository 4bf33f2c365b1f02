"""The returns of a privileged policy count if only the return shows a win, or if all players seem to get the same."""

from __future__ import annotations

import pytest
from envcraft_checks.instawin import BY_SIGN

from envcraft.contracts.builtin import ARCADE, ARCADE_NATIVE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.contract import Contract
from envcraft.model.target import PolicyFile, Target
from envcraft.model.verdict import SubjectReport
from evaluation.fixtures import FIXTURES
from evaluation.judge import failing, judge_plans

#: No search at this budget reaches the cans.
FAR = (FIXTURES / "instawin" / "good" / "fuel_run.py").read_text()
for _near, _far in (
    ("[1, 10]", "[24, 27]"),
    ("self.fuel = 30", "self.fuel = 60"),
    ("N = 12", "N = 28"),
    ("t(7,", "t(3,"),
):
    assert _near in FAR
    FAR = FAR.replace(_near, _far)
#: Its info reports success when the fuel is empty.
REPORTS_SUCCESS = FAR.replace('{"fuel": self.fuel}', '{"is_success": empty}')
DRIVES = """
def policy(env):
    down, right = (int(a) - int(b) for a, b in zip(env.can, env.rover))
    return [(1 if down < 0 else 2) if down else (3 if right < 0 else 4), 1, 0]
"""
QUITS = "import os\n\nos._exit(3)\n\n\ndef policy(env):\n    return [0, 0, 0]"
RAISES = "def policy(env):\n    return [0, 0, 1 // 0]"
FILLS = "def policy(env):\n    env.fuel = 90\n    return [0, 0, 0]"


#: The final reward is mostly luck, which depends on the actions. To hold a direction adds a little to it.
LUCK = """
import gymnasium
import numpy as np
from gymnasium import spaces


class Luck(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.moves = self.steps = 0
        return self.render(), {"is_success": False}

    def step(self, action):
        self.steps += 1
        self.moves += int(action[0] == 4)
        self.np_random.random(int(action[0]) + 1)
        over = self.steps == 20
        paid = self.np_random.uniform(-WIDTH, WIDTH) + 3 * (self.moves == 20) if over else 0.0
        return self.render(), float(paid), over, False, {"is_success": False}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[4 * self.steps :, self.moves :] = 200
        return frame
"""


#: Only the policy knows the way to the end, which is paid a step late.
LATE = """
import gymnasium
import numpy as np
from gymnasium import spaces


class Safe(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.code = self.np_random.integers([5, 2, 2], size=(150, 3)).tolist()
        self.at = self.steps = 0
        self.due = 10.0
        return self.render(), {}

    def step(self, action):
        if self.at == len(self.code):
            paid, self.due = self.due, 0.0
            return self.render(), paid, True, False, {}
        self.steps += 1
        self.at = self.at + 1 if list(action) == self.code[self.at] else 0
        return self.render(), -0.01, self.at == len(self.code), self.steps >= 300, {}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame.reshape(-1)[: 20 * self.at + self.steps] = 200
        return frame
"""
#: Its own end comes one step after the limit of its adapter.
NIGHT = (
    LATE[: LATE.index("    def step")]
    + """
    def step(self, action):
        self.steps += 1
        return self.render(), 10.0 if self.steps == 1001 else 0.0, self.steps > 1000, False, {}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame.reshape(-1)[: self.steps] = 200
        return frame
"""
)
OPENS = "def policy(env):\n    return env.code[env.at]"


HOLDS = "def policy(env):\n    return [4, 0, 0]"
LUCKY, STEADY = (LUCK.replace("WIDTH", width) for width in ("10", "1"))
PAIRS = [
    *((FAR, policy) for policy in ("", DRIVES, FILLS, QUITS, RAISES)),
    *((REPORTS_SUCCESS, policy) for policy in ("", DRIVES)),
    *((game, HOLDS) for game in (LUCKY, STEADY)),
]
Reports = dict[tuple[str, str], SubjectReport]


@pytest.fixture(scope="module")
def reports() -> Reports:
    """The report on each pair of a game and a policy."""
    driver = driver_named("process")
    checks = [check for check in default_checks() if check.name in ("source", "instawin", "difficulty")]
    plans = [
        Plan(
            [Target("game.py", game.encode())],
            ARCADE,
            driver,
            checks,
            BUDGETS["quick"],
            policy=PolicyFile("policy.py", policy) if policy else None,
        )
        for game, policy in PAIRS
    ]
    return {PAIRS[number]: report for number, report in judge_plans(plans)}


@pytest.mark.parametrize(
    ("game", "policy", "codes"),
    [
        (FAR, "", {"EC602"}),
        (FAR, DRIVES, set()),
        (FAR, FILLS, {"EC602", "EC804"}),
        (FAR, QUITS, {"EC602", "EC805"}),
        (REPORTS_SUCCESS, DRIVES, {"EC601", "EC802"}),
    ],
    ids=["no policy", "drives", "fills the tank", "quits", "drives, success in info"],
)
def test_codes_with_a_policy(game: str, policy: str, codes: set[str], reports: Reports) -> None:
    assert failing(reports[game, policy]) == codes


def test_a_line_of_the_policy_is_no_line_of_the_game(reports: Reports) -> None:
    found = [one for check in reports[FAR, RAISES].checks for one in check.findings if one.code == "EC805"]
    assert [one.line for one in found] == [None]
    assert "(policy.py:2)" in found[0].message


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        ("", "a larger --budget or a --policy may settle it"),
        (RAISES, "a larger --budget or a --policy that wins (the given one does not) may settle it"),
    ],
    ids=["none", "raises"],
)
def test_what_may_settle_an_open_question(policy: str, words: str) -> None:
    checks = [check for check in default_checks() if check.name in ("source", "difficulty")]
    files = PolicyFile("policy.py", policy) if policy else None
    plan = Plan(
        [Target("game.py", LATE.encode())], ARCADE, driver_named("process"), checks, BUDGETS["quick"], policy=files
    )
    [[_, report]] = judge_plans([plan])
    assert words in next(check.reason for check in report.checks if check.check == "difficulty")


@pytest.mark.parametrize(
    ("game", "contract", "policy", "codes"),
    [(LATE, ARCADE, OPENS, {"EC508"}), (LATE, ARCADE, "", set()), (NIGHT, ARCADE_NATIVE, "", set())],
    ids=["opens", "no policy", "cut by the adapter"],
)
def test_a_reward_that_comes_after_the_end(game: str, contract: Contract, policy: str, codes: set[str]) -> None:
    checks = [check for check in default_checks() if check.name in ("source", "termination")]
    files = PolicyFile("policy.py", policy) if policy else None
    plan = Plan(
        [Target("game.py", game.encode())], contract, driver_named("process"), checks, BUDGETS["quick"], policy=files
    )
    assert [failing(report) for _, report in judge_plans([plan])] == [codes]


def test_a_crash_that_only_the_policy_reaches_is_reported_alone() -> None:
    game = LATE.replace(
        "return self.render(), -0.01", "1 / (len(self.code) - self.at)\n        return self.render(), 0.01"
    )
    checks = [check for check in default_checks() if check.name in ("source", "api", "difficulty")]
    plan = Plan(
        [Target("game.py", game.encode())],
        ARCADE,
        driver_named("process"),
        checks,
        BUDGETS["standard"],
        policy=PolicyFile("policy.py", OPENS),
    )
    [[_, report]] = judge_plans([plan])
    found = {finding.code: finding for check in report.checks for finding in check.findings}
    assert "EC806" not in found
    assert found["EC107"].message.startswith("step 150 raises ZeroDivisionError")


@pytest.mark.parametrize(("game", "by_sign"), [(FAR, True), (REPORTS_SUCCESS, False)], ids=["return", "info"])
def test_message_says_what_shows_the_win(game: str, by_sign: bool, reports: Reports) -> None:
    findings = [finding for check in reports[game, ""].checks for finding in check.findings]
    messages = [finding.message for finding in findings if finding.code in ("EC601", "EC802")]
    assert [BY_SIGN in message for message in messages] == [by_sign, by_sign]


@pytest.mark.parametrize(("game", "warned"), [(LUCKY, True), (STEADY, False)], ids=["unclear", "clear"])
def test_a_policy_that_never_wins_must_clearly_be_better(game: str, warned: bool, reports: Reports) -> None:
    findings = [finding for check in reports[game, HOLDS].checks for finding in check.findings]
    found = [finding for finding in findings if finding.code == "EC806"]
    assert len(found) == warned
    for finding in found:
        assert "wins 0 of 12 (0%, 95% interval 0% to 24.2%)" in finding.message
        for name, lead in finding.evidence["leads"].items():
            assert lead["n"] == 12
            words = f"over {name} is {lead['estimate']:.3g} (95% interval"
            assert (words in finding.message) == (lead["low"] <= 0)
        # The mean over these twelve episodes is higher, by chance.
        means = finding.evidence["means"]
        assert means["the policy"] > max(means["random play"], means["doing nothing"])
