"""``envcraft generate``: environments that a family writes, into a corpus or a folder."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import offered
from envcraft.errors import EnvCraftError, UsageError

from .choices import family_named

if TYPE_CHECKING:
    from envcraft.families import Generated


@click.command()
@click.option("--family", metavar="NAME", help="Which program writes them, such as tetris.")
@click.option("--list", "listing", is_flag=True, help="List the families, and write nothing.")
@click.option("--count", type=click.IntRange(1, 1_000_000), default=1, show_default=True, help="How many.")
@click.option(
    "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Same seed, same environments."
)
@click.option(
    "--corpus", metavar="DIR", type=click.Path(path_type=Path), help="Add them to a corpus; a new one is made."
)
@click.option("--output", metavar="DIR", type=click.Path(path_type=Path), help="Write plain files into a folder.")
def generate(
    family: str | None, listing: bool, count: int, seed: int, corpus: Path | None, output: Path | None
) -> None:
    """Write environments: so many of a family, a file each, with no name twice.

    What is there already is left as it is. Nothing is overwritten: where a name has another source, nothing is written.
    """
    if listing:
        for known in offered("envcraft_families"):
            click.echo(f"{known.name}  {known.summary}")
        return
    if family is None:
        raise UsageError("name a --family; `envcraft generate --list` lists them")
    writer = family_named(family)
    if (corpus is None) == (output is None):
        raise UsageError("say where to: either --corpus DIR or --output DIR")
    found = list(writer.generate(count, seed))
    if corpus is not None:
        fresh = _into_corpus(corpus, found, {"family": family, "seed": seed})
        then = f"envcraft audit {corpus}"
    else:
        assert output is not None
        fresh = _into_folder(output, found)
        then = f"envcraft validate {output}"
    click.echo(f"{fresh:,} written, {len(found) - fresh:,} there already; `{then}` judges them")


def _into_corpus(place: Path, found: list[Generated], origin: dict[str, object]) -> int:
    """Add environments with their metadata; give how many were new. Raises UsageError, EnvCraftError."""
    from envcraft.corpus.store import Store, is_corpus

    with Store(place, write=True) if is_corpus(place) else Store.create(place) as store:
        if store.follows_folder:
            raise UsageError(
                f"{place} follows a folder; generate into that folder with --output, or into another corpus"
            )
        known = dict(store.db.execute("SELECT name, source FROM environments"))
        for one in found:
            if one.name + ".py" in known and known[one.name + ".py"] != hashlib.sha256(one.source.encode()).hexdigest():
                raise _taken(f"{one.name}.py", place)
        try:
            with store.transaction():
                return sum(
                    store.add(f"{one.name}.py", one.source.encode(), origin={**origin, **one.metadata}) for one in found
                )
        except OSError as error:
            raise EnvCraftError(f"{place} cannot be written: {error.strerror or error}") from None


def _into_folder(folder: Path, found: list[Generated]) -> int:
    """Write files; give how many were new. Raises UsageError, EnvCraftError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        missing = [one for one in found if not (folder / f"{one.name}.py").exists()]
        wanted = {one.name for one in missing}
        for one in found:
            if one.name not in wanted and (folder / f"{one.name}.py").read_bytes() != one.source.encode():
                raise _taken(f"{one.name}.py", folder)
        for one in missing:
            (folder / f"{one.name}.py").write_bytes(one.source.encode())
    except OSError as error:
        raise EnvCraftError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
    return len(missing)


def _taken(name: str, place: Path) -> UsageError:
    return UsageError(f"{name} is another source in {place}, and nothing was written; choose another place or --seed")
