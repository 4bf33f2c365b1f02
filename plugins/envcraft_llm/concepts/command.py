"""``envcraft concepts``: ideas for games, as many as are asked for."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import click

from envcraft.errors import UsageError

if TYPE_CHECKING:
    from .generation import Coverage
    from .writing import Concept


@click.command()
@click.option("--count", type=click.IntRange(1), default=100, show_default=True, help="How many.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Same seed, same concepts; more begin alike."
)
@click.option(
    "--strategy-share",
    "shares",
    metavar="NAME=SHARE,...",
    help="How many come from each strategy; what is left out has none.  "
    "[default: genre-blend=0.4,mechanical=0.3,thematic=0.2,experimental=0.1]",
)
@click.option("--output", metavar="FILE", type=click.Path(path_type=Path), help="Write there, not to standard output.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["jsonl", "text"]),
    default="jsonl",
    show_default=True,
    help="A JSON object a line, or the texts alone, to be read.",
)
def concepts(count: int, seed: int, shares: str | None, output: Path | None, form: str) -> None:
    """Put together concepts of games from curated pools of genres, mechanics, themes, twists, mashups and experiments.

    No model is asked. All are distinct, and which entries they use, and how often, is told on standard error.
    """
    from . import generation

    made = generation.concepts(count, seed, generation.SHARES if shares is None else _shares(shares))
    coverage = generation.Coverage()
    with _opened(output) as stream:
        for concept in made:
            coverage.add(concept)
            stream.write(_line(concept, form))
    _tell(coverage)


def _shares(text: str) -> dict[str, float]:
    """Raises UsageError on what cannot be read as shares."""
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, share = part.partition("=")
        name = name.strip()
        try:
            if name in found:
                raise ValueError
            found[name] = float(share)
        except ValueError:
            raise UsageError(
                f"--strategy-share {part.strip()!r} is no share: write genre-blend=0.4,mechanical=0.6, each name once"
            ) from None
    return found


@contextlib.contextmanager
def _opened(output: Path | None) -> Iterator[IO[bytes]]:
    if output is None:
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    try:
        with output.open("wb") as stream:
            yield stream
    except OSError as error:
        raise UsageError(f"--output {output} cannot be written: {error.strerror}") from None


def _line(concept: Concept, form: str) -> bytes:
    if form == "text":
        return f"{concept.text}\n\n".encode()
    import msgspec

    return msgspec.json.encode(concept) + b"\n"


def _tell(coverage: Coverage) -> None:
    counts = ", ".join(f"{name} {number:,}" for name, number in coverage.strategies.most_common())
    click.echo(f"{coverage.strategies.total():,} concepts: {counts}", err=True)
    for pool, entries in coverage.entries.items():
        used = sum(number > 0 for number in entries.values())
        ranked = entries.most_common()
        (most, most_used), (least, least_used) = ranked[0], ranked[-1]
        click.echo(
            f"{pool:13} {used} of {len(entries)} used; most {most_used:,} ({most}), least {least_used:,} ({least})",
            err=True,
        )
