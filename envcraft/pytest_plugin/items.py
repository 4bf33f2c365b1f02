"""Tests that stand for one check: the setup judges, the call fails or skips."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from envcraft.errors import EnvCraftError
from envcraft.model.verdict import Severity, Verdict
from envcraft.pytest_plugin import words
from envcraft.pytest_plugin.judging import CASE, Case, Judged, Outcome, judge_of
from envcraft.pytest_plugin.settings import EnvCraftWarning

_OUTCOME = pytest.StashKey[Outcome]()
_COUNTED = pytest.StashKey[list[dict[str, str]]]()
_UNJUDGED = "envcraft_unjudged"


class CheckItem(pytest.Item):
    """One check of one environment file, whose class is at `line`."""

    line: int = 1

    def setup(self) -> None:
        settle(self, self.stash[CASE])

    def runtest(self) -> None:
        """Do nothing: ``pytest_runtest_call`` of the plugin fails or skips the test."""

    def reportinfo(self) -> tuple[Path, int, str]:
        return self.path, self.line - 1, f"{self.name} of {self.parent.nodeid if self.parent else self.path}"


def settle(item: pytest.Item, case: Case) -> Outcome:
    """Judge the case of a test; make the test an error if that is impossible."""
    try:
        outcome = judge_of(item.config).case(item.session, case)
    except EnvCraftError as error:
        raise could_not_judge(words.unjudged(error)) from None
    item.stash[_OUTCOME] = outcome
    count(item, outcome.judged)
    found = dict(words.properties(outcome.judged, outcome.reports))
    # A test that runs again has its properties already.
    others = [(name, value) for name, value in item.user_properties if name not in found]
    item.user_properties[:] = [*others, *found.items()]
    if outcome.verdict is Verdict.ERROR:
        raise could_not_judge(words.error(outcome.judged, outcome.reports))
    return outcome


def count(item: pytest.Item, judged: Judged) -> None:
    """Let the summary count an environment that a test judged."""
    item.stash.setdefault(_COUNTED, []).append(dict(words.properties(judged, ())))


def conclude(item: pytest.Item) -> None:
    """Fail or skip a test as its check does, and issue warnings, before its own code runs."""
    outcome = item.stash.get(_OUTCOME, None)
    if outcome is None:
        return
    refused = []
    for finding in outcome.own.findings:
        if finding.severity is Severity.WARNING:
            message = EnvCraftWarning(words.warning(outcome.judged, finding))
            try:
                warnings.warn_explicit(message, EnvCraftWarning, outcome.judged.report.path, finding.line or 1)
            except EnvCraftWarning:
                # A filter turns the warning into an error.
                refused.append(finding)
    if refused:
        item.user_properties[:] = [
            (name, Verdict.FAIL.value if name == words.OUTCOME else value) for name, value in item.user_properties
        ]
        # One test fails the environment, which passes in all others.
        count(item, outcome.judged)
        item.stash[_COUNTED][-1][words.OUTCOME] = Verdict.FAIL.value
    if outcome.verdict is Verdict.FAIL or refused:
        pytest.fail(words.failure(outcome.judged, outcome.reports, refused), pytrace=False)
    if outcome.verdict is Verdict.SKIP:
        pytest.skip(words.skipped(outcome.own))


def could_not_judge(message: str) -> BaseException:
    """Make an exception that turns the test into an error in any phase."""
    failed = pytest.fail.Exception(message, pytrace=False)
    setattr(failed, _UNJUDGED, True)
    return failed


def amend(item: pytest.Item, call: pytest.CallInfo[None], report: pytest.TestReport) -> None:
    """Add the judged environments, the check's time and its location to a report, and turn a test without a verdict
    into an error.
    """
    # xdist sends all attributes of a report to its controller.
    setattr(report, words.COUNTED, item.stash.get(_COUNTED, []))
    if call.excinfo is not None and hasattr(call.excinfo.value, _UNJUDGED):
        # pytest reports a failure as an error in every phase except the call.
        report.when = "setup"
    outcome = item.stash.get(_OUTCOME, None)
    if outcome is None:
        return
    if call.when == "setup":
        report.duration = outcome.own.seconds
    elif report.skipped and outcome.verdict is Verdict.SKIP:
        path, line, _ = item.reportinfo()
        report.longrepr = (str(path), (line or 0) + 1, f"Skipped: {words.skipped(outcome.own)}")
