"""Near misses that failed with one value of ``--seed`` only."""

from __future__ import annotations

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.target import read_target
from evaluation.fixtures import FIXTURES
from evaluation.judge import failing, judge_plans


# A penalty for waiting: with this seed only held actions last long.
@pytest.mark.parametrize(("name", "seed"), [("reward/good/impatient_audience.py", 3)])
def test_passes_with_this_seed(name: str, seed: int) -> None:
    target = read_target(str(FIXTURES / name))
    plan = Plan([target], ARCADE, driver_named("process"), default_checks(), BUDGETS["quick"], seed=seed)
    [(_, report)] = judge_plans([plan])
    assert failing(report) == frozenset()
