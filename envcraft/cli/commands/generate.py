"""``envcraft generate``: write environments with a family, or with a generator that a plugin adds."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from envcraft.cli.configured import PartlyConfigured
from envcraft.environments.families import family_named
from envcraft.errors import UsageError
from envcraft.registry import offered

if TYPE_CHECKING:
    from envcraft.environments.families import Generated
    from envcraft.generation.generators import Generator


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
                    raise UsageError(f"{self._options(ctx, strange[:1])} does not go with {chosen}")
                values = {name: value for name, value in ctx.params.items() if name in theirs}
                assert generator.command.callback is not None
                return ctx.invoke(generator.command.callback, **values)
        if strange := sorted(given - mine):
            chosen = self._options(ctx, {name for found in self._generators(ctx) for name in found.chosen_by})
            raise UsageError(f"{self._options(ctx, strange[:1])} goes with one of {chosen}")
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
@click.option("--family", metavar="NAME", help="The program that writes the environments, such as tetris.")
@click.option("--list", "listing", is_flag=True, help="List the families and exit.")
@click.option(
    "--count", type=click.IntRange(1, 1_000_000), default=1, show_default=True, help="The number of environments."
)
@click.option(
    "--seed",
    type=click.IntRange(0, 2**31 - 1),
    default=0,
    show_default=True,
    help="The same seed gives the same environments.",
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
    family: str | None, listing: bool, count: int, seed: int, corpus: Path | None, output: Path | None
) -> None:
    """Write environments with a program or with language models.

    With --family, a program writes COUNT environments, one file each. With --concepts, language models write them,
    stage by stage, into a corpus.

    Environments that exist are kept. If a name exists with a different source, the command stops and writes nothing.
    """
    if listing:
        for known in offered("envcraft_families"):
            click.echo(f"{known.name}  {known.summary}")
        return
    if family is None:
        raise UsageError("choose a --family, which `envcraft generate --list` lists, or a number of --concepts")
    writer = family_named(family)
    if (corpus is None) == (output is None):
        raise UsageError("choose where to write: either --corpus DIR or --output DIR")
    try:
        found = list(writer.generate(count, seed))
        if corpus is not None:
            fresh = _into_corpus(corpus, found, {"family": family, "seed": seed})
            then = f"envcraft audit {corpus}"
        else:
            assert output is not None
            fresh = _into_folder(output, found)
            then = f"envcraft validate {output}"
    except KeyboardInterrupt:
        click.echo("nothing was written", err=True)
        raise
    click.echo(f"wrote {fresh:,}, kept {len(found) - fresh:,} that exist; validate them with `{then}`")


def _into_corpus(place: Path, found: list[Generated], origin: dict[str, object]) -> int:
    """Add environments with their metadata, all or none; return the number of new ones. Raises UsageError."""
    from envcraft.corpus.store import Store, environments, is_corpus

    with Store(place, write=True) if is_corpus(place) else Store.create(place) as store:
        if store.follows_folder:
            raise UsageError(
                f"{place} follows a folder; generate into that folder with --output, or into another corpus"
            )
        known = {one.name: one.source for one in environments.every(store)}
        for one in found:
            if one.name + ".py" in known and known[one.name + ".py"] != hashlib.sha256(one.source.encode()).hexdigest():
                raise _taken(f"{one.name}.py", place)
        try:
            with store.transaction():
                return sum(
                    store.add(f"{one.name}.py", one.source.encode(), origin={**origin, **one.metadata}) for one in found
                )
        except OSError as error:
            raise UsageError(f"{place} cannot be written: {error.strerror or error}") from None


def _into_folder(folder: Path, found: list[Generated]) -> int:
    """Write files, all or none; return the number of new ones. Raises UsageError."""
    begun: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        missing = [one for one in found if not (folder / f"{one.name}.py").exists()]
        wanted = {one.name for one in missing}
        for one in found:
            if one.name not in wanted and (folder / f"{one.name}.py").read_bytes() != one.source.encode():
                raise _taken(f"{one.name}.py", folder)
        for one in missing:
            begun.append(folder / f"{one.name}.py")
            begun[-1].write_bytes(one.source.encode())
    except BaseException as error:
        # A file that is cut short would be another source to the next run.
        for path in begun:
            path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise UsageError(f"{error.filename or folder} cannot be written: {error.strerror or error}") from None
        raise
    return len(missing)


def _taken(name: str, place: Path) -> UsageError:
    return UsageError(f"{name} is another source in {place}, and nothing was written; choose another place or --seed")
