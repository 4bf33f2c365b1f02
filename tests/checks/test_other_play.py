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
        (TOLD, DRIVES, {"EC601", "EC802"}),
    ],
)
def test_what_a_policy_earns(game: str, policy: str, codes: set[str]) -> None:
    assert failing(judged(game, policy)) == codes


def test_a_win_that_only_the_sign_tells_is_said_to_be_one() -> None:
    for game, said in ((FAR, True), (TOLD, False)):
        found = [one for check in judged(game, "").checks for one in check.findings if one.code in ("EC601", "EC802")]
        assert [("info tells no success" in one.message) for one in found] == [said, said]
