"""``python -m benchmarks.duplicates``: precision and recall of each similarity layer on planted duplicates.

The originals are the examples and the good fixtures; of two originals that share half of their shingles only the first
is used. The remaining files up to ``--number`` are copies, in equal parts: reformatted (other comments, docstrings and
blank lines), renamed (other names for private methods, constants and local variables) and edited (a tenth of the
numbers changed). A layer must find the pairs of a copy of its kind with the original and with other copies of that
kind. A pair of copies of different originals is always wrong. The peer of the layer ``near`` computes the Jaccard index
of all pairs of sets of shingles.

The layer ``behavioural`` is measured on fewer files, because they are played in the sandbox: each original and one
renamed copy.

The exit status is 1 for a precision below 0.99, for a recall below 0.95 (behavioural: of the files with a key), or if
``near`` takes longer than its peer on 1,000 files or more.
"""

from __future__ import annotations

import argparse
import ast
import io
import itertools
import keyword
import random
import re
import time
import tokenize
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

from envcraft_sandbox.process import ProcessDriver
from rich.console import Console
from rich.table import Table

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import EnvCraftError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target
from envcraft.similarity import behavioural, exact, near, structural
from envcraft.similarity.groups import Groups
from evaluation.fixtures import examples, fixtures

PRECISION, RECALL = 0.99, 0.95
#: Two originals with a higher Jaccard index count as the same game.
SHARED = 0.5
#: The kinds of copies that each layer must find.
MEANT = {"exact": ("exact",), "structural": ("exact", "renamed"), "near": ("exact", "edited")}
#: With this many files or more, hashing must be faster than comparing all pairs.
MANY = 1_000


class File(NamedTuple):
    """A file of the corpus: the number of its original, and the kind of its change ("" for an original)."""

    source: bytes
    original: int
    kind: str


def originals() -> list[bytes]:
    """Sources that are not duplicates of each other."""
    found: list[bytes] = []
    sets: list[near.Shingles] = []
    for fixture in (*examples(), *fixtures()):
        if fixture.policy is not None or (fixture.codes and fixture.check != "examples"):
            continue
        source = fixture.path.read_bytes()
        shingles = near.shingles(near.key(source) or b"")
        if structural.key(source) and all(near.jaccard(shingles, known) < SHARED for known in sets):
            found.append(source)
            sets.append(shingles)
    return found


def corpus(number: int, seed: int = 0) -> list[File]:
    """This many files: the originals and copies of them."""
    rng = random.Random(seed)
    known = originals()
    files = [File(source, place, "") for place, source in enumerate(known[:number])]
    kinds = itertools.cycle({"exact": reformatted, "renamed": renamed, "edited": edited}.items())
    while len(files) < number:
        kind, change = next(kinds)
        place = rng.randrange(len(known))
        files.append(File(change(known[place].decode(), rng).encode(), place, kind))
    rng.shuffle(files)
    return files


def reformatted(text: str, rng: random.Random) -> str:
    """Add comments and blank lines at the ends of statements."""
    lines = text.split("\n")
    ends = {token.start[0] for token in _tokens(text) if token.type == tokenize.NEWLINE}
    found = []
    for number, line in enumerate(lines, 1):
        found.append(f"{line}  # {rng.random()}" if number in ends and rng.random() < 0.1 else line)
        if number in ends and rng.random() < 0.05:
            found += ["", f"# {rng.random()}"]
    return "\n".join(found)


def renamed(text: str, rng: random.Random) -> str:
    """Change the names that only this file uses: no attribute, keyword or string contains them."""
    tree = ast.parse(text)
    own = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load)}
    own |= {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("_")}
    taken = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg | ast.keyword)}
    taken |= {
        alias.asname or alias.name
        for node in ast.walk(tree)
        for alias in getattr(node, "names", ())
        if isinstance(alias, ast.alias)
    }
    loaded = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    methods = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    taken |= loaded - methods
    tokens = _tokens(text)
    taken |= {word for token in tokens if token.type == tokenize.STRING for word in re.findall(r"\w+", token.string)}
    names = sorted(name for name in own - taken if not name.startswith("__") and not keyword.issoftkeyword(name))
    in_class = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for part in node.body
        for target in ast.walk(part)
        if isinstance(part, ast.Assign | ast.AnnAssign) and isinstance(target, ast.Name)
    }
    fresh = {
        name: f"{'_' * name.startswith('_')}n{rng.randrange(10**6)}_{place}"
        for place, name in enumerate(names)
        if name not in in_class
    }
    return _replaced(text, tokens, lambda token: fresh.get(token.string) if token.type == tokenize.NAME else None)


def edited(text: str, rng: random.Random) -> str:
    """Change a tenth of the numbers."""

    def change(token: tokenize.TokenInfo) -> str | None:
        whole = token.type == tokenize.NUMBER and token.string.isdecimal()
        return str(int(token.string) + rng.randrange(1, 9)) if whole and rng.random() < 0.1 else None

    return _replaced(text, _tokens(text), change)


def wanted(files: Sequence[File], kinds: Iterable[str]) -> set[tuple[int, int]]:
    """The pairs of duplicates among the originals and these kinds of copies."""
    places = [number for number, file in enumerate(files) if file.kind in ("", *kinds)]
    return {pair for pair in itertools.combinations(places, 2) if files[pair[0]].original == files[pair[1]].original}


def score(files: Sequence[File], groups: Groups, kinds: Iterable[str]) -> tuple[float, float]:
    """The precision over all pairs in the groups, and the recall of the duplicates of these kinds."""
    pairs = {pair for group in groups.all() for pair in itertools.combinations(group, 2)}
    right = sum(files[one].original == files[two].original for one, two in pairs)
    meant = wanted(files, kinds)
    return right / len(pairs) if pairs else 1.0, len(meant & pairs) / len(meant) if meant else 1.0


def equal(keys: Sequence[bytes | None]) -> Groups:
    groups = Groups(len(keys))
    first: dict[bytes, int] = {}
    for number, key in enumerate(keys):
        if key is not None:
            groups.join(first.setdefault(key, number), number)
    return groups


def hashed(sets: Sequence[near.Shingles]) -> Groups:
    """The clusters of the layer ``near``."""
    groups = Groups(len(sets))
    left = [(number, own) for number, own in enumerate(near.own(sets)) if own is not None]
    alike = Groups(len(left))
    for one, two in near.pairs([own for _, own in left], near.THRESHOLD, alike):
        alike.join(one, two)
        groups.join(left[one][0], left[two][0])
    return groups


def plain(sets: Sequence[near.Shingles]) -> Groups:
    """The clusters from the Jaccard index of every pair."""
    groups = Groups(len(sets))
    words = [frozenset(found.tolist()) for found in sets]
    for one, two in itertools.combinations(range(len(words)), 2):
        both = len(words[one] & words[two])
        if both and both / (len(words[one]) + len(words[two]) - both) >= near.THRESHOLD:
            groups.join(one, two)
    return groups


def played(number: int) -> tuple[float, float, int, float]:
    """Play `number` originals and a renamed copy of each.

    Returns the precision and recall by behaviour, the number of files with a key, and the seconds per file.
    """
    rng = random.Random(0)
    files = [
        File(source, place, kind)
        for place, original in enumerate(originals()[:number])
        for kind, source in (("", original), ("renamed", renamed(original.decode(), rng).encode()))
    ]
    started = time.perf_counter()
    series = [behavioural.read(_fingerprint(file.source)) for file in files]
    seconds = (time.perf_counter() - started) / len(files)
    keyed = [(file, key) for file, key in zip(files, series, strict=True) if key is not None]
    groups = Groups(len(keyed))
    for one, two in behavioural.pairs([key for _, key in keyed]):
        groups.join(one, two)
    return *score([file for file, _ in keyed], groups, ("renamed",)), len(keyed), seconds


def _fingerprint(source: bytes) -> str:
    try:
        lease = WorkerPool(ProcessDriver()).lease()
        with Subject(Target("game.py", source), ARCADE, lease, BUDGETS["quick"]) as subject:
            subject.rollout(subject.probes.sticky(0).cut(behavioural.STEPS))
            return subject.fingerprint
    except EnvCraftError:
        return ""


def _tokens(text: str) -> list[tokenize.TokenInfo]:
    return list(tokenize.generate_tokens(io.StringIO(text).readline))


def _replaced(text: str, tokens: list[tokenize.TokenInfo], change: Callable[[tokenize.TokenInfo], str | None]) -> str:
    lines = text.split("\n")
    # The changes are drawn in the order of the text, and applied from its end so that positions stay valid.
    changes = [(token, word) for token in tokens if (word := change(token)) is not None]
    for token, word in reversed(changes):
        row, column = token.start
        lines[row - 1] = lines[row - 1][:column] + word + lines[row - 1][token.end[1] :]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.duplicates", description=__doc__)
    parser.add_argument("--number", type=int, default=1_000, help="files in the corpus")
    parser.add_argument("--played", type=int, default=40, help="originals to play in the sandbox")
    options = parser.parse_args(arguments)
    files = corpus(options.number)
    table = Table(title=f"{len(files):,} files, {len({file.original for file in files})} originals")
    for column in ("layer", "precision", "recall", "CPU ms per key", "clusters, s"):
        table.add_column(column, justify="left" if column == "layer" else "right")
    broken: list[str] = []

    def show(name: str, precision: float, recall: float, milliseconds: float, seconds: float | None) -> None:
        took = "" if seconds is None else f"{seconds:.2f}"
        table.add_row(name, f"{precision:.4f}", f"{recall:.4f}", f"{milliseconds:.1f}", took)
        if name != "plain Jaccard" and (precision < PRECISION or recall < RECALL):
            broken.append(
                f"{name}: precision {precision:.4f}, at least {PRECISION}; recall {recall:.4f}, at least {RECALL}"
            )

    taken: dict[str, float] = {}
    for layer in (exact, structural, near):
        name = layer.__name__.rpartition(".")[2]
        started = time.process_time()
        keys = [layer.key(file.source) for file in files]
        milliseconds = (time.process_time() - started) / len(files) * 1000
        sets = [near.shingles(key or b"") for key in keys] if layer is near else []
        ways: dict[str, Callable[[], Groups]] = {name: partial(equal, keys)}
        if layer is near:
            ways = {name: partial(hashed, sets), "plain Jaccard": partial(plain, sets)}
        for way, make in ways.items():
            started = time.perf_counter()
            groups = make()
            taken[way] = time.perf_counter() - started
            show(way, *score(files, groups, MEANT[name]), milliseconds, taken[way])
    if options.played:
        precision, recall, keyed, seconds = played(options.played)
        show(f"behavioural ({keyed} files with a key)", precision, recall, seconds * 1000, None)
    console = Console(width=120)
    console.print(table)
    ratio = taken["near"] / taken["plain Jaccard"]
    console.print(f"near takes {ratio:.2f} times as long as comparing all pairs")
    if ratio > 1 and len(files) >= MANY:
        broken.append(f"near takes {ratio:.2f} times as long as comparing all pairs; at most 1")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
