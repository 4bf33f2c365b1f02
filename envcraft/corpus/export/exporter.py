"""The interface of export formats. An :class:`Exporter` writes an :class:`Order` to a folder."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import EnvCraftError, UsageError
from envcraft.files import refuse_file
from envcraft.registry import lookup, offered

if TYPE_CHECKING:
    from envcraft.corpus.store import Store
    from envcraft.corpus.store.verdicts import Last


@dataclass(frozen=True)
class Exported:
    """An environment with the last verdict on its present source, and the settings of that verdict.

    `env_class` is empty unless the source has several classes. The fields after `origin` are None if there is no
    verdict; `report` is the verdict as JSON.
    """

    name: str
    source: str
    env_class: str
    origin: dict[str, Any]
    verdict: str | None
    report: str | None
    contract: str | None
    contract_sha256: str | None
    rules: str | None
    seed: int | None
    budget: str | None
    driver: str | None
    image: str | None

    @property
    def undecided(self) -> list[str]:
        """The checks of a pass that left their questions open."""
        from envcraft.corpus.store import decode

        return decode(self.report).undecided if self.verdict == "pass" and self.report else []

    @property
    def public(self) -> dict[str, Any]:
        """The origin without the path of the file that was added, which is private."""
        return {key: value for key, value in self.origin.items() if key != "file"}


@dataclass(frozen=True)
class Order:
    """What to export.

    Attributes:
        store: the corpus.
        output: the folder to create.
        name: the name of the export; None for that of the corpus.
        everything: whether to include environments that have not passed (:mod:`envcraft.corpus.trust`).
        licence: the licence of the sources; None to take it from the corpus.
    """

    store: Store
    output: Path
    name: str | None = None
    everything: bool = False
    licence: str | None = None

    @property
    def title(self) -> str:
        """The name of the corpus: that of its folder, or of the folder that it follows."""
        root = self.store.root.resolve()
        return root.parent.name if root.name.startswith(".") else root.name

    def environments(self) -> Iterator[Exported]:
        """The environments to export, sorted by name. Every name is a path inside the export folder.

        An environment that was judged with other files of its project is left out: a corpus does not hold these files.

        Raises:
            CorpusDamaged: if a name leads out of the folder.
        """
        for row in self._rows():
            name, source, env_class = row.environment
            if _leaves(name):
                raise self._invalid_name(name)
            judged = (None,) * 7 if row.settings is None else msgspec.structs.astuple(row.settings)[:7]
            if not _has_project(row):
                yield Exported(name, source, env_class, row.origin, row.verdict, row.report, *judged)

    @property
    def left_out(self) -> int:
        """The number of environments that need other files of their projects, and are not exported."""
        return sum(_has_project(row) for row in self._rows())

    def _rows(self) -> Iterator[Last]:
        from envcraft.corpus.store import verdicts

        return verdicts.last(self.store, passed=not self.everything)

    def nothing(self) -> UsageError:
        """The error for an exporter that has no environment to export."""
        root = self.store.root
        if left_out := self.left_out:
            return UsageError(
                f"the environments of {root} that have passed ({left_out:,}) need other files of their projects, and "
                "an export holds single files: put the project into a package of its own"
            )
        return UsageError(
            f"no environment of {root} has passed all checks: `envcraft audit {root}` judges them, and --all also "
            "exports the others"
        )

    def _invalid_name(self, name: str) -> EnvCraftError:
        from envcraft.corpus.store import CorpusDamaged

        root = self.store.root
        repair = f"audit {root.parent}" if self.store.follows_folder else f"corpus rm {root} -- {shlex.quote(name)}"
        return CorpusDamaged(
            f"the environment name {name!r} in {root} leads out of the folder that it is exported to; "
            f"`envcraft {repair}` removes it"
        )


def _has_project(row: Last) -> bool:
    from envcraft.corpus.store import decode

    return row.report is not None and decode(row.report).project is not None


def _leaves(name: str) -> bool:
    """Whether a name, used as a path, may lead out of its folder, here or on Windows."""
    first, *others = re.split(r"[/\\]", name)
    return not first or re.fullmatch("[A-Za-z]:", first) is not None or ".." in (first, *others) or "\0" in name


class Exporter(ABC):
    """Writes a corpus in one format.

    Attributes:
        name: the value of ``--to``.
        summary: one line for the help.
    """

    name: str
    summary: str

    @abstractmethod
    def export(self, order: Order) -> list[str]:
        """Create the folder.

        Args:
            order: what to export.

        Returns:
            Lines that tell the user what to do with the folder.

        Raises:
            UsageError: if the request cannot be met.
            EnvCraftError: if the folder cannot be written.
        """


@contextlib.contextmanager
def fresh_folder(output: Path) -> Iterator[Path]:
    """Create an empty folder that is renamed to `output` when the block ends without an exception.

    Raises:
        UsageError: if `output` is a file, is not empty or cannot be created.
        EnvCraftError: if it cannot be filled.
    """
    refuse_file(output)
    try:
        if output.exists() and any(output.iterdir()):
            raise UsageError(f"{output} is not empty; name a new or empty folder")
        output.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{output.name}-", dir=output.parent))
    except OSError as error:
        raise UsageError(f"cannot write {output}: {error.strerror or error}") from None
    try:
        yield made
        made.chmod(0o755)
        if not output.is_dir():
            os.replace(made, output)
            return
        # The folder stays, since it may be a link or a working directory.
        for entry in list(made.iterdir()):
            os.replace(entry, output / entry.name)
    except OSError as error:
        raise EnvCraftError(f"cannot write {output}: {error.strerror or error}") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def exporter_named(name: str) -> Exporter:
    """Return the exporter with this name.

    Raises:
        UsageError: if there is none; the message names the nearest.
    """
    known = {exporter.name: exporter for exporter in offered("envcraft_exporters")}
    exporter: Exporter = lookup("export format", name, known)
    return exporter
