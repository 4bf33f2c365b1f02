"""An environment of another contract: two findings at most, and each names the contract that fits."""

from __future__ import annotations

import msgspec
import pytest

from envcraft.contracts.builtin import ARCADE, ARCADE_NATIVE, GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named, select_checks
from envcraft.judging.severity import SeverityPolicy
from envcraft.model.contract import Contract
from envcraft.model.events import Finished
from envcraft.model.target import Kind, Target
from envcraft.model.verdict import SubjectReport, Verdict

CARTPOLE = Target("gymnasium:CartPole-v1", kind=Kind.ID)
_GAME = """
import gymnasium as gym
import numpy as np

class Game(gym.Env):
    observation_space = {observation}
    action_space = {action}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {{}}

    def step(self, action):
        assert self.action_space.contains(action)
        return self.observation_space.sample(), 0.0, False, False, {{}}
"""
_FRAMES = "gym.spaces.Box(0, 255, (210, 160, 3), np.uint8)"
_SMALL_FRAMES = "gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)"
_VECTOR = "gym.spaces.Box(-1.0, 1.0, (4,), np.float32)"
_PAD = "gym.spaces.MultiDiscrete([5, 2, 2])"


def game(observation: str, action: str) -> Target:
    return Target("game.py", _GAME.format(observation=observation, action=action).encode())


def judged(target: Target, contract: Contract = ARCADE, checks: str | None = None, select: str = "") -> SubjectReport:
    codes = (select,) if select else ()
    selected = select_checks(checks, None, codes)
    severity = SeverityPolicy(select=codes)
    plan = Plan([target], contract, driver_named("process"), selected, BUDGETS["quick"], severity=severity)
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return last.report.reports[0]


def findings(report: SubjectReport) -> dict[str, str]:
    """The message of each finding by its code, warnings included."""
    found = [finding for check in report.checks for finding in check.findings]
    assert len({finding.code for finding in found}) == len(found)
    return {finding.code: finding.message for finding in found}


@pytest.mark.parametrize("contract", [ARCADE, ARCADE_NATIVE], ids=lambda contract: contract.name)
def test_an_installed_environment_of_other_spaces(contract: Contract) -> None:
    report = judged(CARTPOLE, contract)
    found = findings(report)
    assert set(found) == {"EC101", "EC102"}
    assert all(words.endswith("--contract gymnasium") for words in found.values())
    assert (report.verdict, report.steps) == (Verdict.FAIL, 0)
    assert {check.verdict for check in report.checks if check.check not in ("source", "api", "sandbox")} == {
        Verdict.SKIP
    }


@pytest.mark.parametrize(
    ("target", "contract", "codes", "fits"),
    [
        (game(_FRAMES, _PAD), ARCADE, {"EC101"}, "arcade-native"),
        (game(_FRAMES, "gym.spaces.Discrete(6)"), ARCADE, {"EC101", "EC102"}, "gymnasium"),
        (game(_FRAMES, "gym.spaces.Discrete(6)"), ARCADE_NATIVE, {"EC102"}, "gymnasium"),
        (game(_SMALL_FRAMES, "gym.spaces.Discrete(6)"), ARCADE, {"EC102"}, "gymnasium"),
        (game(_VECTOR, _PAD), ARCADE_NATIVE, {"EC101"}, "gymnasium"),
    ],
    ids=["frames", "frames and six actions", "native frames and six actions", "six actions", "native vector"],
)
def test_the_contract_that_fits_is_named(target: Target, contract: Contract, codes: set[str], fits: str) -> None:
    found = findings(judged(target, contract))
    assert set(found) == codes
    assert all(words.endswith(f"--contract {fits}") for words in found.values())


@pytest.mark.parametrize("contract", [ARCADE, GYMNASIUM], ids=lambda contract: contract.name)
def test_a_space_that_is_missing_is_called_so(contract: Contract) -> None:
    target = game(_SMALL_FRAMES, _PAD)
    source = target.source.replace(b"    observation_space =", b"    frames =")
    found = findings(judged(msgspec.structs.replace(target, source=source), contract, checks="api"))
    assert found["EC101"] == "Game has no observation_space; set it in __init__"
    assert "EC102" not in found


def test_no_contract_fits_a_space_that_gymnasium_does_not_have() -> None:
    found = findings(judged(game(_FRAMES.replace("(210", "(0, 210"), "None")))
    assert not [words for words in found.values() if "--contract" in words]
    assert "EC102" in found


def test_a_check_alone_judges_nothing_with_actions_of_another_space() -> None:
    report = judged(CARTPOLE, checks="reward")
    assert (report.verdict, report.steps) == (Verdict.ERROR, 0)
    assert "--contract gymnasium" in report.reason


def test_the_findings_are_reported_whatever_rules_are_selected() -> None:
    assert set(findings(judged(CARTPOLE, select="EC107"))) == {"EC101", "EC102"}
