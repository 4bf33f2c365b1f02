"""The rules themselves: their documentation, their coverage by fixtures, and the pure functions that they judge by."""

from __future__ import annotations

import ast

import numpy as np
import pytest
from envcraft_checks.comparing.traces import diverge
from envcraft_checks.imports import required_imports
from envcraft_checks.pictures.noise import noise
from envcraft_checks.rewards.growth import growth

from envcraft.judging.check import Check
from envcraft.model.job import ExitReason, JobResult
from envcraft.model.rollout import Rollout
from envcraft.model.trace import Trace
from envcraft.model.verdict import Severity
from envcraft.plugins import plugins
from evaluation.fixtures import examples, fixtures

CHECKS: list[Check] = plugins().collect("envcraft_checks")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_each_check_is_documented(check: Check) -> None:
    for heading in ("# " + check.name, "## What it does", "## Why is this bad?", "## Example"):
        assert heading in check.page


def test_codes_are_unique_and_in_their_family() -> None:
    codes = [rule.code for check in CHECKS for rule in check.rules]
    assert len(codes) == len(set(codes))
    for check in CHECKS:
        assert len({rule.code[:3] for rule in check.rules}) == 1


def test_every_error_has_a_fixture() -> None:
    shown = {code for fixture in [*fixtures(), *examples()] for code in fixture.codes}
    # What trains agents has small games of its own.
    judged = [check for check in CHECKS if not check.opt_in]
    errors = {rule.code for check in judged for rule in check.rules if rule.severity is Severity.ERROR}
    # A file of megabytes is made by a test; sandbox events have the conformance suite, and slow games small ones.
    assert errors - shown - {"EC010"} == {
        rule.code
        for check in CHECKS
        if check.name in ("sandbox", "speed")
        for rule in check.rules
        if rule.severity is Severity.ERROR
    }


def test_optional_imports_are_not_required() -> None:
    source = """
import numpy.random
from gymnasium import spaces
try:
    import cv2
except ImportError:
    import fallback
if TYPE_CHECKING:
    import typing_only
if __name__ == "__main__":
    import matplotlib
def method():
    import late
method()
with contextlib.suppress(ImportError):
    import numba
HAS_JAX = importlib.util.find_spec("jax") is not None
if HAS_JAX:
    import jax
"""
    wanted = {"numpy": 2, "gymnasium": 3, "late": 13}
    assert required_imports(ast.parse(source)) == wanted
    assert required_imports(ast.parse(source), {"cv2"}) == {**wanted, "fallback": 7}


@pytest.mark.parametrize(
    ("test", "wanted"),
    [
        ("sys.version_info >= (3, 12)", {"new"}),
        ("sys.version_info < (3, 12, 5)", {"old"}),
        ("version_info < (3, 13)", {"new"}),
        ("sys.version_info[:2] >= (3, 12)", set()),
        ("sys.version_info >= (3, 12) and FAST", set()),
        ("sys.platform == 'win32'", {"new", "old"}),
    ],
)
def test_of_versions_the_one_that_runs_is_required(test: str, wanted: set[str]) -> None:
    tree = ast.parse(f"if {test}:\n    import new\nelse:\n    import old")
    assert set(required_imports(tree, python=(3, 12, 5))) == wanted


def test_imports_of_functions_that_nothing_calls_are_not_required() -> None:
    source = """
class Game:
    def step(self, action):
        return self._draw()
    def _draw(self):
        import drawn
    def show(self):
        import shown
        self.show()
    @property
    def picture(self):
        import pictured
def outer():
    return inner()
def inner():
    import played
def attempt():
    import attempted
try:
    attempt()
except Exception:
    pass
if __name__ == "__main__":
    outer()
"""
    assert set(required_imports(ast.parse(source))) == {"drawn", "pictured", "attempted"}


@pytest.mark.parametrize(("reason", "differs"), [(ExitReason.TIMEOUT, False), (ExitReason.DIED, True)])
def test_missed_deadline_is_not_a_divergence(reason: ExitReason, differs: bool) -> None:
    whole = Trace(Rollout(0, [0]), observations=[b"0", b"1"], infos=[b"{}"] * 2, rewards=[0.0])
    whole.terminated, whole.truncated = [False], [False]
    ended = Trace(Rollout(0, [0]), observations=[b"0"], infos=[b"{}"], end=JobResult(reason, "step", 5.0))
    assert (diverge(whole, ended, True) is not None) is differs
    ended.observations = [b"2"]
    assert diverge(whole, ended, True) is not None


def test_growth_is_told_from_prizes_and_plateaus() -> None:
    assert growth([0.01 * step for step in range(200)]) is not None
    assert growth([-0.01 * step for step in range(200)]) is not None
    assert growth([1.0] * 200) is None
    assert growth([-0.002 * step for step in range(400)]) is None
    assert growth([float(step == 190) * 50 for step in range(200)]) is None
    assert growth([min(step, 100) * 0.01 for step in range(200)]) is None
    assert growth([1.0 + 0.001 * step for step in range(200)]) is None
    assert growth([max(0.0, 0.05 * (step - 80)) for step in range(200)]) is not None
    assert growth([max(0.0, 1.0 * (step - 150)) for step in range(200)]) is None
    assert growth([2.0 * (step >= 100) for step in range(200)]) is None
    assert growth([0.0] * 200) is None


def test_noise_is_told_from_motion_and_flicker() -> None:
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 256, (24, 24, 3), dtype=np.uint8) for _ in range(64)]
    measured = noise(frames)
    assert measured is not None
    assert measured[0]

    texture = rng.integers(0, 256, (24, 200, 3), dtype=np.uint8)
    scrolling = [texture[:, start : start + 24] for start in range(64)]
    flicker = [np.full((24, 24, 3), 255 * (number % 2), np.uint8) for number in range(64)]
    dot = [np.zeros((24, 24, 3), np.uint8) for _ in range(64)]
    for number, frame in enumerate(dot):
        frame[number % 24, rng.integers(24)] = 255
    wide = rng.integers(0, 256, (24, 24 + 5 * 64, 3), dtype=np.uint8)
    fast = [wide[:, 5 * number : 5 * number + 24] for number in range(64)]
    for good in (flicker, dot, fast):
        measured = noise(good)
        assert measured is not None
        assert not measured[0]
    assert noise(scrolling[:5]) is None

    for block in (2, 6, 12):
        cells = (24 // block, 24 // block, 3)
        coarse = [rng.integers(0, 256, cells, np.uint8).repeat(block, 0).repeat(block, 1) for _ in range(64)]
        measured = noise(coarse)
        assert measured is not None
        assert measured[0]
