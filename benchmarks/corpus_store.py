"""``python -m benchmarks.corpus_store``: how the cost of an additional environment grows with the corpus.

The benchmark adds rows as an audit does, each verdict in its own transaction, and times them in batches when the corpus
has 1,000, 10,000 and 100,000 environments. It measures adding an environment with its source file, adding a verdict
with its findings, the query for environments without a verdict, and the query for environments with one code. Reports
have a realistic size.

The exit status is 1 if a limit is broken: a row at the largest size costs three times the lowest cost at a smaller
size, or the peak resident size is 300 MiB.

Files are not synced to the disk unless ``--sync`` is given: the time depends on the disk, not on the corpus.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from envcraft.corpus.store import Environment, Store
from envcraft.judging.settings import Settings
from envcraft.model.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

SIZES = (1_000, 10_000, 100_000)
BATCHES, BATCH = 5, 100
RATIO, LIMIT_MIB = 3.0, 300
SETTINGS = Settings("arcade", "0" * 64, "rules", 0, "standard", "process", "python")
CHECKS = (
    "source",
    "api",
    "determinism",
    "reward",
    "observation",
    "termination",
    "instawin",
    "instadeath",
    "difficulty",
)


def name_of(number: int) -> str:
    return f"games/{number % 100:02}/env{number:06}.py"


def source_of(number: int) -> bytes:
    return f"# {number}\nimport gymnasium\n".encode() + b"# a line of some game or other\n" * 200


def report_of(number: int) -> SubjectReport:
    """A report: every fourth environment fails, with one of a hundred codes."""
    found = [
        Finding(
            f"EC{number % 100:03}",
            Severity.ERROR,
            f"step() raises at step {number}",
            41,
            {"traceback": "line\n" * 40},
            Repro(number, [[step % 5, 0, 0] for step in range(100)]),
        )
    ]
    failed = number % 4 == 0
    checks = [CheckReport(name, Verdict.PASS, 0.1) for name in CHECKS]
    if failed:
        checks[1] = CheckReport("api", Verdict.FAIL, 0.1, found)
    verdict = Verdict.FAIL if failed else Verdict.PASS
    return SubjectReport(name_of(number), "Game", "0" * 64, verdict, "process", 3.0, 20_000, checks)


def milliseconds(work: Callable[[], object]) -> float:
    started = time.perf_counter()
    work()
    return (time.perf_counter() - started) * 1000


def add(store: Store, numbers: range) -> None:
    for number in numbers:
        store.add(name_of(number), source_of(number))


def judge(store: Store, settings: int, numbers: range) -> None:
    for number in numbers:
        sha256 = hashlib.sha256(source_of(number)).hexdigest()
        store.record(Environment(name_of(number), sha256, ""), settings, report_of(number))


def measured(store: Store, settings: int, size: int) -> tuple[float, float, float, float]:
    """Fill the store up to `size`; return the milliseconds to add one, to judge one, and for each of the queries."""
    (count,) = store.db.execute("SELECT count(*) FROM environments").fetchone()
    fill = range(count, size)
    with store.transaction():
        add(store, fill)
        for number in fill:
            sha256 = hashlib.sha256(source_of(number)).hexdigest()
            verdict = store.insert(sha256, "", settings, report_of(number))
            store.db.execute("UPDATE environments SET verdict = ? WHERE source = ?", (verdict, sha256))
    adding, judging = [], []
    for number in range(size, size + BATCHES * BATCH, BATCH):
        batch = range(number, number + BATCH)
        adding.append(milliseconds(lambda batch=batch: add(store, batch)) / BATCH)  # type: ignore[misc]
        judging.append(milliseconds(lambda batch=batch: judge(store, settings, batch)) / BATCH)  # type: ignore[misc]
    pending = (
        "SELECT count(*) FROM environments e LEFT JOIN verdicts v ON v.source = e.source AND v.class = e.class "
        "AND v.settings = ? WHERE v.id IS NULL"
    )
    by_code = (
        "SELECT name FROM environments WHERE verdict IN (SELECT verdict FROM findings WHERE code = 'EC004') LIMIT 10"
    )
    without = milliseconds(lambda: store.db.execute(pending, (settings,)).fetchall())
    found = milliseconds(lambda: store.db.execute(by_code).fetchall())
    return statistics.median(adding), statistics.median(judging), without, found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.corpus_store", description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--folder", help="make the corpus in this folder, and remove it at the end")
    parser.add_argument("--sync", action="store_true", help="sync each file to the disk, as an audit does")
    options = parser.parse_args(arguments)
    if not options.sync:
        os.fsync = lambda fd: None
    table = Table(title="a corpus, milliseconds")
    for column in ("environments", "add one", "judge one", "without a verdict", "ten with a code", "MiB on disk"):
        table.add_column(column, justify="right")
    rows = []
    with tempfile.TemporaryDirectory(dir=options.folder) as folder, Store.create(Path(folder, "corpus")) as store:
        settings = store.settings(SETTINGS)
        for size in options.sizes:
            adding, judging, without, found = measured(store, settings, size)
            rows.append((adding, judging))
            database = sum(file.stat().st_size for file in store.root.glob("corpus.sqlite*")) / 1024**2
            table.add_row(
                f"{size:,}", f"{adding:.3f}", f"{judging:.3f}", f"{without:.1f}", f"{found:.2f}", f"{database:.0f}"
            )
    # On a busy machine one size may be slow by chance: compare the last with the best of the others.
    ratios = [last / min(before) for *before, last in zip(*rows, strict=True)]
    mebibytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    table.add_row("last / lowest before", *(f"{ratio:.2f}" for ratio in ratios))
    console = Console(width=120)
    console.print(table)
    console.print(f"peak resident size {mebibytes:.0f} MiB")
    broken = [f"the cost of a row grew {ratio:.1f} times; at most {RATIO}" for ratio in ratios if ratio > RATIO]
    if mebibytes > LIMIT_MIB:
        broken.append(f"the process used {mebibytes:.0f} MiB; at most {LIMIT_MIB}")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
