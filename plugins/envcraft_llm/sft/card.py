"""The card of the data: what is in it, where it comes from, and how many concepts came how far."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

from envcraft import __version__
from envcraft.corpus.export.card import columns, licence_lines, size_category, table, text
from envcraft.corpus.export.shards import SPLITS
from envcraft.corpus.history import History
from envcraft.corpus.store import Store
from envcraft.reports import one_line
from envcraft_llm.pipeline.options import offered_stages, running
from envcraft_llm.pipeline.tables import rows, stage_table, yield_lines
from envcraft_llm.templates import prompt

from .rows import KINDS, PROVENANCE

_TEMPLATE = Path(__file__).parent / "card.md.txt"
#: The stages whose prompts the requests in the rows are worded by.
_ASKED = ("code", "repair")


class Contents:
    """What was written, counted.

    Attributes:
        rows: of each kind, by split.
        clusters: of each kind, by split, the numbers of the clusters.
        labels: the attempts that passed, and those that did not.
        models: the attempts by the model that wrote them and the digest of the prompt that it was asked by.
        licences: the attempts by their licences.
        gates: the attempts by the settings of their verdicts.
        unsettled: attempts that are left out, since nobody has judged them to the end.
        licence: of all rows; None where there is not one.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.rows: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        self.clusters: dict[str, dict[str, set[int]]] = {kind: {name: set() for name in SPLITS} for kind in KINDS}
        self.labels: Counter[bool] = Counter()
        self.models: Counter[tuple[str | None, str | None]] = Counter()
        self.licences: Counter[str] = Counter()
        self.gates: Counter[tuple[Any, ...]] = Counter()
        self.unsettled = 0
        self.licence: str | None = None

    def add(self, kind: str, split: str, row: dict[str, Any]) -> None:
        self.rows[kind][split] += 1
        self.clusters[kind][split].add(row["cluster"])
        if kind != "unpaired":
            return
        # Every attempt is in one of these rows.
        self.labels[row["label"]] += 1
        self.models[row["model"], row["prompt_sha256"]] += 1
        self.licences[row["licence"]] += 1
        gate = (row[name] for name in ("rules", "contract", "contract_sha256", "budget", "sandbox", "image"))
        self.gates[*gate, None if row["seed"] is None else str(row["seed"])] += 1

    @property
    def kinds(self) -> list[str]:
        """Those that have rows."""
        return [kind for kind in KINDS if self.rows[kind]]

    @property
    def total(self) -> int:
        return sum(found.total() for found in self.rows.values())


def card(store: Store, contents: Contents) -> str:
    """The whole card. Raises CorpusDamaged."""
    history = History(store)
    concepts = history.concepts()
    stages = running(offered_stages(), history.counts(concepts))
    words = {
        "FRONT": _front(contents),
        "TITLE": text(contents.title),
        "TOTAL": f"{contents.total:,}",
        "FIRST": contents.kinds[0],
        "KINDS": table(
            ("kind", "rows", "what it is"),
            [(kind, contents.rows[kind].total(), KINDS[kind][0]) for kind in contents.kinds],
        ),
        "PASSED": f"{contents.labels[True]:,}",
        "FAILED": f"{contents.labels[False]:,}",
        "UNSETTLED": f"{contents.unsettled:,}",
        "SPLITS": table(("kind", "split", "rows", "clusters"), list(_splits(contents))),
        "COLUMNS": "\n\n".join(f"`{kind}`:\n\n{columns(KINDS[kind][1])}" for kind in contents.kinds),
        "PROVENANCE": columns(PROVENANCE),
        "LICENCE": _licence(contents),
        "VERSION": __version__,
        "PROMPTS": ", ".join(f"`{stage}` {prompt(stage).sha256}" for stage in _ASKED),
        "MODELS": table(("model", "prompt", "attempts"), [(*key, count) for key, count in _most(contents.models)]),
        "GATES": table(
            ("rules", "contract", "its digest", "budget", "sandbox", "image or libraries", "seed", "attempts"),
            [(*key, count) for key, count in _most(contents.gates)],
        ),
        "STAGES": "\n".join(stage_table(rows(history, stages, concepts))),
        "YIELDS": "\n".join(f"- {line}" for line in yield_lines(history.yields(concepts))),
    }
    return re.sub(r"@([A-Z]+)@", lambda found: words[found[1]], _TEMPLATE.read_text("utf-8"))


def _front(contents: Contents) -> str:
    """YAML for the Hub, whose strings are JSON's."""
    lines = [f"pretty_name: {json.dumps(one_line(contents.title))}"]
    lines += ["license: unknown"] if contents.licence is None else licence_lines(contents.licence)
    lines += [
        "task_categories:",
        "- text-generation",
        "tags:",
        *(f"- {tag}" for tag in ("sft", "preference", "code", "program-repair", "gymnasium", "trl", "envcraft")),
        "size_categories:",
        f"- {size_category(contents.total)}",
        "configs:",
    ]
    for kind in contents.kinds:
        lines += [f"- config_name: {kind}", "  data_files:"]
        for split in SPLITS:
            if contents.rows[kind][split]:
                lines += [f"  - split: {split}", f"    path: data/{kind}/{split}-*.parquet"]
    return "\n".join(lines)


def _splits(contents: Contents) -> list[tuple[str, str, int, int]]:
    return [
        (kind, split, contents.rows[kind][split], len(contents.clusters[kind][split]))
        for kind in contents.kinds
        for split in SPLITS
        if contents.rows[kind][split]
    ]


def _licence(contents: Contents) -> str:
    if contents.licence is not None:
        return f"The files are licensed under {text(contents.licence)}, as the corpus or whoever exported it says."
    if set(contents.licences) == {"unknown"}:
        return "None is stated for the files: whoever made them decides."
    told = ", ".join(f"{text(name)} ({count:,})" for name, count in sorted(contents.licences.items()))
    return f"There is not one for all. Of the attempts are: {told}. The column `licence` says it of each row."


def _most(values: Counter[Any]) -> list[tuple[Any, int]]:
    """What was counted, the most frequent first."""
    return sorted(values.items(), key=lambda item: (-item[1], str(item[0])))
