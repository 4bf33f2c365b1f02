"""``envcraft concepts``: generates ideas for games."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import click

from envcraft.errors import UsageError
from envcraft.text import plural

if TYPE_CHECKING:
    from .generation import Coverage
    from .writing import Concept


@click.command()
@click.option("--count", type=click.IntRange(1), default=100, show_default=True, help="Number of concepts.")
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the concepts. A larger --count continues the concepts of a smaller one.",
)
@click.option(
    "--strategy-share",
    "shares",
    metavar="NAME=SHARE,...",
    help="Share of each strategy; strategies that are not named have none.  "
    "[default: genre-blend=0.4,mechanical=0.3,thematic=0.2,experimental=0.1]",
)
@click.option(
    "--output", metavar="FILE", type=click.Path(path_type=Path), help="Write to this file.  [default: standard output]"
)
@click.option(
    "--format",
    "form",
    type=click.Choice(["jsonl", "text"]),
    default="jsonl",
    show_default=True,
    help="Write one JSON object per line, or the texts only.",
)
def concepts(count: int, seed: int, shares: str | None, output: Path | None, form: str) -> None:
    """Combine concepts of games from curated pools.

    The pools hold genres, mechanics, themes, twists, mashups and experiments. No model is used, and all concepts are
    distinct. The command prints on standard error how often each pool was used.
    """
    from . import generation

    generated = generation.concepts(count, seed, generation.SHARES if shares is None else _shares(shares))
    coverage = generation.Coverage()
    with _opened(output) as stream:
        for concept in generated:
            coverage.add(concept)
            stream.write(_line(concept, form))
    _print(coverage)


def _shares(text: str) -> dict[str, float]:
    """Raises UsageError if the text is not a list of shares."""
    values: dict[str, float] = {}
    for part in text.split(","):
        name, _, share = part.partition("=")
        name = name.strip()
        try:
            if name in values:
                raise ValueError
            values[name] = float(share)
        except ValueError:
            raise UsageError(
                f"--strategy-share {part.strip()!r} is not a share: write genre-blend=0.4,mechanical=0.6, each name "
                "once"
            ) from None
    return values


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


def _print(coverage: Coverage) -> None:
    counts = ", ".join(f"{name} {number:,}" for name, number in coverage.strategies.most_common())
    click.echo(f"{plural(coverage.strategies.total(), 'concept')}: {counts}", err=True)
    for pool, entries in coverage.entries.items():
        used = sum(number > 0 for number in entries.values())
        ranked = entries.most_common()
        (most, most_used), (least, least_used) = ranked[0], ranked[-1]
        click.echo(
            f"{pool:13} {used} of {len(entries)} used; most {most_used:,} ({most}), least {least_used:,} ({least})",
            err=True,
        )
