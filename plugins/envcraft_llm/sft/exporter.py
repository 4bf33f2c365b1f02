"""The exporter ``sft``: parquet and JSON lines of each kind of row, split by near-duplicate clusters, and a card."""

from __future__ import annotations

import contextlib
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from envcraft.corpus.export import Exporter, Order, fresh_folder
from envcraft.corpus.export.shards import Shards
from envcraft.errors import UsageError
from envcraft.reports import plural

_NEEDED = ("pyarrow", "rensa")
#: What is written for a licence that nobody has stated.
UNKNOWN = "unknown"


class SftExporter(Exporter):
    name = "sft"
    summary = "chat data to fine-tune models on, of what was generated: briefs to code, repairs, preferences, outcomes"

    def export(self, order: Order) -> list[str]:
        missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
        if missing:
            raise UsageError(f"data for fine-tuning needs {' and '.join(missing)}: pip install 'envcraft-rl[publish]'")
        if order.everything:
            raise UsageError("--all does not go with --to sft: what has not passed is in it as that")
        from .card import Contents, card
        from .groups import divided, groups

        with fresh_folder(order.output) as folder:
            history = _History(order)
            wanted = history.settled()
            if not wanted:
                root = order.store.root
                raise UsageError(
                    f"{root} has no generated environments that were judged to the end: "
                    "`envcraft generate --concepts N --corpus DIR` makes a corpus of such"
                )
            numbers, splits = divided(groups(order.store), wanted)
            contents = Contents(order.name or order.title)
            with _Writer(folder) as writer:
                for concept in wanted:
                    for kind, row in history.rows(concept, numbers[concept]):
                        writer.add(kind, splits[concept], row)
                        contents.add(kind, splits[concept], row)
            contents.unsettled = history.unsettled
            contents.licence = history.licences.one
            (folder / "README.md").write_text(card(order.store, contents), "utf-8")
        kinds = ", ".join(f"{kind} {contents.rows[kind].total():,}" for kind in contents.kinds)
        rows = f"{plural(contents.total, 'row')} of {plural(len(wanted), 'concept')}"
        return [
            f"{order.output} has {rows}: {kinds}; in Python",
            *(f'  datasets.load_dataset("{order.output}", "{kind}")' for kind in contents.kinds),
        ]


class _History:
    """The concepts of a corpus and their rows. `unsettled` are attempts that nobody has judged to the end."""

    def __init__(self, order: Order) -> None:
        from envcraft.corpus.export.card import Licences
        from envcraft.corpus.history import History

        from .gate import Gate

        self._store, self._history, self._gate = order.store, History(order.store), Gate(order)
        self.licences = Licences(order.licence)
        self.unsettled = 0

    def settled(self) -> dict[str, bool]:
        """Each concept that has rows, and whether it was validated. Raises CorpusDamaged."""
        found = {}
        for concept in self._history.concepts():
            case = self._history.case(concept)
            assert case is not None
            judged = self._gate.judged(case)
            self.unsettled += len(case.attempts) - len(judged)
            if judged:
                found[concept] = any(one.passed for one in judged)
        return found

    def rows(self, concept: str, cluster: int) -> Iterator[tuple[str, dict[str, Any]]]:
        """The kind of each row of a concept, and the row. Raises CorpusDamaged, UsageError for a licence that the
        corpus contradicts.
        """
        from . import rows

        case = self._history.case(concept)
        assert case is not None
        judged = self._gate.judged(case)
        origins = [one.published.origin if one.published is not None else {} for one in judged]
        licences = [self.licences.add(origin) or UNKNOWN for origin in origins]
        brief = self._store.db.execute("SELECT provenance FROM briefs WHERE concept = ?", (concept,)).fetchone()
        yield from rows.rows(case, judged, cluster, json.loads(brief[0]) if brief else {}, licences)


class _Writer:
    """The files of all kinds and splits below a folder, each made with its first row. Use as a context manager."""

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
        """Raises OSError."""
        from .rows import columns, schema

        if kind not in self._shards:
            self._shards[kind] = self._open.enter_context(Shards(self._folder / "data" / kind, schema(kind)))
        if (kind, split) not in self._lines:
            place = self._folder / "jsonl" / kind
            place.mkdir(parents=True, exist_ok=True)
            stream = (place / f"{split}.jsonl").open("w", encoding="utf-8", newline="\n")
            self._lines[kind, split] = self._open.enter_context(stream)
        self._shards[kind].add(split, row)
        # In the order of the columns, as in the other form.
        ordered = {name: row[name] for name, *_ in columns(kind)}
        self._lines[kind, split].write(json.dumps(ordered, ensure_ascii=False) + "\n")
