"""The card of a data set: metadata for the Hub in YAML, and a description in Markdown.

Text from a corpus is escaped, so that it cannot be markup.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from envcraft.corpus.deduplication import Duplicates
from envcraft.corpus.export.exporter import Exported
from envcraft.corpus.export.shards import SPLITS
from envcraft.corpus.report.data import NONE, Survey, entries
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
from envcraft.judging.statistics import Proportion
from envcraft.text import one_line
from envcraft.version import __version__

_TEMPLATE = Path(__file__).parent / "skeleton" / "dataset.md.txt"
#: The Hub's size categories, each with the number of rows below which it applies.
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
#: The Hub's identifiers of licences. Any other licence is "other", with its name in a separate field.
_HUB = re.compile(
    r"mit|isc|zlib|wtfpl|unlicense|apache-2\.0|bsd-[23]-clause|mpl-2\.0|[al]?gpl-3\.0|gpl-2\.0|lgpl-2\.1|"
    r"cc0-1\.0|cc-by(-nc)?(-sa|-nd)?-4\.0|odbl|odc-by"
)


class Licences:
    """Counts the licences of the exported sources.

    The key ``licence`` or ``license`` of an environment's origin states its licence.

    Args:
        default: the user's licence for environments whose origin states none.
    """

    def __init__(self, default: str | None) -> None:
        self.default = one_line(default) if default and default.strip() else None
        self.counts: Counter[str | None] = Counter()

    def add(self, origin: dict[str, Any]) -> str | None:
        """Count an environment's licence.

        Args:
            origin: of the environment.

        Returns:
            The licence, or None if there is none.

        Raises:
            UsageError: the origin's licence differs from the user's.
        """
        stated = origin.get("licence") or origin.get("license")
        own = one_line(stated) if isinstance(stated, str) and stated.strip() else None
        if own is not None and self.default is not None and own.lower() != self.default.lower():
            raise UsageError(
                f"--licence is {self.default}, but the corpus states {own} for some sources: omit the option"
            )
        self.counts[self.default or own] += 1
        return self.default or own

    @property
    def one(self) -> str | None:
        """The licence of all sources, or None if they do not share one."""
        stated = sorted(name for name in self.counts if name is not None)
        same = len({name.lower() for name in stated}) == 1 and None not in self.counts
        return stated[0] if same else None


class Contents:
    """Counts of what was written to a data set.

    Attributes:
        title: of the data set.
        duplicates: the copies in the corpus.
        licences: of the sources.
        rows: the number of rows of each split.
        groups: the groups in each split.
        settings: the number of environments by the settings of their verdicts, which are all None without a verdict.
        passed: the number of environments that passed.
        undecoded: the number of environments that were skipped because their source is not UTF-8.
    """

    def __init__(self, title: str, duplicates: Duplicates, licences: Licences) -> None:
        self.title, self.duplicates, self.licences = title, duplicates, licences
        self.rows: Counter[str] = Counter()
        self.groups: dict[str, set[int]] = {name: set() for name in SPLITS}
        self.settings: Counter[tuple[Any, ...]] = Counter()
        self.passed = self.failed = self.undecided = self.undecoded = 0

    def add(self, environment: Exported, group: int, split: str) -> None:
        """Count an environment.

        Args:
            environment: the environment.
            group: the number of its group.
            split: the name of its split.

        Raises:
            UsageError: its licence differs from the user's.
        """
        self.licences.add(environment.origin)
        self.rows[split] += 1
        self.groups[split].add(group)
        undecided = bool(environment.undecided)
        self.undecided += undecided
        self.passed += environment.verdict == "pass" and not undecided
        self.failed += environment.verdict == "fail"
        self.settings[
            environment.contract,
            environment.contract_sha256,
            environment.rules,
            environment.budget,
            None if environment.seed is None else str(environment.seed),
            environment.driver,
            environment.image,
        ] += 1

    @property
    def shares(self) -> str:
        """A phrase with the number of rows of each split."""
        return ", ".join(f"{name} {self.rows[name]:,}" for name in SPLITS if self.rows[name])


def card(store: Store, contents: Contents, described: Iterable[tuple[str, str, str]]) -> str:
    """Build the card.

    Args:
        store: the corpus.
        contents: the counts of the data set.
        described: the name, type and description of each column.

    Raises:
        CorpusDamaged: a stored report cannot be decoded.
    """
    from envcraft.judging.selection import all_checks

    checks = all_checks()
    survey = Survey(check.name for check in checks)
    for entry in entries(store):
        # The card does not use the number of lines.
        survey.take(entry, 0)
    rules = {rule.code: rule.name for check in checks for rule in check.rules}
    words = {
        "FRONT": _front(contents),
        "TITLE": text(contents.title),
        "COUNT": f"{contents.rows.total():,}",
        "PASSED": f"{contents.passed:,}",
        "FAILED": f"{contents.failed:,}",
        "UNDECIDED": f"{contents.undecided:,}",
        "SPLITS": table(
            ("split", "environments", "groups"),
            [(name, contents.rows[name], len(contents.groups[name])) for name in SPLITS if contents.rows[name]],
        ),
        "COLUMNS": columns(described),
        "JUDGED": _left_out(contents),
        "LICENCE": _licence(contents.licences),
        "VERSION": __version__,
        "SETTINGS": table(
            ("contract", "contract digest", "rules", "budget", "seed", "sandbox", "image or libraries", "environments"),
            [(*row, count) for row, count in sorted(contents.settings.items(), key=lambda item: (-item[1], str(item)))],
        ),
        "YIELDS": _yields(survey),
        "CHECKS": _checks(survey),
        "CODES": _codes(survey, rules),
        "TOTAL": f"{contents.duplicates.environments:,}",
        "COPIES": _copies(contents.duplicates),
    }
    return re.sub(r"@([A-Z]+)@", lambda match: words[match[1]], _TEMPLATE.read_text("utf-8"))


def _front(contents: Contents) -> str:
    """Build the metadata in YAML. Its strings are JSON strings, which YAML accepts."""
    count = contents.rows.total()
    lines = [f"pretty_name: {json.dumps(one_line(contents.title))}"]
    if (licence := contents.licences.one) is not None:
        lines += licence_lines(licence)
    lines += [
        "task_categories:",
        "- reinforcement-learning",
        "tags:",
        *(f"- {tag}" for tag in ("reinforcement-learning-environments", "gymnasium", "code", "envcraft")),
        "size_categories:",
        f"- {size_category(count)}",
        "configs:",
        "- config_name: default",
        "  data_files:",
    ]
    for split in SPLITS:
        if contents.rows[split]:
            lines += [f"  - split: {split}", f"    path: data/{split}-*.parquet"]
    return "\n".join(lines)


def licence_lines(licence: str) -> list[str]:
    """Return the lines of the Hub's metadata for a licence."""
    if _HUB.fullmatch(licence.lower()):
        return [f"license: {licence.lower()}"]
    return ["license: other", f"license_name: {json.dumps(licence)}"]


def size_category(count: int) -> str:
    """Return the Hub's size category for a number of rows."""
    return next((name for limit, name in _SIZES if count < limit), "10M<n<100M")


def _left_out(contents: Contents) -> str:
    words = "The columns of the verdict are empty if there is no verdict on the present source."
    if contents.undecoded:
        words += (
            f" The number of environments that were skipped because their source is not UTF-8: {contents.undecoded:,}."
        )
    return words


def _licence(licences: Licences) -> str:
    if licences.one is not None:
        return f"The corpus, or its exporter, states that the sources are licensed under {text(licences.one)}."
    if set(licences.counts) == {None}:
        return "No licence is stated for the sources; it is that of their authors."
    rows = sorted((name or "none", count) for name, count in licences.counts.items())
    counts = ", ".join(f"{text(name)} ({count:,})" for name, count in rows)
    return (
        f"The sources do not share one licence. The stated licences are: {counts}. The column `origin` states the "
        "licence of each environment."
    )


def _yields(survey: Survey) -> str:
    counts = {name: survey.outcomes[name] for name in ("pass", "fail", "undecided", "error", NONE)}
    return (
        f"Of the {survey.total:,} environments in the corpus, {counts['pass']:,} passed, {counts['fail']:,} failed, "
        f"{counts['undecided']:,} are undecided, {counts['error']:,} could not be judged and {counts[NONE]:,} have no "
        f"verdict. Of those that passed, failed or are undecided, {_rate(survey.rate)} passed (interval "
        f"{_interval(survey.rate)})."
    )


def _checks(survey: Survey) -> str:
    rows = []
    for row in survey.checks():
        passed, undecided, skipped = (row.outcomes[outcome] for outcome in ("pass", "undecided", "skip"))
        rows.append((row.name, row.judged, passed, _rate(row.rate), _interval(row.rate), undecided, skipped))
    return table(("check", "judged", "passed", "pass rate", "interval", "undecided", "skipped"), rows)


def _codes(survey: Survey, rules: dict[str, str]) -> str:
    rows = []
    for row in survey.codes():
        share = Proportion(row.environments, survey.judged)
        name = rules.get(row.code, "")
        rows.append((row.code, name, row.severity.value, row.environments, _rate(share), _interval(share)))
    if not rows:
        return "There are no findings."
    return table(("code", "rule", "severity", "environments", "share of those with a verdict", "interval"), rows)


def _copies(duplicates: Duplicates) -> str:
    rows = []
    for name, layer in duplicates.layers.items():
        rows.append((name, layer.keyed, len(layer.clusters), sum(len(members) - 1 for members in layer.clusters)))
    extra = sum(len(cluster.members) - 1 for cluster in duplicates.clusters)
    rows.append(("all layers", duplicates.environments, len(duplicates.clusters), extra))
    return table(("layer", "compared", "clusters", "copies to remove"), rows)


def _rate(rate: Proportion) -> str:
    return f"{rate.estimate:.1%}" if rate.n else "none"


def _interval(rate: Proportion) -> str:
    return f"{rate.low:.1%} to {rate.high:.1%}" if rate.n else "none"


def _column(column: tuple[str, str, str]) -> str:
    name, kind, what = column
    return f"| `{name}` | `{kind}` | {what} |"


def columns(described: Iterable[tuple[str, str, str]]) -> str:
    """Write a table of columns in Markdown, each with its name, type and description."""
    return "\n".join(["| column | type | contents |", "|---|---|---|", *map(_column, described)])


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table in Markdown; values are escaped."""
    lines = [_line(head), "|" + "---|" * len(head)]
    return "\n".join([*lines, *(_line([_cell(value) for value in row]) for row in rows)])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:,}" if isinstance(value, int) else text(value)


def text(value: Any) -> str:
    """Escape a value as text in Markdown."""
    return re.sub(r"([\\`*_{}\[\]<>#|~&])", r"\\\1", one_line(value))
