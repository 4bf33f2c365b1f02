"""The exporter ``sft``: parquet files and JSON lines of each kind of row, split by clusters, and a dataset card."""

from __future__ import annotations

import contextlib
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from envcraft.corpus.export.exporter import Exporter, Order, fresh_folder
from envcraft.corpus.export.shards import Shards
from envcraft.errors import UsageError
from envcraft.text import plural

_REQUIRED = ("pyarrow", "rensa")
#: The licence of a row whose licence nobody states.
UNKNOWN = "unknown"


class SftExporter(Exporter):
    name = "sft"
    summary = "conversational data for fine-tuning: briefs with code, repairs, preferences, labelled attempts"

    def export(self, order: Order) -> list[str]:
        missing = [name for name in _REQUIRED if importlib.util.find_spec(name) is None]
        if missing:
            raise UsageError(f"data for fine-tuning needs {' and '.join(missing)}: pip install 'envcraft-rl[publish]'")
        if order.everything:
            raise UsageError("--all cannot be used with --to sft, which always includes attempts that did not pass")
        from .card import Contents, card
        from .clusters import assign_splits, concept_clusters

        with fresh_folder(order.output) as folder:
            source = _Source(order)
            validated = source.labelled()
            if not validated:
                root = order.store.root
                raise UsageError(
                    f"{root} has no generated environments with a complete verdict: `envcraft generate --concepts N "
                    "--corpus DIR` creates a corpus with some"
                )
            numbers, splits = assign_splits(concept_clusters(order.store), validated)
            contents = Contents(order.name or order.title)
            with _Writer(folder) as writer:
                for concept in validated:
                    for kind, row in source.rows(concept, numbers[concept]):
                        writer.add(kind, splits[concept], row)
                        contents.add(kind, splits[concept], row)
            contents.unlabelled = source.unlabelled
            contents.licence = source.licences.one
            (folder / "README.md").write_text(card(order.store, contents), "utf-8")
        kinds = ", ".join(f"{kind} {contents.rows[kind].total():,}" for kind in contents.kinds)
        rows = f"{plural(contents.total, 'row')} of {plural(len(validated), 'concept')}"
        return [
            f"{order.output} has {rows}: {kinds}; in Python",
            *(f'  datasets.load_dataset("{order.output}", "{kind}")' for kind in contents.kinds),
        ]


class _Source:
    """The concepts of a corpus and their rows.

    Attributes:
        licences: Licences of the attempts.
        unlabelled: Number of attempts without a label, which have no row.
    """

    def __init__(self, order: Order) -> None:
        from envcraft.corpus.export.card import Licences
        from envcraft.generation.history import History

        from .labels import Labels

        self._history, self._labels = History(order.store), Labels(order)
        self.licences = Licences(order.licence)
        self.unlabelled = 0

    def labelled(self) -> dict[str, bool]:
        """Return each concept that has rows, and whether it was validated. Raises CorpusDamaged."""
        validated = {}
        for concept in self._history.concepts():
            state = self._history.state(concept)
            assert state is not None
            labelled = self._labels.of(state)
            self.unlabelled += len(state.attempts) - len(labelled)
            if labelled:
                validated[concept] = any(one.passed for one in labelled)
        return validated

    def rows(self, concept: str, cluster: int) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the kind and the content of each row of a concept.

        Raises:
            CorpusDamaged: If a source is missing or damaged.
            UsageError: If ``--licence`` contradicts a licence of the corpus.
        """
        from envcraft.corpus.store import generation

        from . import rows

        state = self._history.state(concept)
        assert state is not None
        labelled = self._labels.of(state)
        origins = [one.published.origin if one.published is not None else {} for one in labelled]
        licences = [self.licences.add(origin) or UNKNOWN for origin in origins]
        brief = generation.brief(self._history.store, concept)
        yield from rows.rows(state, labelled, cluster, brief[1] if brief else {}, licences)


class _Writer:
    """The files of all kinds and splits below a folder, each created with its first row. Use as a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._open = contextlib.ExitStack()
        self._shards: dict[str, Shards] = {}
        self._lines: dict[tuple[str, str], TextIO] = {}

    def __enter__(self) -> _Writer:
        self._open.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._open.__exit__(*raised)

    def add(self, kind: str, split: str, row: dict[str, Any]) -> None:
        """Write a row. Raises OSError."""
        from .rows import columns, schema

        if kind not in self._shards:
            self._shards[kind] = self._open.enter_context(Shards(self._folder / "data" / kind, schema(kind)))
        if (kind, split) not in self._lines:
            folder = self._folder / "jsonl" / kind
            folder.mkdir(parents=True, exist_ok=True)
            stream = (folder / f"{split}.jsonl").open("w", encoding="utf-8", newline="\n")
            self._lines[kind, split] = self._open.enter_context(stream)
        self._shards[kind].add(split, row)
        # Columns in the same order as in parquet.
        ordered = {name: row[name] for name, *_ in columns(kind)}
        self._lines[kind, split].write(json.dumps(ordered, ensure_ascii=False) + "\n")
