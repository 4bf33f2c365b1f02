"""An environment with a check that left its question open counts as undecided, not as passed."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from envcraft.cli.commands.validate import exit_code
from envcraft.cli.progress import Tally
from envcraft.errors import ExitCode
from envcraft.model.verdict import CheckReport, Finding, Outcome, Report, Severity, Verdict
from envcraft.reports.concise import ConciseReporter
from envcraft.reports.console import ConsoleReporter
from envcraft.reports.github import GitHubReporter
from envcraft.reports.html import HtmlReporter
from envcraft.reports.json import JsonReporter
from envcraft.reports.junit import JUnitReporter
from envcraft.reports.markdown import MarkdownReporter
from envcraft.reports.reporter import Reporter
from envcraft.reports.sarif import SarifReporter
from tests.envcraft.conftest import ENVIRONMENT, Invoke
from tests.envcraft.report_samples import events, rendered, subject

PASSED = CheckReport("source", Verdict.PASS)
OPEN = CheckReport("difficulty", Verdict.SKIP, reason="no episode was won", undecided=True)
APART = CheckReport("instawin", Verdict.SKIP, reason="no episode ends by itself")
FAILED = CheckReport("api", Verdict.FAIL, 0.1, [Finding("EC107", Severity.ERROR, "step 1 raises")])
COUNTS = "1 passed, 1 failed, 2 undecided"


def sample() -> Report:
    """A pass with a check that does not apply, a failure with an open question, and two undecided environments."""
    return Report(
        "arcade",
        0,
        [
            subject("good.py", [PASSED, APART]),
            subject("bad.py", [PASSED, FAILED, OPEN]),
            subject("open.py", [PASSED, APART, OPEN]),
            subject("other.py", [PASSED, OPEN]),
        ],
    )


def test_the_verdict_stays_and_the_outcome_says_more() -> None:
    good, bad, undecided, _ = sample().reports
    assert [one.outcome for one in (good, bad, undecided)] == [Outcome.PASS, Outcome.FAIL, Outcome.UNDECIDED]
    assert (undecided.verdict, undecided.undecided, good.undecided) == (Verdict.PASS, ["difficulty"], [])
    assert [check.outcome for check in undecided.checks] == [Outcome.PASS, Outcome.SKIP, Outcome.UNDECIDED]
    # With --strict, the engine makes the open question a failure.
    strict = subject("open.py", [PASSED, CheckReport("difficulty", Verdict.FAIL, reason="not settled", undecided=True)])
    assert (strict.outcome, strict.undecided) == (Outcome.FAIL, [])
    assert exit_code(Report("arcade", 0, [undecided])) is ExitCode.PASS


def test_what_ran_out_of_time_is_said_not_to_pass() -> None:
    report = sample()
    late = [msgspec.structs.replace(each, out_of_time=each.undecided != []) for each in report.reports]
    words = "3 environments ran out of time: undecided checks have not passed; a longer --time-limit may settle them"
    assert words in rendered(ConsoleReporter, msgspec.structs.replace(report, reports=late))
    assert "ran out of time" not in rendered(ConsoleReporter, report)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (ConsoleReporter, "undecided: not settled"),
        (ConciseReporter, "open.py: error: the check difficulty is undecided and fails under --strict: not settled\n"),
        (GitHubReporter, "is undecided and fails under --strict::not settled"),
        (HtmlReporter, "undecided: not settled"),
        (JUnitReporter, '<failure message="undecided: not settled"'),
        (MarkdownReporter, "difficulty undecided"),
    ],
)
def test_a_strict_failure_says_that_it_is_undecided(kind: type[Reporter], words: str) -> None:
    strict = CheckReport("difficulty", Verdict.FAIL, reason="not settled", undecided=True)
    assert words in rendered(kind, Report("arcade", 0, [subject("open.py", [PASSED, strict])], strict=True))


@pytest.mark.parametrize("kind", [ConsoleReporter, GitHubReporter, HtmlReporter, MarkdownReporter])
def test_summaries_have_three_numbers(kind: type[Reporter]) -> None:
    assert COUNTS in rendered(kind, sample())
    alone = Report("arcade", 0, sample().reports[:1])
    assert "1 passed, 0 failed, 0 undecided" in rendered(kind, alone)


def test_the_console_tells_an_open_question_from_a_check_that_does_not_apply() -> None:
    lines = [" ".join(line.split()) for line in rendered(ConsoleReporter, sample()).splitlines()]
    assert lines.count("UNDECIDED open.py") == 1
    assert "- instawin 0.00 s no episode ends by itself" in lines
    assert lines.count("? difficulty 0.00 s undecided: no episode was won") == 3


def test_pages_show_and_filter_them() -> None:
    page = rendered(HtmlReporter, sample())
    assert page.count('data-verdict="undecided"') == 2
    assert '<input type="radio" name="verdict" value="undecided"> undecided 2' in page
    # Worst first.
    assert page.index(">bad.py<") < page.index(">open.py<") < page.index(">good.py<")
    comment = rendered(MarkdownReporter, sample())
    assert comment.startswith("### ❌")
    assert "| ❔ | <code>open.py</code> | difficulty undecided |" in comment
    assert rendered(MarkdownReporter, Report("arcade", 0, sample().reports[2:])).startswith("### ❔")


def test_programs_can_tell_them_apart() -> None:
    told = json.loads(rendered(JsonReporter, sample()))["reports"]
    assert [one["verdict"] for one in told] == ["pass", "fail", "pass", "pass"]
    assert [check["undecided"] for check in told[2]["checks"]] == [False, False, True]
    [run] = json.loads(rendered(SarifReporter, sample()))["runs"]
    assert [artifact["properties"]["undecided"] for artifact in run["artifacts"]] == [
        [],
        ["difficulty"],
        ["difficulty"],
        ["difficulty"],
    ]
    xml = rendered(JUnitReporter, sample())
    assert xml.count('<skipped message="undecided: no episode was won"') == 3
    assert '<skipped message="no episode ends by itself"' in xml


def test_progress_counts_them_apart() -> None:
    tally = Tally(lambda: 0.0)
    for event in events(sample()):
        tally.take(event)
    words = [words for words, _ in tally.words()]
    assert words == ["4 of 4 judged", "1 passed", "1 failed", "2 undecided"]


def test_episodes_that_raise_are_not_said_to_have_no_step(invoke: Invoke, good: Path) -> None:
    good.write_text(
        ENVIRONMENT.replace("        self.steps += 1\n", "        self.steps += 1\n        [0, 0, 0][self.steps]\n")
    )
    result = invoke("validate", good, "--sandbox", "process", "--budget", "quick", "--checks", "api,termination")
    assert "step 3 raises IndexError" in result.stdout
    assert "undecided: each episode raises an error or has no step" in result.stdout
