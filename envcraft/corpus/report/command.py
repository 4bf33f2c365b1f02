"""``envcraft corpus report``, and what ``envcraft audit --report`` does when it has judged."""

from __future__ import annotations

import contextlib
import importlib.util
from pathlib import Path

import click

from envcraft.cli import Sharing
from envcraft.commands.choices import all_checks, contract_named, driver_named, runtime_option
from envcraft.contract import Contract
from envcraft.corpus.report.swap import usable
from envcraft.corpus.store import BESIDE, Store, opened
from envcraft.errors import UsageError
from envcraft.reports import plural
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
@click.option("--workers", type=click.IntRange(1, 64), show_default="as many as cores", help="Played side by side.")
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
    """Write the report on `store`; with a contract and a driver, make the pictures that lack first. `files` is the
    folder that the store follows. Raises UsageError, CorpusDamaged.
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
        elif played := media.make(store, contract, driver, workers):
            click.echo(f"{plural(played, 'environment')} played for pictures", err=True)
    for note in notes:
        click.echo(note, err=True)
    survey = build(store, output, all_checks(), files, notes)
    click.echo(f"{output / 'index.html'}: {plural(survey.total, 'environment')}", err=True)


def _contract(store: Store) -> Contract:
    """The contract that most of the last verdicts were given under."""
    row = store.db.execute(
        "SELECT contract FROM environments JOIN verdicts ON verdicts.id = environments.verdict "
        "JOIN settings ON settings.id = verdicts.settings GROUP BY contract ORDER BY count(*) DESC, contract LIMIT 1"
    ).fetchone()
    return contract_named(row[0] if row else "arcade")
