"""Every hostile program costs its own verdict, and breaks none of the invariants.

Here each is tried under one of the drivers; ``python -m tests.hostile.judge`` tries all under all and prints a table.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hostile.judge import Program, Runs, missing, pairs, programs

PROGRAMS = programs()
_MARKS = {"docker": [pytest.mark.docker], "bubblewrap": [pytest.mark.bubblewrap]}


def _turns() -> Iterator[tuple[Program, str]]:
    """Each program under one driver, in turn: all under all take three times as long, and are the judge's."""
    under: dict[str, list[str]] = {}
    for program, driver in pairs(PROGRAMS):
        under.setdefault(program.name, []).append(driver)
    for number, program in enumerate(PROGRAMS):
        yield program, under[program.name][number % len(under[program.name])]


_CASES = [
    pytest.param(program, driver, marks=_MARKS.get(driver, []), id=f"{driver}-{program.name}")
    for program, driver in _turns()
]


@pytest.fixture(scope="session")
def runs(request: pytest.FixtureRequest) -> Iterator[Runs]:
    """All runs that this session asks for, begun side by side."""
    with Runs() as begun:
        for item in request.session.items:
            spec = getattr(item, "callspec", None)
            if spec is not None and item.path == Path(__file__) and not missing(spec.params["driver"]):
                begun.begin(spec.params["program"], spec.params["driver"])
        yield begun


@pytest.mark.parametrize(("program", "driver"), _CASES)
def test_costs_only_its_own_verdict(program: Program, driver: str, runs: Runs) -> None:
    if reason := missing(driver):
        pytest.skip(reason)
    run = runs.result(program, driver)
    assert not [*run.wrong, *run.broken], f"{program.does}\n{run}"


def test_there_are_enough() -> None:
    assert len(PROGRAMS) >= 60
    assert sum(program.process for program in PROGRAMS) >= 40
