"""``envcraft corpus report``, and what ``envcraft audit --report`` does when it has judged."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import click

from envcraft.cli import Sharing
from envcraft.commands.choices import MOST_WORKERS, all_checks, contract_named, driver_named, runtime_option
from envcraft.contract import Contract
from envcraft.corpus.report.swap import usable
from envcraft.corpus.store import BESIDE, Store, opened
from envcraft.errors import UsageError
from envcraft.reports import one_line, plural
from envcraft.sandbox import Driver

_NEEDED = ("jinja2", "matplotlib")


@click.command(cls=Sharing)
@click.argument("corpus", metavar="CORPUS|FOLDER", type=click.Path(path_type=Path))
@click.option("--output", metavar="DIR", required=True, type=click.Path(path_type=Path), help="The report's folder.")
@click.option(
    "--previews/--no-previews",
    default=True,
    show_default=True,
    help="Play a little of each environment that has no picture yet.",
)
@click.option("--sandbox", default="auto", show_default=True, metavar="NAME", help="Where they are played.")
@runtime_option
@click.option(
    "--workers", type=click.IntRange(1, MOST_WORKERS), show_default="as many as cores", help="Played side by side."
)
def report(corpus: Path, output: Path, previews: bool, sandbox: str, runtime: str | None, workers: int | None) -> None:
    """Write the last verdicts on a corpus as a site of files, with tables for other programs. Nothing is judged."""
    ready(output)
    with contextlib.ExitStack() as stack:
        driver = None
        if previews:
            driver = driver_named(sandbox, runtime=runtime)
            stack.callback(driver.close)
        store = stack.enter_context(opened(corpus, previews))
        write(store, output, followed(store), _contract(store) if previews else None, driver, workers)


def followed(store: Store) -> str:
    """The folder whose files a corpus has, or ""."""
    return str(store.root.parent) if store.follows_folder and store.root.name == BESIDE else ""


def ready(output: Path) -> None:
    """Raises UsageError where a report cannot be written, before anything has taken time."""
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(
            f"a report needs {' and '.join(missing)}; install what it needs with `pip install 'envcraft-rl[report]'`"
        )
    usable(output)


def write(
    store: Store, output: Path, files: str, contract: Contract | None, driver: Driver | None, workers: int | None
) -> None:
    """Write the report on `store`; with a contract and a driver, make the pictures that lack first, each under the
    contract that it was judged under, and under `contract` what was not. `files` is the folder that the store follows.
    Raises UsageError, CorpusDamaged.
    """
    from envcraft.corpus.likeness import LAYERS
    from envcraft.corpus.report import media
    from envcraft.corpus.report.alike import compared
    from envcraft.corpus.report.site import build

    notes: list[str] = []
    if len(compared()) < len(LAYERS):
        notes.append("Near-duplicates are not looked for: that needs rensa, with `pip install 'envcraft-rl[report]'`.")
    if contract is not None and driver is not None:
        if media.pillow() is None:
            notes.append("No pictures: they need Pillow, with `pip install 'envcraft-rl[report]'`.")
        else:
            made = [
                media.make(store, promised, contract.name, driver, workers)
                for promised in promised_in(store, contract, notes)
            ]
            if any(made):
                click.echo(f"{plural(sum(made), 'environment')} played for pictures", err=True)
    for note in notes:
        click.echo(note, err=True)
    survey = build(store, output, all_checks(), files, notes)
    click.echo(f"{output / 'index.html'}: {plural(survey.total, 'environment')}", err=True)


def _contract(store: Store) -> Contract:
    """The contract that most of the last verdicts were given under, of those that are known here."""
    for name in _judged_under(store):
        with contextlib.suppress(UsageError):
            return contract_named(name)
    return contract_named("arcade")


def promised_in(store: Store, contract: Contract, notes: list[str]) -> Iterator[Contract]:
    """This one, and the others that last verdicts were given under; of those that are not known here, a note."""
    yield contract
    for name, count in _judged_under(store).items():
        if name == contract.name:
            continue
        try:
            yield contract_named(name)
        except UsageError as error:
            notes.append(f"No new pictures of {plural(count, 'environment')}: {one_line(error)}.")


def _judged_under(store: Store) -> dict[str, int]:
    """How many of the last verdicts were given under each contract, the commonest first."""
    rows = store.db.execute(
        "SELECT contract, count(*) FROM environments JOIN verdicts ON verdicts.id = environments.verdict "
        "JOIN settings ON settings.id = verdicts.settings GROUP BY contract ORDER BY count(*) DESC, contract"
    )
    return dict(rows.fetchall())
