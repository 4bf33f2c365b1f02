"""The export format ``hf``: a data set for the Hugging Face Hub, with parquet files for each split and a card.

All copies of an environment are in one split (:mod:`envcraft.corpus.splits`). The same corpus gives the same files with
the same version of pyarrow, independent of the order in which environments were added.
"""

from __future__ import annotations

import importlib.util
import json
from typing import TYPE_CHECKING, Any

from envcraft.corpus.export.exporter import Exported, Exporter, Order, fresh_folder
from envcraft.corpus.export.shards import SPLITS, Shards
from envcraft.errors import UsageError
from envcraft.plugins import hookimpl
from envcraft.text import plural

if TYPE_CHECKING:
    import pyarrow

    from envcraft.corpus.export.card import Contents

_NEEDED = ("pyarrow", "rensa")
#: The columns with their types and descriptions.
COLUMNS = (
    ("name", "string", "the environment's unique name in the corpus, a relative path"),
    ("source", "string", "the text of the Python file"),
    ("sha256", "string", "the SHA-256 of the file, which is that of `source` in UTF-8"),
    ("class", "string", "the environment's class in the file, if it is known"),
    ("group", "int64", "environments with the same number are copies of each other, and in the same split"),
    ("verdict", "string", "`pass`, `fail`, or `error` if it could not be judged"),
    ("undecided", "list<string>", "the checks of a pass that left their questions open within the budget"),
    ("codes", "list<string>", "the distinct codes of the findings; `envcraft explain CODE` describes one"),
    ("checks", "list<check>", "each check's `name`, `verdict` and, if it did not judge, the `reason`"),
    ("steps", "int64", "the number of environment steps that the validation took"),
    ("seconds", "double", "the wall time of the validation in seconds"),
    ("contract", "string", "the name of the contract"),
    ("contract_sha256", "string", "a digest of the contract"),
    ("rules", "string", "EnvCraft's version and a digest of the code that judged"),
    ("seed", "int64", "the seed of the run"),
    ("budget", "string", "the name of the budget, which limits episodes and steps"),
    ("sandbox", "string", "the name of the sandbox driver"),
    ("image", "string", "the container image's digest, or the versions of Python and the libraries"),
    ("origin", "string", "JSON: the origin of the environment"),
    ("report", "string", "JSON: the whole report, with each finding's message, evidence and reproduction"),
)


class DatasetExporter(Exporter):
    """Writes a data set."""

    name = "hf"
    summary = "a data set for the Hugging Face Hub: parquet files, in splits that keep duplicates together, and a card"

    def export(self, order: Order) -> list[str]:
        missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
        if missing:
            raise UsageError(f"a data set needs {' and '.join(missing)}: pip install 'envcraft-rl[publish]'")
        from envcraft.corpus import deduplication
        from envcraft.corpus.export.card import Contents, Licences, card

        with fresh_folder(order.output) as folder:
            duplicates = deduplication.clusters(order.store)
            groups, splits = _divided(order, deduplication.grouped(order.store, duplicates))
            contents = Contents(order.name or order.title, duplicates, Licences(order.licence))
            with Shards(folder / "data", _schema()) as files:
                for environment in order.environments():
                    # Another process may add environments in the meantime.
                    if environment.name in groups:
                        _write(order, environment, groups[environment.name], splits[environment.name], files, contents)
            if not contents.rows.total():
                raise order.nothing()
            (folder / "README.md").write_text(card(order.store, contents, COLUMNS), "utf-8")
        lines = [f"{order.output} has {plural(contents.rows.total(), 'environment')}: {contents.shares}; in Python"]
        if contents.undecoded:
            lines.insert(0, f"skipped sources that are not UTF-8: {contents.undecoded:,}")
        return [*lines, f'  datasets.load_dataset("{order.output}")']


def _divided(order: Order, groups: list[list[str]]) -> tuple[dict[str, int], dict[str, str]]:
    """Return the number of the group and the split of each environment to export."""
    from envcraft.corpus.splits import split

    wanted = {environment.name for environment in order.environments()}
    if not wanted:
        raise order.nothing()
    kept = sorted(sorted(wanted.intersection(group)) for group in groups)
    kept = [group for group in kept if group]
    numbers = {name: number for number, group in enumerate(kept) for name in group}
    parts = zip(SPLITS, split(kept, list(SPLITS.values())), strict=True)
    return numbers, {name: part for part, names in parts for name in names}


def _write(order: Order, environment: Exported, group: int, split: str, files: Shards, contents: Contents) -> None:
    """Write an environment's row, unless its source is not UTF-8."""
    try:
        # Not utf-8-sig: a byte order mark is part of the digest.
        source = order.store.source(environment.source).decode("utf-8")
    except UnicodeDecodeError:
        contents.undecoded += 1
        return
    files.add(split, _row(environment, source, group))
    contents.add(environment, group, split)


def _row(environment: Exported, source: str, group: int) -> dict[str, Any]:
    """Build an environment's row of :data:`COLUMNS`."""
    from envcraft.corpus.store import decode

    report = decode(environment.report) if environment.report is not None else None
    judged: dict[str, Any] = {"class": environment.env_class or None}
    if report is not None:
        judged = {
            "class": environment.env_class or report.env_class,
            "codes": sorted({finding.code for check in report.checks for finding in check.findings}),
            "checks": [
                {"name": check.check, "verdict": check.verdict.value, "reason": check.reason} for check in report.checks
            ],
            "steps": report.steps,
            "seconds": report.seconds,
        }
    return {
        "name": environment.name,
        "source": source,
        "sha256": environment.source,
        "group": group,
        "verdict": environment.verdict,
        "undecided": environment.undecided,
        **judged,
        "contract": environment.contract,
        "contract_sha256": environment.contract_sha256,
        "rules": environment.rules,
        "seed": environment.seed,
        "budget": environment.budget,
        "sandbox": environment.driver,
        "image": environment.image,
        "origin": json.dumps(environment.public, sort_keys=True, ensure_ascii=False),
        "report": environment.report,
    }


def _schema() -> pyarrow.Schema:
    import pyarrow

    text = pyarrow.string()
    types = {
        "string": text,
        "int64": pyarrow.int64(),
        "double": pyarrow.float64(),
        "list<string>": pyarrow.list_(text),
        "list<check>": pyarrow.list_(pyarrow.struct([("name", text), ("verdict", text), ("reason", text)])),
    }
    return pyarrow.schema([(name, types[kind]) for name, kind, _ in COLUMNS])


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    return [DatasetExporter()]
