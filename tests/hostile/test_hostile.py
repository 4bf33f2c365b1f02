"""Every hostile program costs its own verdict, and breaks none of the invariants, under docker and under bubblewrap.

Of those that are safe under process every third is tried there: its layers are those that the other two have as well.
``python -m tests.hostile.judge`` tries all under all.
"""

from __future__ import annotations

import pytest

from tests.hostile.judge import Program, Runs, missing, pairs, programs

PROGRAMS = programs()
_MARKS = {"docker": [pytest.mark.docker], "bubblewrap": [pytest.mark.bubblewrap]}
_NOT_UNDER_PROCESS = {program.name for number, program in enumerate(PROGRAMS) if number % 3}
_CASES = [
    pytest.param(program, driver, marks=_MARKS.get(driver, []), id=f"{driver}-{program.name}")
    for program, driver in pairs(PROGRAMS)
    if driver != "process" or program.name not in _NOT_UNDER_PROCESS
]


@pytest.mark.parametrize(("program", "driver"), _CASES)
def test_costs_only_its_own_verdict(program: Program, driver: str, runs: Runs) -> None:
    if reason := missing(driver):
        pytest.skip(reason)
    run = runs.result(program, driver)
    assert not [*run.wrong, *run.broken], f"{program.does}\n{run}"


def test_there_are_enough() -> None:
    assert len(PROGRAMS) >= 60
    assert sum(program.process for program in PROGRAMS) >= 40
