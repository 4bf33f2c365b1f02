"""Every hostile program affects only its own verdict and breaks no invariant, under docker and bubblewrap.

``ENVCRAFT_HOSTILE=process`` names other drivers. ``python -m tests.hostile.judge`` runs all programs under all drivers
and prints a table.
"""

from __future__ import annotations

import os

import pytest

from tests.hostile.judge import Program, Runs, missing, pairs, programs

PROGRAMS = programs()
_MARKS = {"docker": [pytest.mark.docker], "bubblewrap": [pytest.mark.bubblewrap]}
_NAMED = os.environ.get("ENVCRAFT_HOSTILE", "docker,bubblewrap").split(",")
_CASES = [
    pytest.param(program, driver, marks=_MARKS.get(driver, []), id=f"{driver}-{program.name}")
    for program, driver in pairs(PROGRAMS)
    if driver in _NAMED
]


@pytest.mark.parametrize(("program", "driver"), _CASES)
def test_affects_only_its_own_verdict(program: Program, driver: str, runs: Runs) -> None:
    if reason := missing(driver):
        pytest.skip(reason)
    run = runs.result(program, driver)
    assert not [*run.wrong, *run.broken], f"{program.does}\n{run}"


def test_number_of_programs() -> None:
    assert len(PROGRAMS) >= 60
    assert sum(program.process for program in PROGRAMS) >= 40
