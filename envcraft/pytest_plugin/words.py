"""Text and report properties of findings."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

from envcraft.judging.selection import all_checks, rules_of
from envcraft.model.verdict import CheckReport, Finding, Outcome, Severity, Verdict
from envcraft.pytest_plugin.judging import Judged
from envcraft.reports.evidence import lines_below, place_of
from envcraft.reports.summary import checks_option, counted, reason_words, repro_words
from envcraft.text import one_line, plural, printable

#: The property with the outcome of the whole environment.
OUTCOME = "envcraft_outcome"
#: The attribute of a test's report with the properties of each environment that the test judged.
COUNTED = "envcraft_counted"
#: The outcomes of one environment in several tests, the one that counts first.
_WORST = (Outcome.FAIL, Outcome.ERROR, Outcome.UNDECIDED, Outcome.SKIP, Outcome.PASS)


def failure(judged: Judged, reports: Iterable[CheckReport], refused: Sequence[Finding] = ()) -> str:
    """Describe the findings that fail `reports`, with fixes, reproductions and the commands that show them again.

    Args:
        judged: the environment.
        reports: the checks that a test shows.
        refused: warnings that a filter turns into errors.
    """
    numbers = {id(finding): number for number, finding in enumerate(_findings(judged.report.checks), 1)}
    failing = [each for each in _findings(reports) if each.severity is Severity.ERROR or each in refused]
    blocks = [_block(judged, finding) for finding in failing]
    blocks += [_unsettled(report) for report in reports if report.verdict is Verdict.FAIL and report.reason]
    if failing:
        replays = (f"envcraft replay report.json --finding {numbers[id(finding)]}" for finding in failing)
        commands = [f"{command(judged)} --format json --output report.json", *replays]
        blocks.append("\n".join(["To see it again:", *(f"  {line}" for line in commands)]))
    return "\n\n".join(blocks)


def error(judged: Judged, reports: Iterable[CheckReport]) -> str:
    """Return why checks could not judge, and the next step."""
    lines = [
        f"the check {report.check} could not judge {one_line(judged.report.path)}, which is not a failure of the "
        f"environment: {one_line(report.reason)}"
        for report in reports
        if report.verdict is Verdict.ERROR
    ]
    return "\n".join([*lines, f"Try it by itself: {command(judged)}"])


def skipped(report: CheckReport) -> str:
    """Return why a check gave no verdict."""
    return reason_words(report)


def unjudged(reason: Exception) -> str:
    """Return why nothing could be judged."""
    return f"nothing was judged: {one_line(reason)}"


def warning(judged: Judged, finding: Finding) -> str:
    """Describe a finding in one line."""
    rule = rules_of(all_checks()).get(finding.code)
    fix = f" (fix: {rule.fix})" if rule else ""
    return f"{_head(judged, finding)}: {one_line(finding.message)}{fix}"


def command(judged: Judged) -> str:
    """Return the command that judges the same again."""
    settings, path = judged.settings, judged.report.path
    words = ["envcraft", "validate", f"./{path}" if path.startswith("-") else path]
    words += ["--class", judged.spec.env_class] if judged.spec.env_class else []
    words += checks_option(judged.report)
    words += ["--contract", settings.contract, "--budget", settings.budget, "--seed", str(settings.seed)]
    words += ["--sandbox", settings.sandbox] if settings.sandbox != "auto" else []
    return printable(shlex.join(words))


def properties(judged: Judged, reports: Iterable[CheckReport]) -> Iterator[tuple[str, str]]:
    """Yield the properties for JUnit XML."""
    report, settings = judged.report, judged.settings
    found = {
        "subject": report.path,
        "class": report.env_class or "",
        "source_sha256": report.source_sha256,
        "contract": settings.contract,
        "budget": settings.budget,
        "seed": settings.seed,
        "isolation": report.isolation,
        "driver": report.driver,
        "steps": report.steps,
        "outcome": report.outcome,
        "codes": " ".join(dict.fromkeys(finding.code for finding in _findings(reports))),
    }
    for name, value in found.items():
        yield f"envcraft_{name}", one_line(value)


def summary(found: Iterable[dict[str, str]]) -> str:
    """Summarise the outcomes of the environments and their isolation.

    Args:
        found: the properties of each environment, once for each test that judged it.
    """
    worst = sorted(found, key=lambda one: _WORST.index(Outcome(one[OUTCOME])), reverse=True)
    subjects = {(one["envcraft_subject"], one["envcraft_class"]): one for one in worst}.values()
    outcomes = ", ".join(words for _, words in counted(Counter(Outcome(one[OUTCOME]) for one in subjects)))
    levels = Counter((subject["envcraft_isolation"], subject["envcraft_driver"]) for subject in subjects)
    isolated = ", ".join(
        f"{isolation} isolation" + (f" by {driver}" if driver != isolation else "") for isolation, driver in levels
    )
    weak = "; this protects against accidents, not against malice: `envcraft doctor` lists what is missing"
    process = any(isolation == "process" for isolation, _ in levels)
    return f"envcraft: {plural(len(subjects), 'environment')}: {outcomes}; {isolated}{weak if process else ''}"


def _unsettled(report: CheckReport) -> str:
    words = (
        f"the check {report.check} is undecided and fails under strict in [tool.envcraft]: " if report.undecided else ""
    )
    return words + one_line(report.reason)


def _block(judged: Judged, finding: Finding) -> str:
    rule = rules_of(all_checks()).get(finding.code)
    lines = [_head(judged, finding), f"  {one_line(finding.message)}", *lines_below(judged.report, finding)]
    lines += [f"  fix: {rule.fix}"] if rule else []
    return "\n".join([*lines, f"  reproduction: {repro_words(finding.repro)}"])


def _head(judged: Judged, finding: Finding) -> str:
    rule = rules_of(all_checks()).get(finding.code)
    return f"{one_line(finding.code)}{f' {rule.name}' if rule else ''} {one_line(place_of(judged.report, finding))}"


def _findings(reports: Iterable[CheckReport]) -> Iterator[Finding]:
    return chain.from_iterable(report.findings for report in reports)
