"""``python -m benchmarks.audit_report``: the cost of a report on 10,000 environments beside a dump of the same corpus.

The benchmark fills a corpus with verdicts as ``benchmarks.corpus_store`` makes them, and adds a preview to each. One
process writes the report. The peer is another process that dumps the database as SQL, as ``.dump`` of ``sqlite3`` does,
and copies the sources and previews.

The exit status is 1 if a limit is broken: on the seconds for the report, on the peak memory of its process, or on the
bytes that a browser loads to open the first page.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.corpus_store import SETTINGS, name_of, report_of, source_of
from envcraft.corpus.report import media
from envcraft.corpus.store import DATABASE, SOURCES, Store

SIZE = 10_000
SECONDS, MEBIBYTES, BYTES = 60.0, 400, 2 * 10**6


def fill(root: Path, size: int) -> None:
    """Make a corpus with a verdict on each environment and a hundred different previews."""
    pictures = [preview(number) for number in range(100)]
    with Store.create(root) as store:
        settings = store.settings(SETTINGS)
        with store.transaction():
            for number in range(size):
                store.add(name_of(number), source_of(number))
                sha256 = hashlib.sha256(source_of(number)).hexdigest()
                verdict = store.insert(sha256, "", settings, report_of(number))
                store.db.execute("UPDATE environments SET verdict = ? WHERE source = ?", (verdict, sha256))
                data = pictures[number % len(pictures)]
                picture = hashlib.sha256(data).hexdigest()
                if not media.place(store, picture).exists():
                    store.keep(media.place(store, picture), data)
                store.db.execute("INSERT INTO previews VALUES (?, '', 'benchmark', ?)", (sha256, picture))


def preview(number: int) -> bytes:
    """A preview: a block that moves over a random floor."""
    frames = []
    tiles = np.random.default_rng(number).integers(30, 90, (21, 21, 3), np.uint8)
    for step in range(media.STEPS):
        frame = tiles.repeat(4, axis=0).repeat(4, axis=1)
        frame[40:48, step : step + 8] = (250, 200, number)
        frames.append(frame)
    return media.encode(frames)


def write_report(root: Path, output: Path) -> None:
    from envcraft.corpus.report.site import build
    from envcraft.judging.selection import all_checks

    with Store(root, write=True) as store:
        build(store, output, all_checks())


def dump(root: Path, output: Path) -> None:
    output.mkdir()
    with sqlite3.connect(root / DATABASE) as connection, open(output / "corpus.sql", "w", encoding="utf-8") as stream:
        for line in connection.iterdump():
            stream.write(f"{line}\n")
    for folder in (SOURCES, media.MEDIA):
        shutil.copytree(root / folder, output / folder)


def measured(work: str, root: Path, output: Path) -> tuple[float, float]:
    """Run one of the two in a new process; return its seconds and its peak memory in MiB."""
    command = [sys.executable, "-m", "benchmarks.audit_report", "--do", work, str(root), str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    seconds, mebibytes = done.stdout.split()
    return float(seconds), float(mebibytes)


def first_page(output: Path) -> int:
    """Bytes of the first page and of the pictures on it."""
    page = output / "index.html"
    pictures = re.findall(r'src="(media/[^"]+)"', page.read_text("utf-8"))
    return sum(file.stat().st_size for file in (page, *(output / picture for picture in pictures)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.audit_report", description=__doc__)
    parser.add_argument("--size", type=int, default=SIZE)
    parser.add_argument("--do", nargs=3, metavar=("WORK", "CORPUS", "FOLDER"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.do:
        work = {"report": write_report, "dump": dump}[options.do[0]]
        started = time.perf_counter()
        work(Path(options.do[1]), Path(options.do[2]))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(time.perf_counter() - started, peak)
        return 0
    # The time that the disk takes to sync is not part of the measurement.
    os.fsync = lambda fd: None
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder, "corpus")
        fill(root, options.size)
        dumped, _ = measured("dump", root, Path(folder, "dump"))
        seconds, mebibytes = measured("report", root, Path(folder, "report"))
        again, _ = measured("report", root, Path(folder, "report"))
        opened = first_page(Path(folder, "report"))
        files = [file for file in Path(folder, "report").rglob("*") if file.is_file()]
        whole = sum(file.stat().st_size for file in files)
    table = Table(title=f"the report on {options.size:,} environments")
    for column in ("", "measured", "at most"):
        table.add_column(column, justify="right" if column else "left")
    table.add_row("seconds to write it", f"{seconds:.1f}", f"{SECONDS:.0f}")
    table.add_row("seconds to write it again, with cached similarity keys", f"{again:.1f}", "")
    table.add_row("the same as a multiple of the dump", f"{again / dumped:.2f}", "")
    table.add_row("peak resident size, MiB", f"{mebibytes:.0f}", f"{MEBIBYTES}")
    table.add_row("first page, kB", f"{opened / 1000:.0f}", f"{BYTES // 1000:,}")
    table.add_row("whole report, MB", f"{whole / 10**6:.0f}", "")
    console = Console(width=120)
    console.print(table)
    held = seconds <= SECONDS and mebibytes <= MEBIBYTES and opened <= BYTES
    if not held:
        console.print("a limit is broken")
    return int(not held)


if __name__ == "__main__":
    raise SystemExit(main())
