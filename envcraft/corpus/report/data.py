"""The figures of a report, counted in one pass over the environments in the order of their names.

Only a few numbers are kept for each environment. Reports and sources are read one at a time.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from math import log10
from typing import Any

import msgspec
import numpy as np

from envcraft.corpus.store import Environment, Store, decode, verdicts
from envcraft.judging.statistics import Proportion
from envcraft.model.verdict import Outcome, Severity, SubjectReport, Verdict

#: The verdict of an environment without a verdict on its present source.
NONE = "none"
#: The outcomes that a stage counts, in the order of its fields, and those that remove an environment from the stages.
_COUNTED = (Outcome.FAIL, Outcome.ERROR, Outcome.SKIP, Outcome.UNDECIDED)
_REMOVED = (Outcome.FAIL, Outcome.ERROR)
#: Modified z-scores on a logarithmic scale (Iglewicz and Hoaglin 1993): that of an outlier, and that of one MAD.
FAR, _MAD = 3.5, 0.6745
#: The minimum ratio of an outlier to the median, or of the median to it. If most values are alike, the spread is small
#: and the z-score alone would flag small differences.
TIMES = 1.5
#: The minimum number of values for outliers.
_FEWEST = 8


class Entry(msgspec.Struct, frozen=True):
    """An environment of a report.

    Attributes:
        number: counts from 0 in the order of names.
        environment: its name, source and class.
        origin: where it comes from.
        added: when it was added.
        settings: the number of the settings of its verdict.
        report: the last report on its present source.
    """

    number: int
    environment: Environment
    origin: dict[str, Any]
    added: str
    settings: int | None
    report: SubjectReport | None

    @property
    def name(self) -> str:
        return self.environment.name

    @property
    def verdict(self) -> str:
        return NONE if self.report is None else self.report.verdict.value

    @property
    def outcome(self) -> str:
        """The verdict, with the undecided ones apart (:class:`envcraft.model.verdict.Outcome`)."""
        return NONE if self.report is None else self.report.outcome.value

    @property
    def undecided(self) -> list[str]:
        """The checks that left their questions open."""
        return [] if self.report is None else self.report.undecided

    @property
    def codes(self) -> list[str]:
        """The distinct codes of its findings, sorted."""
        checks = () if self.report is None else self.report.checks
        return sorted({finding.code for check in checks for finding in check.findings})


def entries(store: Store) -> Iterator[Entry]:
    """Yield every environment with its report.

    Raises:
        CorpusDamaged: a stored report cannot be decoded.
    """
    for number, row in enumerate(verdicts.last(store)):
        report = None if row.report is None else decode(row.report)
        yield Entry(number, row.environment, row.origin, row.added, row.number, report)


class Stage(msgspec.Struct, frozen=True):
    """A check as a filter of the environments that passed all checks before it.

    Attributes:
        name: of the check.
        entered: the number of environments that passed the earlier checks.
        failed: the number that this check fails.
        unjudged: the number that this check could not judge; they do not reach the next check.
        skipped: the number to which this check does not apply; they reach the next check.
        undecided: the number whose question this check left open; they reach the next check.
    """

    name: str
    entered: int
    failed: int
    unjudged: int
    skipped: int
    undecided: int

    @property
    def left(self) -> int:
        return self.entered - self.failed - self.unjudged

    @property
    def rate(self) -> Proportion:
        """The share that passes of the environments that the check judged."""
        passed = self.left - self.skipped - self.undecided
        return Proportion(passed, passed + self.failed)


class CheckRow(msgspec.Struct):
    """One check over all environments: the counts by outcome and the total seconds."""

    name: str
    outcomes: Counter[str]
    seconds: float = 0.0

    @property
    def judged(self) -> int:
        return self.outcomes[Outcome.PASS] + self.outcomes[Outcome.FAIL]

    @property
    def rate(self) -> Proportion:
        """The share that passes of the environments that the check judged."""
        return Proportion(self.outcomes[Outcome.PASS], self.judged)


class CodeRow(msgspec.Struct):
    """One code: the number of environments that have it, and the number of its findings."""

    code: str
    check: str
    severity: Severity
    environments: int = 0
    findings: int = 0


class Attempt(msgspec.Struct):
    """The environments from the attempt of this number, which is ``attempt`` in their origin."""

    number: int
    judged: int = 0
    passed: int = 0
    undecided: int = 0

    @property
    def rate(self) -> Proportion:
        return Proportion(self.passed, self.judged)


class Measure(msgspec.Struct):
    """A positive number of each judged environment.

    Attributes:
        name: of the measure.
        unit: of the values.
        low: whether low outliers are of interest.
        numbers: the numbers of the environments.
        values: their values, in the same order.
    """

    name: str
    unit: str
    low: bool = True
    numbers: array[int] = msgspec.field(default_factory=lambda: array("l"))
    values: array[float] = msgspec.field(default_factory=lambda: array("d"))

    def take(self, number: int, value: float) -> None:
        if value > 0:
            self.numbers.append(number)
            self.values.append(value)

    def quantiles(self, *shares: float) -> list[float]:
        """Return the quantiles for shares from 0 to 1, or an empty list if there are no values."""
        return [float(value) for value in np.quantile(self.values, shares)] if self.values else []

    def highest(self, count: int) -> list[tuple[int, float]]:
        """Return the numbers and values of the `count` environments with the highest values."""
        order = np.argsort(-np.asarray(self.values), kind="stable")[:count]
        return [(self.numbers[place], self.values[place]) for place in order]


class Outlier(msgspec.Struct, frozen=True):
    """An environment whose value is far from the median.

    Attributes:
        number: of the environment.
        measure: the name of the measure.
        value: of the environment.
        times: the ratio of the value to the median.
        score: the modified z-score.
    """

    number: int
    measure: str
    value: float
    times: float
    score: float


class Survey:
    """All counts of a report.

    Args:
        order: the names of the checks in the order in which they run.

    Attributes:
        names: of the environments, by number.
        outcomes: the number of environments by outcome; :data:`NONE` counts those without a verdict.
        settings: the number of verdicts by the number of their settings.
        steps: the total of all verdicts.
        seconds: the total of all verdicts.
        measures: the measures with their values.
    """

    def __init__(self, order: Iterable[str]) -> None:
        self.names: list[str] = []
        self.outcomes: Counter[str] = Counter()
        self.settings: Counter[int] = Counter()
        self.steps = 0
        self.seconds = 0.0
        self.measures = [
            # A low value is typical of an environment that cannot be imported.
            Measure("seconds", "s", low=False),
            Measure("steps", ""),
            Measure("steps per second", "/s"),
            Measure("lines of source", ""),
        ]
        self._order = list(order)
        self._checks: dict[str, CheckRow] = {}
        self._codes: dict[str, CodeRow] = {}
        self._attempts: dict[int, Attempt] = {}
        #: The number of environments by the outcomes of their checks, from which the stages are computed.
        self._ways: Counter[tuple[tuple[str, Outcome], ...]] = Counter()

    def take(self, entry: Entry, lines: int) -> None:
        """Count an environment whose source has this number of lines."""
        self.names.append(entry.name)
        self.outcomes[entry.outcome] += 1
        report = entry.report
        if report is None:
            return
        if entry.settings is not None:
            self.settings[entry.settings] += 1
        self.steps += report.steps
        self.seconds += report.seconds
        speed = report.steps / report.seconds if report.seconds > 0 else 0.0
        for measure, value in zip(self.measures, (report.seconds, report.steps, speed, lines), strict=True):
            measure.take(entry.number, value)
        self._take_checks(report)
        self._take_attempt(entry.origin.get("attempt"), report)

    def _take_checks(self, report: SubjectReport) -> None:
        seen = set()
        self._ways[tuple((check.check, check.outcome) for check in report.checks)] += 1
        for check in report.checks:
            row = self._checks.setdefault(check.check, CheckRow(check.check, Counter()))
            row.outcomes[check.outcome.value] += 1
            row.seconds += check.seconds
            for finding in check.findings:
                known = CodeRow(finding.code, check.check, finding.severity)
                code = self._codes.setdefault(finding.code, known)
                code.findings += 1
                code.environments += finding.code not in seen
                seen.add(finding.code)

    def _take_attempt(self, number: Any, report: SubjectReport) -> None:
        if isinstance(number, int) and not isinstance(number, bool):
            attempt = self._attempts.setdefault(number, Attempt(number))
            attempt.judged += report.verdict in (Verdict.PASS, Verdict.FAIL)
            attempt.passed += report.outcome is Outcome.PASS
            attempt.undecided += report.outcome is Outcome.UNDECIDED

    @property
    def verdicts(self) -> dict[str, int]:
        """The number of environments by verdict, in which an undecided environment is a pass."""
        counts = self.outcomes.copy()
        counts[Outcome.PASS] += counts.pop(Outcome.UNDECIDED, 0)
        return {verdict: count for verdict, count in counts.items() if count}

    @property
    def total(self) -> int:
        return len(self.names)

    @property
    def judged(self) -> int:
        """Environments with a verdict."""
        return self.total - self.outcomes[NONE]

    @property
    def rate(self) -> Proportion:
        """The share that passes of the environments that pass, fail or are undecided."""
        passed = self.outcomes[Outcome.PASS]
        return Proportion(passed, passed + self.outcomes[Outcome.FAIL] + self.outcomes[Outcome.UNDECIDED])

    def checks(self) -> list[CheckRow]:
        """Return the rows in the order in which the checks run. Checks that are not installed are last."""
        last = len(self._order)
        place = {name: number for number, name in enumerate(self._order)}
        return sorted(self._checks.values(), key=lambda row: place.get(row.name, last))

    def stages(self) -> list[Stage]:
        """Return the checks as successive filters. A check that did not run counts as one that could not judge."""
        stages, left, ways = [], self.judged, [(dict(way), count) for way, count in self._ways.items()]
        for row in self.checks():
            met: Counter[Outcome] = Counter()
            for way, count in ways:
                met[way.get(row.name, Outcome.ERROR)] += count
            stages.append(Stage(row.name, left, *(met[outcome] for outcome in _COUNTED)))
            left = stages[-1].left
            ways = [(way, count) for way, count in ways if way.get(row.name, Outcome.ERROR) not in _REMOVED]
        return stages

    def codes(self) -> list[CodeRow]:
        """Return the rows by falling number of environments."""
        return sorted(self._codes.values(), key=lambda row: (-row.environments, row.code))

    def attempts(self) -> list[Attempt]:
        return sorted(self._attempts.values(), key=lambda attempt: attempt.number)

    def outliers(self) -> list[Outlier]:
        """Return the outliers of all measures by falling distance."""
        every = [outlier for measure in self.measures for outlier in outliers(measure)]
        return sorted(every, key=lambda outlier: (-abs(outlier.score), outlier.number))


def outliers(measure: Measure) -> Iterator[Outlier]:
    """Yield the outliers of a measure.

    An outlier's modified z-score on a logarithmic scale is above :data:`FAR`, and its ratio to the median is above
    :data:`TIMES` or below the inverse. There are none if there are few values, or if more than half of them are equal,
    because the spread is then zero.
    """
    if len(measure.values) < _FEWEST:
        return
    logs = np.log10(np.asarray(measure.values))
    middle = float(np.median(logs))
    away = np.abs(logs - middle)
    spread = float(np.median(away))
    if spread <= 0:
        return
    for place in np.flatnonzero((_MAD * away / spread > FAR) & (away > log10(TIMES))):
        value = measure.values[place]
        score = _MAD * (log10(value) - middle) / spread
        if score < 0 and not measure.low:
            continue
        yield Outlier(measure.numbers[place], measure.name, value, value / 10**middle, score)
