"""Every fixture gets exactly the codes of its header.

All checks judge the good fixtures at the budget `quick`. The checks of the expected codes judge the bad ones, at
`standard` if `quick` is not enough. ``python -m benchmarks.detection`` runs all checks on all fixtures at `standard`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest

from envcraft.model.verdict import SubjectReport, Verdict
from envcraft.registry import offered
from evaluation.fixtures import Fixture, fixtures
from evaluation.judge import failing, judge_fixtures

ALL = fixtures()


class Reports:
    """The reports of fixtures, judged side by side. A second request, by a rerun, judges the fixture again."""

    def __init__(self, chosen: Sequence[Fixture]) -> None:
        # Faster than a container for each worker.
        bubblewrap = next(driver for driver in offered("envcraft_sandbox_drivers") if driver.name == "bubblewrap")
        self._sandbox = "bubblewrap" if bubblewrap.probe().works else "auto"
        self._unread = self._judged(chosen)

    def take(self, fixture: Fixture) -> SubjectReport:
        return self._unread.pop(fixture, None) or self._judged([fixture])[fixture]

    def _judged(self, chosen: Sequence[Fixture]) -> dict[Fixture, SubjectReport]:
        return dict(judge_fixtures(chosen, self._sandbox, narrow=True))


@pytest.fixture(scope="module")
def reports(request: pytest.FixtureRequest) -> Reports:
    # Only the fixtures that options such as -k have left.
    items = [item for item in request.session.items if isinstance(item, pytest.Function)]
    named = [item.callspec.params.get("fixture") for item in items if hasattr(item, "callspec")]
    return Reports([fixture for fixture in ALL if fixture in named])


# The first of these may wait for all other fixtures, which are judged side by side.
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fixture", ALL, ids=lambda fixture: f"{fixture.check}/{(fixture.policy or fixture.path).name}")
def test_judged_as_expected(fixture: Fixture, reports: Reports) -> None:
    report = reports.take(fixture)
    errors = [f"{check.check}: {check.reason}" for check in report.checks if check.verdict is Verdict.ERROR]
    assert not errors
    findings = [f"{finding.code} {finding.message}" for check in report.checks for finding in check.findings]
    hint = "" if failing(report) or not fixture.codes else "no error; the fixture of a warning belongs in good/"
    assert failing(report) == fixture.codes, "\n".join([*findings, hint])
    if not fixture.codes:
        warned = {finding.code for check in report.checks for finding in check.findings}
        named = re.findall(r"warning (EC\d{3})", fixture.path.read_text("utf-8").partition("\n")[0])
        # EC505 warns of any environment that can be stepped after the end of an episode.
        assert warned - {"EC505"} <= set(named), "\n".join(findings)
        # A policy may come to what no other play sees.
        assert fixture.policy or set(named) <= warned, "\n".join(findings)


@pytest.mark.parametrize("check", sorted({fixture.check for fixture in fixtures()}))
def test_enough_fixtures(check: str) -> None:
    own = fixtures(check)
    assert sum(not fixture.codes for fixture in own) >= 3
    assert sum(bool(fixture.codes) for fixture in own) >= 5
