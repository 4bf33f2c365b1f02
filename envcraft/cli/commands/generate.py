"""``envcraft generate``: write environments with a family, or with a generator that a plugin adds."""

from __future__ import annotations

import contextlib
import hashlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from envcraft.cli import completion
from envcraft.cli.configured import PartlyConfigured
from envcraft.environments.families import axes_from, families_named
from envcraft.errors import UsageError
from envcraft.files import refuse_file
from envcraft.registry import offered

if TYPE_CHECKING:
    from envcraft.environments.families import Family, Generated
    from envcraft.generation.generators import Generator


@dataclass(frozen=True)
class _Written:
    """An environment with its origin: the family, its settings, and what the family says about the environment."""

    name: str
    source: bytes
    origin: dict[str, Any]

    @property
    def file(self) -> str:
        return f"{self.name}.py"


class _Generate(PartlyConfigured):
    """A command with the options of all generators. An option of a generator selects it."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        own = super().get_params(ctx)
        known = {param.name for param in own}
        more: list[click.Parameter] = []
        for generator in self._generators(ctx):
            more += [param for param in generator.command.params if param.name not in known]
            known |= {param.name for param in more}
        # --help stays the last.
        return [*own[: len(self.params)], *more, *own[len(self.params) :]]

    def invoke(self, ctx: click.Context) -> Any:
        mine = {str(param.name) for param in self.params}
        given = {name for name in ctx.params if ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE}
        for generator in self._generators(ctx):
            if given & generator.chosen_by:
                theirs = {str(param.name) for param in generator.command.params}
                if strange := sorted(given - theirs):
                    chosen = self._options(ctx, given & generator.chosen_by)
                    raise UsageError(f"{self._options(ctx, strange[:1])} cannot be used with {chosen}")
                values = {name: value for name, value in ctx.params.items() if name in theirs}
                assert generator.command.callback is not None
                return ctx.invoke(generator.command.callback, **values)
        if strange := sorted(given - mine):
            chosen = self._options(ctx, {name for found in self._generators(ctx) for name in found.chosen_by})
            raise UsageError(f"{self._options(ctx, strange[:1])} needs one of {chosen}")
        ctx.params = {name: value for name, value in ctx.params.items() if name in mine}
        return super().invoke(ctx)

    def _generators(self, ctx: click.Context) -> list[Generator]:
        """Collect the generators once for each run of the command."""
        found: list[Generator] = ctx.meta.setdefault(__name__, None) or offered("envcraft_generators")
        ctx.meta[__name__] = found
        return found

    def _options(self, ctx: click.Context, names: Iterable[str]) -> str:
        """Write parameters as options."""
        return ", ".join(sorted(param.opts[0] for param in self.get_params(ctx) if param.name in names))


@click.command(cls=_Generate)
@click.option(
    "--family",
    metavar="NAME,...",
    shell_complete=completion.families,
    help="The program that writes the environments, such as tetris. Several names write a mixed corpus.",
)
@click.option("--list", "listing", is_flag=True, help="List the families and exit.")
@click.option(
    "--count",
    type=click.IntRange(1, 1_000_000),
    default=1,
    show_default=True,
    help="The number of environments of each family.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="The same seed gives the same environments.",
)
@click.option(
    "--difficulty",
    type=click.FloatRange(0, 1),
    help="The difficulty of all environments. Without it, each family draws one for each environment.",
)
@click.option(
    "--where",
    multiple=True,
    metavar="AXIS=VALUE",
    help="Generate only environments with this value on an axis, such as board.rows=16. Can be repeated.",
)
@click.option(
    "--corpus",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Add the environments to this corpus, which is created if needed.",
)
@click.option(
    "--output", metavar="DIR", type=click.Path(path_type=Path), help="Write the environments as files into this folder."
)
def generate(
    family: str | None,
    listing: bool,
    count: int,
    seed: int,
    difficulty: float | None,
    where: tuple[str, ...],
    corpus: Path | None,
    output: Path | None,
) -> None:
    """Write environments with a program or with language models.

    With --family, a program writes COUNT environments, one file each. Several families write COUNT environments each.
    With --concepts, language models write them, stage by stage, into a corpus.

    Environments that exist are kept. If a name exists with a different source, the command stops and writes nothing.
    """
    if listing:
        for known in offered("envcraft_families"):
            click.echo(f"{known.name}  {known.summary}")
        return
    if family is None:
        raise UsageError("choose a --family, which `envcraft generate --list` lists, or a number of --concepts")
    writers = families_named(family, difficulty, axes_from(where))
    if (corpus is None) == (output is None):
        raise UsageError("choose where to write: either --corpus DIR or --output DIR")
    for folder in filter(None, (corpus, output)):
        refuse_file(folder)
    try:
        found = _generated(writers, count, seed, difficulty)
        if corpus is not None:
            fresh = _into_corpus(corpus, found)
            then = f"envcraft audit {corpus}"
        else:
            assert output is not None
            fresh = _into_folder(output, found)
            then = f"envcraft validate {output}"
    except KeyboardInterrupt:
        click.echo("nothing was written", err=True)
        raise
    click.echo(f"wrote {fresh:,}, kept {len(found) - fresh:,} that exist; validate them with `{then}`")


def _generated(families: Sequence[Family], count: int, seed: int, difficulty: float | None) -> list[_Written]:
    """Generate the environments of all families. Raises UsageError if two families give an environment one name."""
    found: dict[str, _Written] = {}
    for family in families:
        origin = {"family": family.name, "seed": seed}
        if difficulty is not None:
            origin["difficulty"] = difficulty
        for one in _with_progress(family.generate(count, seed, difficulty), family.name, count):
            if one.name in found:
                other = found[one.name].origin["family"]
                raise UsageError(f"{other} and {family.name} both write {one.name}.py; use one corpus for each")
            found[one.name] = _Written(one.name, one.source.encode(), {**origin, **one.metadata})
    return list(found.values())


def _with_progress(written: Iterator[Generated], family: str, count: int) -> Iterator[Generated]:
    """Show on a terminal how many environments of a family are written."""
    if not sys.stderr.isatty():
        yield from written
        return
    with click.progressbar(written, length=count, label=family, file=sys.stderr, show_pos=True) as shown:
        yield from shown


def _into_corpus(place: Path, found: list[_Written]) -> int:
    """Add environments with their origins, all or none; return the number of new ones. Raises UsageError."""
    from envcraft.corpus.store import Store, environments, is_corpus

    with Store(place, write=True) if is_corpus(place) else Store.create(place) as store:
        if store.follows_folder:
            raise UsageError(
                f"{place} follows a folder; generate into that folder with --output, or into another corpus"
            )
        known = {one.name: one.source for one in environments.every(store)}
        for one in found:
            if one.file in known and known[one.file] != hashlib.sha256(one.source).hexdigest():
                raise _taken(one.file, place)
        try:
            with store.transaction():
                return sum(store.add(one.file, one.source, origin=one.origin) for one in found)
        except OSError as error:
            raise UsageError(f"{place} cannot be written: {error.strerror or error}") from None


def _into_folder(folder: Path, found: list[_Written]) -> int:
    """Write files, all or none; return the number of new ones. Raises UsageError."""
    written: list[Path] = []
    fresh = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        missing = [one for one in found if not (folder / one.file).exists()]
        wanted = {one.name for one in missing}
        for one in found:
            if one.name not in wanted and (folder / one.file).read_bytes() != one.source:
                raise _taken(one.file, folder)
        for one in missing:
            written.append(folder / one.file)
            written[-1].write_bytes(one.source)
    except BaseException as error:
        # A file that is cut short would be another source to the next run.
        for path in written:
            path.unlink(missing_ok=True)
        if fresh:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise UsageError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
        raise
    return len(missing)


def _taken(name: str, place: Path) -> UsageError:
    return UsageError(f"{place} has another source for {name}, so nothing was written; choose another place or --seed")
