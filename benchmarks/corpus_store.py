"""``python -m benchmarks.corpus_store``: what one more environment costs a corpus, however many there are.

Rows are added as an audit adds them, each verdict in a transaction of its own, and timed in batches once the corpus
holds 1,000, 10,000 and 100,000 environments: an environment with its source's file, a verdict with its findings, the
question which environments have none, and the question which have one code. Reports are of the size of real ones. The
cost of a row at the largest size is held to three times the least at another, and the peak resident size to 300 MiB;
exit status 1 where a limit does not hold.

Syncing each file to the disk is left out: it takes what the disk takes, whatever is on it. ``--sync`` has it, too.
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

from envcraft.corpus.settings import Settings
from envcraft.corpus.store import Environment, Store
from envcraft.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

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
    """A report: every fourth environment fails, by one of a hundred codes."""
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
    """Fill the store up to `size`; give milliseconds to add one, to judge one, and of the two questions."""
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
    asked = milliseconds(lambda: store.db.execute(pending, (settings,)).fetchall())
    found = milliseconds(lambda: store.db.execute(by_code).fetchall())
    return statistics.median(adding), statistics.median(judging), asked, found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; give 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.corpus_store", description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--folder", help="where the corpus is made, on the disk to be measured; removed at the end")
    parser.add_argument("--sync", action="store_true", help="sync each file to the disk, as an audit does")
    options = parser.parse_args(arguments)
    if not options.sync:
        os.fsync = lambda fd: None
    table = Table(title="a corpus, milliseconds")
    for column in ("environments", "add one", "judge one", "what is not judged?", "ten with a code", "MiB on disk"):
        table.add_column(column, justify="right")
    rows = []
    with tempfile.TemporaryDirectory(dir=options.folder) as folder, Store.create(Path(folder, "corpus")) as store:
        settings = store.settings(SETTINGS)
        for size in options.sizes:
            adding, judging, asked, found = measured(store, settings, size)
            rows.append((adding, judging))
            database = sum(file.stat().st_size for file in store.root.glob("corpus.sqlite*")) / 1024**2
            table.add_row(
                f"{size:,}", f"{adding:.3f}", f"{judging:.3f}", f"{asked:.1f}", f"{found:.2f}", f"{database:.0f}"
            )
    # Of a busy machine any one size may have the worst of it, so the last is held against the best of the others.
    ratios = [last / min(before) for *before, last in zip(*rows, strict=True)]
    mebibytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    table.add_row("last / least before", *(f"{ratio:.2f}" for ratio in ratios))
    console = Console(width=120)
    console.print(table)
    console.print(f"peak resident size {mebibytes:.0f} MiB")
    broken = [f"the cost of a row has grown {ratio:.1f} times; at most {RATIO}" for ratio in ratios if ratio > RATIO]
    if mebibytes > LIMIT_MIB:
        broken.append(f"{mebibytes:.0f} MiB were held; at most {LIMIT_MIB}")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
