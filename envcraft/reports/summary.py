"""Parts that several reporters share: numbered findings, the summary, reproductions in words and as commands."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import msgspec

from envcraft.model.classes import defined_classes
from envcraft.model.target import Kind
from envcraft.model.verdict import CheckReport, Finding, Outcome, Report, Repro, Severity, SubjectReport, Verdict, plain
from envcraft.reports.evidence import source_of
from envcraft.text import one_line, plural, printable

#: The words of summaries. The first three are always counted, the others if they occur.
OUTCOMES = {
    Outcome.PASS: "passed",
    Outcome.FAIL: "failed",
    Outcome.UNDECIDED: "undecided",
    Outcome.SKIP: "skipped",
    Outcome.ERROR: "could not be judged",
}
_COUNTED = 3

#: Words for conditions of a reproduction.
_CONDITIONS = {
    "companion": "beside another instance",
    "again": "played twice",
    "clock": "another clock",
    "closed": "after another instance was closed",
    "fresh": "fresh worker",
    "int32": "actions of int32",
    "python": "actions as Python lists or ints",
    "recorded": "all of them recorded",
    "render": "with render() in between",
    "reuse": "one action array for all steps",
    "unrendered": "without a render mode",
    "unseeded": "reset without a seed",
}


class Numbered(NamedTuple):
    """A finding with its position.

    Attributes:
        number: counts the findings of the report from 1, as ``envcraft replay --finding`` does.
        own: counts the findings of the subject from 1.
        place: the index of the subject.
    """

    number: int
    own: int
    place: int
    subject: SubjectReport
    check: CheckReport
    finding: Finding


def numbered(report: Report) -> Iterator[Numbered]:
    """Yield every finding of a report in order."""
    number = 0
    for place, subject in enumerate(report.reports):
        own = 0
        for check in subject.checks:
            for finding in check.findings:
                number, own = number + 1, own + 1
                yield Numbered(number, own, place, subject, check, finding)


def summary_words(report: Report) -> str:
    """Summarise a report: ``1 passed, 2 failed, 0 undecided: 3 findings, 1 warning``, and what does not count."""
    counts = ", ".join(words for _, words in counted(Counter(subject.outcome for subject in report.reports)))
    severities = Counter(item.finding.severity for item in numbered(report))
    errors, warnings = severities[Severity.ERROR], severities[Severity.WARNING]
    rest = "".join(f"; {words}" for words in uncounted(report))
    return f"{counts or 'nothing judged'}: {plural(errors, 'finding')}, {plural(warnings, 'warning')}{rest}"


def uncounted(report: Report) -> list[str]:
    """Phrases with the numbers of findings and environments that the counts of a summary leave out; none of 0."""
    checks = [check for subject in report.reports for check in subject.checks]
    numbers = {
        "ignored by comments": sum(len(check.ignored) for check in checks),
        "known from the baseline": sum(len(check.known) for check in checks),
        "not judged after the first failure": report.unjudged,
    }
    return [f"{number:,} {words}" for words, number in numbers.items() if number]


def counted(counts: Mapping[Outcome, int]) -> list[tuple[Outcome, str]]:
    """Return the counts of a summary as phrases: ``2 passed``, ``1 failed``, ``0 undecided``; nothing if all are 0."""
    if not any(counts.values()):
        return []
    return [
        (outcome, f"{counts.get(outcome, 0):,} {words}")
        for place, (outcome, words) in enumerate(OUTCOMES.items())
        if place < _COUNTED or counts.get(outcome)
    ]


def unsettled(subject: SubjectReport) -> list[CheckReport]:
    """The checks that fail without an error, because ``--strict`` fails what is undecided."""
    return [
        check
        for check in subject.checks
        if check.verdict is Verdict.FAIL
        and check.undecided
        and not any(finding.severity is Severity.ERROR for finding in check.findings)
    ]


def repro_words(repro: Repro) -> str:
    """Describe a reproduction: ``seed 0, 41 actions, hash_seed 1``."""
    parts = [f"seed {repro.seed}", plural(len(repro.actions), "action") if repro.actions else "no action"]
    parts += [_condition(name, value) for name, value in repro.conditions.items()]
    return one_line(", ".join(parts))


def _condition(name: str, value: Any) -> str:
    if name == "before" and isinstance(value, list):
        return f"after {plural(len(value), 'other episode')}"
    words = _CONDITIONS.get(name, name)
    return words if value is True or isinstance(value, dict | list) else f"{words} {value}"


def replay_command(report: Report, item: Numbered) -> str:
    """Return two commands that show one finding again: validate the subject alone, then replay its report."""
    options = _class_option(item.subject)
    options += [] if report.contract == "arcade" else ["--contract", report.contract]
    options += [] if report.budget == "standard" else ["--budget", report.budget]
    options += ["--seed", str(report.seed)] if report.seed else []
    options += checks_option(item.subject)
    options += ["--policy", item.subject.policy] if item.subject.policy else []
    options += ["--kwargs", _json(item.subject.kwargs)] if item.subject.kwargs else []
    options += [word for name in item.subject.wrappers for word in ("--wrap", name)]
    path = f"./{item.subject.path}" if item.subject.path.startswith("-") else item.subject.path
    words = ["envcraft", "validate", path, *options, "--format", "json", "--output", "report.json"]
    return f"{shlex.join(map(printable, words))}\nenvcraft replay report.json --finding {item.own}"


def checks_option(subject: SubjectReport) -> list[str]:
    """The option that runs the checks of a report, if these are not the usual ones: findings are numbered in order."""
    from envcraft.judging.selection import default_checks

    ran = [check.check for check in subject.checks]
    return [] if set(ran) == {check.name for check in default_checks()} else ["--checks", ",".join(ran)]


def _class_option(subject: SubjectReport) -> list[str]:
    """The option that picks the class of a report, if its file may define another."""
    if subject.kind is not Kind.SOURCE or subject.env_class is None or not (source := source_of(subject)):
        return []
    return [] if defined_classes(source) == [subject.env_class] else ["--class", subject.env_class]


def reason_words(check: CheckReport) -> str:
    """Why a check gave no verdict; of an undecided one it says so, also where ``--strict`` fails it."""
    words = one_line(check.reason)
    return f"undecided: {words}" if check.undecided and words else words


def _json(value: Any) -> str:
    return msgspec.json.encode(plain(value)).decode()
