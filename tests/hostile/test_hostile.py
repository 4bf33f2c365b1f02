"""Every hostile program costs its own verdict, and breaks none of the invariants.

Here each is tried under one of the drivers in turn, or under all that ``ENVCRAFT_HOSTILE=docker,process`` names.
``python -m tests.hostile.judge`` tries all under all and prints a table.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.hostile.judge import Program, Runs, missing, pairs, programs

PROGRAMS = programs()
_MARKS = {"docker": [pytest.mark.docker], "bubblewrap": [pytest.mark.bubblewrap]}
_NAMED = os.environ.get("ENVCRAFT_HOSTILE", "")


def _cases() -> Iterator[tuple[Program, str]]:
    under: dict[str, list[str]] = {}
    for program, driver in pairs(PROGRAMS):
        under.setdefault(program.name, []).append(driver)
    for number, program in enumerate(PROGRAMS):
        own = under[program.name]
        for driver in set(own) & set(_NAMED.split(",")) if _NAMED else [own[number % len(own)]]:
            yield program, driver


_CASES = [
    pytest.param(program, driver, marks=_MARKS.get(driver, []), id=f"{driver}-{program.name}")
    for program, driver in sorted(_cases(), key=lambda case: -case[0].seconds)
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
