"""``python -m benchmarks.concepts``: the speed and the variety of generated concepts.

The benchmark generates concepts as ``envcraft concepts`` does and compares them: by the digest of the normalised text,
and by the Jaccard index of the sets of 5-grams of words, where 0.7 or more is a near-duplicate. MinHash selects the
pairs to compare; it finds 99% of the pairs at that threshold.

The exit status is 1 if 20,000 concepts take more than 30 seconds, two concepts have the same text, a pool's entry is
never used, or more than 1% of the concepts have a near-duplicate.
"""

from __future__ import annotations

import argparse
import re
import time
import zlib
from collections.abc import Sequence

import numpy as np
from envcraft_llm.concepts.generation import Coverage, concepts
from envcraft_llm.concepts.writing import text_sha256
from rich.console import Console
from rich.table import Table

from envcraft.similarity import near
from envcraft.similarity.groups import Groups

SECONDS, NUMBER = 30, 20_000
#: The largest share of concepts that may be near-duplicates of an earlier one.
NEAR = 0.01


def shingles(text: str) -> near.Shingles:
    """The digests of a text's 5-grams of words."""
    words = re.findall(r"\w+", text.lower())
    grams = {" ".join(words[place : place + near.LENGTH]) for place in range(len(words) - near.LENGTH + 1)}
    return np.unique(np.array([zlib.crc32(gram.encode()) for gram in grams], np.uint32))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.concepts", description=__doc__)
    parser.add_argument("--number", type=int, default=NUMBER, help="how many concepts")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    started, cpu = time.perf_counter(), time.process_time()
    made = list(concepts(options.number, options.seed))
    seconds, cpu = time.perf_counter() - started, time.process_time() - cpu

    coverage = Coverage()
    for concept in made:
        coverage.add(concept)
    texts = {text_sha256(concept.text) for concept in made}
    groups = Groups(len(made))
    sets = [shingles(concept.text) for concept in made]
    for one, two in near.pairs(sets, near.THRESHOLD, groups):
        groups.join(one, two)
    alike = sum(len(group) - 1 for group in groups.all())

    table = Table(title=f"{len(made):,} concepts: {seconds:.1f} s, {cpu:.1f} s of CPU")
    for column in ("pool", "entries", "used", "highest count", "lowest count"):
        table.add_column(column, justify="left" if column == "pool" else "right")
    unused = 0
    for pool, entries in coverage.entries.items():
        used = sum(number > 0 for number in entries.values())
        unused += len(entries) - used
        table.add_row(pool, str(len(entries)), str(used), f"{max(entries.values()):,}", f"{min(entries.values()):,}")
    console = Console(width=120)
    console.print(table)
    words = [len(concept.text.split()) for concept in made]
    console.print(f"words in a text: {min(words)} to {max(words)}, {sum(words) / len(words):.0f} on average")
    console.print(f"distinct by normalised text: {len(texts):,}")
    console.print(f"near-duplicates of an earlier concept, Jaccard index {near.THRESHOLD} or more: {alike:,}")
    broken = [
        f"{seconds:.1f} s; at most {SECONDS} for {NUMBER:,}"
        if seconds > SECONDS * max(options.number / NUMBER, 1)
        else "",
        f"{len(made) - len(texts)} texts repeat an earlier one" if len(texts) < len(made) else "",
        f"{unused} entries are never used" if unused and options.number >= NUMBER else "",
        f"{alike} near-duplicates; at most {NEAR:.0%}" if alike > NEAR * len(made) else "",
    ]
    for message in filter(None, broken):
        console.print(f"limit broken: {message}")
    return int(any(broken))


if __name__ == "__main__":
    raise SystemExit(main())
