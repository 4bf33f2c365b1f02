"""Writing the report on a corpus: the requirements, the previews that are missing, then the site."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from envcraft.contracts.lookup import contract_named
from envcraft.corpus.deduplication import LAYERS
from envcraft.corpus.report import media
from envcraft.corpus.report.duplicates import available_layers
from envcraft.corpus.report.output import check_usable
from envcraft.corpus.report.results import ResultRow
from envcraft.corpus.report.site import Episodes, build
from envcraft.corpus.store import FOLDER_CORPUS, Store, verdicts
from envcraft.errors import UsageError
from envcraft.judging.driver import Driver
from envcraft.judging.selection import all_checks
from envcraft.model.contract import Contract
from envcraft.text import one_line, plural

_REQUIRED = ("jinja2", "matplotlib")


def followed_folder(store: Store) -> str:
    """The folder whose files a corpus follows; empty if it follows none."""
    return str(store.root.parent) if store.follows_folder and store.root.name == FOLDER_CORPUS else ""


def check_requirements(output: Path) -> None:
    """Check whether a report can be written, before anything takes time.

    Raises:
        UsageError: if a package is missing or `output` cannot be replaced.
    """
    missing = [name for name in _REQUIRED if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(f"a report needs {' and '.join(missing)}: `pip install 'envcraft-rl[report]'`")
    check_usable(output)


def write_report(
    store: Store,
    output: Path,
    files: str,
    contract: Contract | None = None,
    driver: Driver | None = None,
    workers: int | None = None,
    message: Callable[[str], None] = lambda text: None,
    live: bool = False,
    episodes: Episodes | None = None,
    results: Sequence[ResultRow] = (),
) -> None:
    """Write the report on a corpus.

    Args:
        store: the corpus.
        output: the folder to write or replace.
        files: the folder that the corpus follows; empty if it follows none.
        contract: the contract of environments without a verdict, for previews; None to make no previews.
        driver: the sandbox driver for previews; None to make no previews.
        workers: how many previews to make at the same time; None for as many as there are cores.
        message: called with each line for the user.
        live: as for :class:`envcraft.corpus.report.site.Site`.
        episodes: as for :class:`envcraft.corpus.report.site.Site`.
        results: of training, for the first page.

    Raises:
        UsageError: if the report cannot be written.
        CorpusDamaged: if the corpus is damaged.
    """
    notes: list[str] = []
    if len(available_layers()) < len(LAYERS):
        notes.append("Near-duplicates are missing: rensa is not installed (`pip install 'envcraft-rl[report]'`).")
    if contract is not None and driver is not None:
        if media.pillow() is None:
            notes.append("Previews are missing: this Pillow cannot write WebP.")
        else:
            made = [
                media.make(store, one, contract.name, driver, workers, message)
                for one in preview_contracts(store, contract, notes)
            ]
            if any(made):
                message(f"{plural(sum(made), 'environment')} played for previews")
    for note in notes:
        message(note)
    survey = build(store, output, all_checks(), files, notes, live, episodes, results)
    # The pages of a server are read through its address.
    if not live:
        message(f"{output / 'index.html'}: {plural(survey.total, 'environment')}")


def default_contract(store: Store) -> Contract:
    """The contract of most last verdicts, of those that are installed; ``arcade`` if there is none."""
    for name in verdicts.contracts(store):
        with contextlib.suppress(UsageError):
            return contract_named(name)
    return contract_named("arcade")


def preview_contracts(store: Store, contract: Contract, notes: list[str]) -> Iterator[Contract]:
    """Yield `contract` and the other contracts of last verdicts; append a note for each that is not installed."""
    yield contract
    for name, count in verdicts.contracts(store).items():
        if name == contract.name:
            continue
        try:
            yield contract_named(name)
        except UsageError as error:
            notes.append(f"Previews of {plural(count, 'environment')} are missing: {one_line(error)}.")
