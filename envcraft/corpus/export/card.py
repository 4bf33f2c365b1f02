"""The card of a data set: YAML for the Hub, and what people want to know, in Markdown.

Text from a corpus is escaped, so that it is never markup.
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
#: As the Hub sorts data sets by size: below so many rows, such a category.
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M"))
#: Licences by the names that the Hub knows; another one is "other", and named beside it.
_HUB = re.compile(
    r"mit|isc|zlib|wtfpl|unlicense|apache-2\.0|bsd-[23]-clause|mpl-2\.0|[al]?gpl-3\.0|gpl-2\.0|lgpl-2\.1|"
    r"cc0-1\.0|cc-by(-nc)?(-sa|-nd)?-4\.0|odbl|odc-by"
)


class Licences:
    """Under what the exported sources are licensed: what the corpus says of each, else what the user says of all.

    An environment's origin says it as ``licence`` or ``license``.
    """

    def __init__(self, said: str | None) -> None:
        self.said = one_line(said) if said and said.strip() else None
        self.found: Counter[str | None] = Counter()

    def add(self, origin: dict[str, Any]) -> str | None:
        """Count an environment's, and give it. Raises UsageError where the user says otherwise."""
        told = origin.get("licence") or origin.get("license")
        own = one_line(told) if isinstance(told, str) and told.strip() else None
        if own is not None and self.said is not None and own.lower() != self.said.lower():
            raise UsageError(f"--licence {self.said}, but the corpus says {own} of some: leave it out")
        self.found[self.said or own] += 1
        return self.said or own

    @property
    def one(self) -> str | None:
        """The licence of all; None where there is not one that all are under."""
        stated = sorted(name for name in self.found if name is not None)
        same = len({name.lower() for name in stated}) == 1 and None not in self.found
        return stated[0] if same else None


class Contents:
    """What was written to a data set, counted.

    Attributes:
        rows: of each split.
        groups: the groups in each split.
        settings: environments by the settings of their verdicts, all empty where there is none.
        undecoded: environments that were left out because their source is no UTF-8.
    """

    def __init__(self, title: str, duplicates: Duplicates, licences: Licences) -> None:
        self.title, self.duplicates, self.licences = title, duplicates, licences
        self.rows: Counter[str] = Counter()
        self.groups: dict[str, set[int]] = {name: set() for name in SPLITS}
        self.settings: Counter[tuple[Any, ...]] = Counter()
        self.passed = self.undecoded = 0

    def add(self, environment: Exported, group: int, split: str) -> None:
        """Count an environment. Raises UsageError where its licence is not what the user says."""
        self.licences.add(environment.origin)
        self.rows[split] += 1
        self.groups[split].add(group)
        self.passed += environment.verdict == "pass"
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
        """In words, how many are in each split."""
        return ", ".join(f"{name} {self.rows[name]:,}" for name in SPLITS if self.rows[name])


def card(store: Store, contents: Contents, described: Iterable[tuple[str, str, str]]) -> str:
    """The whole card. Raises CorpusDamaged."""
    from envcraft.judging.selection import all_checks

    checks = all_checks()
    survey = Survey(check.name for check in checks)
    for entry in entries(store):
        # Nothing here is about how long sources are.
        survey.take(entry, 0)
    rules = {rule.code: rule.name for check in checks for rule in check.rules}
    words = {
        "FRONT": _front(contents),
        "TITLE": text(contents.title),
        "COUNT": f"{contents.rows.total():,}",
        "PASSED": f"{contents.passed:,}",
        "SPLITS": table(
            ("split", "environments", "groups"),
            [(name, contents.rows[name], len(contents.groups[name])) for name in SPLITS if contents.rows[name]],
        ),
        "COLUMNS": columns(described),
        "JUDGED": _left_out(contents),
        "LICENCE": _licence(contents.licences),
        "VERSION": __version__,
        "SETTINGS": table(
            ("contract", "its digest", "rules", "budget", "seed", "sandbox", "image or libraries", "environments"),
            [(*row, count) for row, count in sorted(contents.settings.items(), key=lambda item: (-item[1], str(item)))],
        ),
        "YIELDS": _yields(survey),
        "CHECKS": _checks(survey),
        "CODES": _codes(survey, rules),
        "TOTAL": f"{contents.duplicates.environments:,}",
        "COPIES": _copies(contents.duplicates),
    }
    return re.sub(r"@([A-Z]+)@", lambda found: words[found[1]], _TEMPLATE.read_text("utf-8"))


def _front(contents: Contents) -> str:
    """YAML for the Hub, whose strings are JSON's."""
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
    """A licence in the metadata of the Hub, by the name that this knows, if it does."""
    if _HUB.fullmatch(licence.lower()):
        return [f"license: {licence.lower()}"]
    return ["license: other", f"license_name: {json.dumps(licence)}"]


def size_category(count: int) -> str:
    """The size of a data set of so many rows, as the Hub names it."""
    return next((name for limit, name in _SIZES if count < limit), "10M<n<100M")


def _left_out(contents: Contents) -> str:
    told = "Columns about the verdict are empty where there is none on the source as it is."
    if contents.undecoded:
        told += f" Left out, since their sources are no UTF-8: {contents.undecoded:,}."
    return told


def _licence(licences: Licences) -> str:
    if licences.one is not None:
        return f"The sources are licensed under {text(licences.one)}, as the corpus or whoever exported it says."
    if set(licences.found) == {None}:
        return "None is stated for the sources: whoever made them decides."
    told = sorted((name or "none", count) for name, count in licences.found.items())
    counts = ", ".join(f"{text(name)} ({count:,})" for name, count in told)
    return f"There is not one for all. Stated are: {counts}. The column `origin` says it of each environment."


def _yields(survey: Survey) -> str:
    counts = {name: survey.verdicts[name] for name in ("pass", "fail", "error", NONE)}
    return (
        f"Of the {survey.total:,} environments in the corpus that this was made from, {counts['pass']:,} passed, "
        f"{counts['fail']:,} failed, {counts['error']:,} could not be judged and {counts[NONE]:,} were not. Of those "
        f"that passed or failed, {_rate(survey.rate)} passed (interval {_interval(survey.rate)})."
    )


def _checks(survey: Survey) -> str:
    rows = [
        (row.name, row.judged, row.verdicts["pass"], _rate(row.rate), _interval(row.rate), row.verdicts["skip"])
        for row in survey.checks()
    ]
    return table(("check", "judged", "passed", "pass rate", "interval", "had nothing to say"), rows)


def _codes(survey: Survey, rules: dict[str, str]) -> str:
    rows = []
    for row in survey.codes():
        share = Proportion(row.environments, survey.judged)
        name = rules.get(row.code, "")
        rows.append((row.code, name, row.severity.value, row.environments, _rate(share), _interval(share)))
    if not rows:
        return "No check found anything."
    return table(("code", "rule", "severity", "environments", "share of those with a verdict", "interval"), rows)


def _copies(duplicates: Duplicates) -> str:
    rows = []
    for name, layer in duplicates.layers.items():
        rows.append((name, layer.keyed, len(layer.clusters), sum(len(members) - 1 for members in layer.clusters)))
    extra = sum(len(cluster.members) - 1 for cluster in duplicates.clusters)
    rows.append(("all layers", duplicates.environments, len(duplicates.clusters), extra))
    return table(("layer", "compared", "clusters", "environments beside the best of theirs"), rows)


def _rate(rate: Proportion) -> str:
    return f"{rate.estimate:.1%}" if rate.n else "none"


def _interval(rate: Proportion) -> str:
    return f"{rate.low:.1%} to {rate.high:.1%}" if rate.n else "none"


def _column(column: tuple[str, str, str]) -> str:
    name, kind, what = column
    return f"| `{name}` | `{kind}` | {what} |"


def columns(told: Iterable[tuple[str, str, str]]) -> str:
    """A table of columns, each with its type and what it has, in Markdown."""
    return "\n".join(["| column | type | what it has |", "|---|---|---|", *map(_column, told)])


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table in Markdown; values are escaped."""
    lines = [_line(head), "|" + "---|" * len(head)]
    return "\n".join([*lines, *(_line([_cell(value) for value in row]) for row in rows)])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:,}" if isinstance(value, int) else text(value)


def text(value: Any) -> str:
    """Text of a corpus, so that Markdown takes it for nothing else."""
    return re.sub(r"([\\`*_{}\[\]<>#|~&])", r"\\\1", one_line(value))
