"""Every fixture is judged exactly as its header says: no defect missed, no false alarm, no other reason.

Good ones are judged by all checks at the budget `quick`, bad ones by those whose codes they expect, at `standard` where
`quick` is not enough; ``python -m benchmarks.detection`` judges all by all at `standard`.
"""

from __future__ import annotations

import re

import pytest

from benchmarks.fixtures import Fixture, fixtures
from benchmarks.judge import failing, judge
from envcraft.cli import offered
from envcraft.verdict import SubjectReport, Verdict

ALL = fixtures()


@pytest.fixture(scope="session")
def reports() -> dict[str, SubjectReport]:
    # A container for each worker would take longer than what is judged in it.
    bubblewrap = next(driver for driver in offered("envcraft_sandbox_drivers") if driver.name == "bubblewrap")
    sandbox = "bubblewrap" if bubblewrap.probe().works else "auto"
    return {str(fixture.policy or fixture.path): report for fixture, report in judge(ALL, sandbox, narrow=True)}


@pytest.mark.parametrize("fixture", ALL, ids=lambda fixture: f"{fixture.check}/{(fixture.policy or fixture.path).name}")
def test_judged_as_expected(fixture: Fixture, reports: dict[str, SubjectReport]) -> None:
    report = reports[str(fixture.policy or fixture.path)]
    errors = [f"{check.check}: {check.reason}" for check in report.checks if check.verdict is Verdict.ERROR]
    assert not errors
    findings = [f"{finding.code} {finding.message}" for check in report.checks for finding in check.findings]
    assert failing(report) == fixture.codes, "\n".join(findings)
    if not fixture.codes:
        warned = {finding.code for check in report.checks for finding in check.findings}
        named = re.findall(r"warning (EC\d{3})", fixture.path.read_text("utf-8").partition("\n")[0])
        # That an episode goes on after its end is nobody's subject here.
        assert warned - {"EC505"} == set(named), "\n".join(findings)


@pytest.mark.parametrize("check", sorted({fixture.check for fixture in fixtures()}))
def test_enough_fixtures(check: str) -> None:
    own = fixtures(check)
    assert sum(not fixture.codes for fixture in own) >= 3
    assert sum(bool(fixture.codes) for fixture in own) >= 5
