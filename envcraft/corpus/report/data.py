"""What a report says, counted in one pass over the environments in the order of their names.

Kept are a few numbers for each environment; reports and sources are read one by one and let go of.
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
from envcraft.model.verdict import Severity, SubjectReport, Verdict

#: What has no verdict on its present source.
NONE = "none"
#: An outlier's modified z-score on a logarithmic scale (Iglewicz and Hoaglin 1993), and 0.6745 is that of one MAD.
FAR, _MAD = 3.5, 0.6745
#: Nor is one that is not so many times the median, or its inverse: where most are alike, there is next to no spread.
TIMES = 1.5
#: With fewer values, nothing is called an outlier.
_FEWEST = 8


class Entry(msgspec.Struct, frozen=True):
    """An environment; `number` counts from 0 in the order of names. `report` is the last one on its present source."""

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
    def codes(self) -> list[str]:
        """Each code once, sorted."""
        checks = () if self.report is None else self.report.checks
        return sorted({finding.code for check in checks for finding in check.findings})


def entries(store: Store) -> Iterator[Entry]:
    """Every environment with its report. Raises CorpusDamaged."""
    for number, row in enumerate(verdicts.last(store)):
        report = None if row.report is None else decode(row.report)
        yield Entry(number, row.environment, row.origin, row.added, row.number, report)


class Stage(msgspec.Struct, frozen=True):
    """A check as a filter: of those that had passed all checks before it. Those that it did not judge (`unjudged`) go
    no further; those that it had nothing to say of (`skipped`) do.
    """

    name: str
    entered: int
    failed: int
    unjudged: int
    skipped: int

    @property
    def left(self) -> int:
        return self.entered - self.failed - self.unjudged

    @property
    def rate(self) -> Proportion:
        """Of those that it judged."""
        passed = self.left - self.skipped
        return Proportion(passed, passed + self.failed)


class CheckRow(msgspec.Struct):
    """One check over all environments: the counts by verdict, and the seconds in total."""

    name: str
    verdicts: Counter[str]
    seconds: float = 0.0

    @property
    def judged(self) -> int:
        return self.verdicts[Verdict.PASS] + self.verdicts[Verdict.FAIL]

    @property
    def rate(self) -> Proportion:
        """Of those that it judged."""
        return Proportion(self.verdicts[Verdict.PASS], self.judged)


class CodeRow(msgspec.Struct):
    """One code: in how many environments, how many times."""

    code: str
    check: str
    severity: Severity
    environments: int = 0
    findings: int = 0


class Attempt(msgspec.Struct):
    """The environments that a repair's n-th attempt gave, by their origin's ``attempt``."""

    number: int
    judged: int = 0
    passed: int = 0

    @property
    def rate(self) -> Proportion:
        return Proportion(self.passed, self.judged)


class Measure(msgspec.Struct):
    """A number that each judged environment has, where it is above 0. `numbers` are those of the environments; `low` is
    whether one that is low is anything to look at.
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
        """Values below which these shares of the environments lie; none where there is none."""
        return [float(value) for value in np.quantile(self.values, shares)] if self.values else []

    def highest(self, count: int) -> list[tuple[int, float]]:
        """Environments with the highest values, by number."""
        order = np.argsort(-np.asarray(self.values), kind="stable")[:count]
        return [(self.numbers[place], self.values[place]) for place in order]


class Outlier(msgspec.Struct, frozen=True):
    """An environment whose value lies far from the median; `times` is their ratio, `score` the modified z-score."""

    number: int
    measure: str
    value: float
    times: float
    score: float


class Survey:
    """All that the report counts; `order` are the names of the checks as they run.

    Attributes:
        names: of the environments, by number.
        verdicts: counts by verdict, and of those without one.
        settings: how many verdicts were given under which settings.
    """

    def __init__(self, order: Iterable[str]) -> None:
        self.names: list[str] = []
        self.verdicts: Counter[str] = Counter()
        self.settings: Counter[int] = Counter()
        self.steps = 0
        self.seconds = 0.0
        self.measures = [
            # Little time is what an environment takes that cannot even be imported.
            Measure("seconds", "s", low=False),
            Measure("steps", ""),
            Measure("steps per second", "/s"),
            Measure("lines of source", ""),
        ]
        self._order = list(order)
        self._checks: dict[str, CheckRow] = {}
        self._codes: dict[str, CodeRow] = {}
        self._attempts: dict[int, Attempt] = {}
        #: The numbers of environments by the verdicts of their checks; the cascade is computed from them.
        self._ways: Counter[tuple[tuple[str, Verdict], ...]] = Counter()

    def take(self, entry: Entry, lines: int) -> None:
        """Count an environment whose source has so many lines."""
        self.names.append(entry.name)
        self.verdicts[entry.verdict] += 1
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
        self._ways[tuple((check.check, check.verdict) for check in report.checks)] += 1
        for check in report.checks:
            row = self._checks.setdefault(check.check, CheckRow(check.check, Counter()))
            row.verdicts[check.verdict.value] += 1
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
            attempt.passed += report.verdict is Verdict.PASS

    @property
    def total(self) -> int:
        return len(self.names)

    @property
    def judged(self) -> int:
        """Environments with a verdict."""
        return self.total - self.verdicts[NONE]

    @property
    def rate(self) -> Proportion:
        """How many pass, of those that pass or fail."""
        passed = self.verdicts[Verdict.PASS]
        return Proportion(passed, passed + self.verdicts[Verdict.FAIL])

    def checks(self) -> list[CheckRow]:
        """In the order in which they run; those that nobody has here at the end."""
        last = len(self._order)
        place = {name: number for number, name in enumerate(self._order)}
        return sorted(self._checks.values(), key=lambda row: place.get(row.name, last))

    def stages(self) -> list[Stage]:
        """The checks as filters, one after the other. One that did not run is one that did not judge."""
        found, left, ways = [], self.judged, [(dict(way), count) for way, count in self._ways.items()]
        for row in self.checks():
            met: Counter[Verdict] = Counter()
            for way, count in ways:
                met[way.get(row.name, Verdict.ERROR)] += count
            found.append(Stage(row.name, left, met[Verdict.FAIL], met[Verdict.ERROR], met[Verdict.SKIP]))
            left = found[-1].left
            ways = [(way, count) for way, count in ways if way.get(row.name) in (Verdict.PASS, Verdict.SKIP)]
        return found

    def codes(self) -> list[CodeRow]:
        """The one in most environments first."""
        return sorted(self._codes.values(), key=lambda row: (-row.environments, row.code))

    def attempts(self) -> list[Attempt]:
        return sorted(self._attempts.values(), key=lambda attempt: attempt.number)

    def outliers(self) -> list[Outlier]:
        """The farthest first."""
        found = [outlier for measure in self.measures for outlier in outliers(measure)]
        return sorted(found, key=lambda outlier: (-abs(outlier.score), outlier.number))


def outliers(measure: Measure) -> Iterator[Outlier]:
    """Values more than `FAR` from the median, in modified z-scores of their logarithms, and `TIMES` as high or as low.
    None where there are few values, or more than half of them are the same, so that there is no spread to measure by.
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
