"""The dataset card: contents, provenance, and the yields of the pipeline."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

from envcraft.corpus.export.card import columns, licence_lines, size_category, table, text
from envcraft.corpus.export.shards import SPLITS
from envcraft.corpus.store import Store
from envcraft.generation.history import History
from envcraft.text import one_line
from envcraft.version import __version__
from envcraft_llm.pipeline.options import enabled_stages, offered_stages
from envcraft_llm.pipeline.tables import rows, stage_table, yield_lines
from envcraft_llm.templates import prompt

from .rows import KINDS, PROVENANCE

_TEMPLATE = Path(__file__).parent / "card.md.txt"
#: The stages whose prompts the rows contain.
_PROMPT_STAGES = ("code", "repair")


class Contents:
    """Statistics of the rows.

    Attributes:
        title: Title of the dataset.
        rows: Number of rows by kind and split.
        clusters: Cluster numbers by kind and split.
        labels: Number of attempts by label.
        models: Number of attempts by model and digest of the prompt.
        licences: Number of attempts by licence.
        gates: Number of attempts by settings of the verdict.
        unlabelled: Number of attempts without a label, which have no row.
        licence: The licence of all rows; None if they differ.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.rows: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
        self.clusters: dict[str, dict[str, set[int]]] = {kind: {name: set() for name in SPLITS} for kind in KINDS}
        self.labels: Counter[bool] = Counter()
        self.models: Counter[tuple[str | None, str | None]] = Counter()
        self.licences: Counter[str] = Counter()
        self.gates: Counter[tuple[Any, ...]] = Counter()
        self.unlabelled = 0
        self.licence: str | None = None

    def add(self, kind: str, split: str, row: dict[str, Any]) -> None:
        self.rows[kind][split] += 1
        self.clusters[kind][split].add(row["cluster"])
        if kind != "unpaired":
            return
        # Every attempt is in exactly one row of this kind.
        self.labels[row["label"]] += 1
        self.models[row["model"], row["prompt_sha256"]] += 1
        self.licences[row["licence"]] += 1
        gate = (row[name] for name in ("rules", "contract", "contract_sha256", "budget", "sandbox", "image"))
        self.gates[*gate, None if row["seed"] is None else str(row["seed"])] += 1

    @property
    def kinds(self) -> list[str]:
        """The kinds that have rows."""
        return [kind for kind in KINDS if self.rows[kind]]

    @property
    def total(self) -> int:
        return sum(count.total() for count in self.rows.values())


def card(store: Store, contents: Contents) -> str:
    """Return the card. Raises CorpusDamaged."""
    history = History(store)
    concepts = history.concepts()
    stages = enabled_stages(offered_stages(), history.counts(concepts))
    values = {
        "FRONT": _front(contents),
        "TITLE": text(contents.title),
        "TOTAL": f"{contents.total:,}",
        "FIRST": contents.kinds[0],
        "KINDS": table(
            ("kind", "rows", "a row is"),
            [(kind, contents.rows[kind].total(), KINDS[kind][0]) for kind in contents.kinds],
        ),
        "PASSED": f"{contents.labels[True]:,}",
        "FAILED": f"{contents.labels[False]:,}",
        "UNLABELLED": f"{contents.unlabelled:,}",
        "SPLITS": table(("kind", "split", "rows", "clusters"), list(_splits(contents))),
        "COLUMNS": "\n\n".join(f"`{kind}`:\n\n{columns(KINDS[kind][1])}" for kind in contents.kinds),
        "PROVENANCE": columns(PROVENANCE),
        "LICENCE": _licence(contents),
        "VERSION": __version__,
        "PROMPTS": ", ".join(f"`{stage}` {prompt(stage).sha256}" for stage in _PROMPT_STAGES),
        "MODELS": table(("model", "prompt", "attempts"), [(*key, count) for key, count in _most(contents.models)]),
        "GATES": table(
            ("rules", "contract", "contract digest", "budget", "sandbox", "image or libraries", "seed", "attempts"),
            [(*key, count) for key, count in _most(contents.gates)],
        ),
        "STAGES": "\n".join(stage_table(rows(history, stages, concepts))),
        "YIELDS": "\n".join(f"- {line}" for line in yield_lines(history.yields(concepts))),
    }
    return re.sub(r"@([A-Z]+)@", lambda match: values[match[1]], _TEMPLATE.read_text("utf-8"))


def _front(contents: Contents) -> str:
    """The YAML header for the Hugging Face Hub; its strings are JSON strings."""
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
        return f"The files are licensed under {text(contents.licence)}, as the corpus or the export command states."
    if set(contents.licences) == {"unknown"}:
        return "No licence is stated for the files: their author decides."
    listed = ", ".join(f"{text(name)} ({count:,})" for name, count in sorted(contents.licences.items()))
    return f"The licences of the attempts differ: {listed}. The column `licence` states the licence of each row."


def _most(values: Counter[Any]) -> list[tuple[Any, int]]:
    """The counts, the most frequent value first."""
    return sorted(values.items(), key=lambda item: (-item[1], str(item[0])))
