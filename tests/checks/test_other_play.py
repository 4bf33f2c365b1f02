"""What a privileged policy earns counts where winning is a positive return, or where all seem to be paid alike."""

from __future__ import annotations

import pytest

from benchmarks.fixtures import FIXTURES
from benchmarks.judge import failing
from envcraft.budget import BUDGETS
from envcraft.commands.choices import default_checks
from envcraft.contract import ARCADE
from envcraft.engine import Plan, validate
from envcraft.events import SubjectFinished
from envcraft.plugins import plugins
from envcraft.sandbox import choose
from envcraft.target import PolicyFile, Target
from envcraft.verdict import SubjectReport

#: The cans lie where no search at this budget comes.
FAR = (FIXTURES / "instawin" / "good" / "fuel_run.py").read_text()
for _near, _far in (
    ("[1, 10]", "[24, 27]"),
    ("self.fuel = 30", "self.fuel = 60"),
    ("N = 12", "N = 28"),
    ("t(7,", "t(3,"),
):
    assert _near in FAR
    FAR = FAR.replace(_near, _far)
#: Whoever is out of fuel is told to have won.
TOLD = FAR.replace('{"fuel": self.fuel}', '{"is_success": empty}')
DRIVES = """
def policy(env):
    down, right = (int(a) - int(b) for a, b in zip(env.can, env.rover))
    return [(1 if down < 0 else 2) if down else (3 if right < 0 else 4), 1, 0]
"""
QUITS = "import os\n\nos._exit(3)\n\n\ndef policy(env):\n    return [0, 0, 0]"
FILLS = "def policy(env):\n    env.fuel = 90\n    return [0, 0, 0]"


def judged(game: str, policy: str) -> SubjectReport:
    plan = Plan(
        [Target("game.py", game.encode())],
        ARCADE,
        choose(plugins().collect("envcraft_sandbox_drivers"), "process"),
        [check for check in default_checks() if check.name in ("source", "instawin", "difficulty")],
        BUDGETS["quick"],
        policy=PolicyFile("policy.py", policy) if policy else None,
    )
    return next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))


@pytest.mark.parametrize(
    ("game", "policy", "codes"),
    [
        (FAR, "", {"EC601", "EC602", "EC802"}),
        (FAR, DRIVES, set()),
        (FAR, FILLS, {"EC601", "EC602", "EC802", "EC804"}),
        (FAR, QUITS, {"EC601", "EC602", "EC802", "EC805"}),
        (TOLD, DRIVES, {"EC601", "EC802"}),
    ],
)
def test_what_a_policy_earns(game: str, policy: str, codes: set[str]) -> None:
    assert failing(judged(game, policy)) == codes


def test_a_win_that_only_the_sign_tells_is_said_to_be_one() -> None:
    for game, said in ((FAR, True), (TOLD, False)):
        found = [one for check in judged(game, "").checks for one in check.findings if one.code in ("EC601", "EC802")]
        assert [("info tells no success" in one.message) for one in found] == [said, said]


#: What it pays in the end is mostly luck, which hangs on what is done; who holds a direction has a little more of it.
LUCK = """
import gymnasium
import numpy as np
from gymnasium import spaces


class Luck(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"]}

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


@pytest.mark.parametrize(("width", "warned"), [(10, True), (1, False)])
def test_a_policy_that_never_wins_is_better_only_where_that_is_clear(width: int, warned: bool) -> None:
    report = judged(LUCK.replace("WIDTH", str(width)), "def policy(env):\n    return [4, 0, 0]")
    found = [one for check in report.checks for one in check.findings if one.code == "EC806"]
    assert len(found) == warned
    for one in found:
        assert "wins 0 of 12 (0%, 99% interval 0% to 35.7%)" in one.message
        for name, told in one.evidence["leads"].items():
            assert told["n"] == 12
            assert (f"over {name} {told['estimate']:.3g} (95% interval" in one.message) == (told["low"] <= 0)
        # Higher in these twelve episodes, which tells nothing.
        means = one.evidence["means"]
        assert means["the policy"] > max(means["random play"], means["doing nothing"])
