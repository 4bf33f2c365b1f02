"""What ``envcraft export`` makes of a corpus: each form is a plugin that gives an :class:`Exporter`, and one file."""

from __future__ import annotations

import contextlib
import json
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

from envcraft.errors import EnvCraftError, UsageError

if TYPE_CHECKING:
    from envcraft.corpus.store import Store


@dataclass(frozen=True)
class Exported:
    """An environment with the last verdict on its present source, and the settings under which that was given.

    `env_class` is empty unless the file has several; what follows `origin` is None where there is no verdict, `report`
    the verdict's as JSON.
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
    def public(self) -> dict[str, Any]:
        """The origin, but for where the file lay, which is nobody's business."""
        return {key: value for key, value in self.origin.items() if key != "file"}


@dataclass(frozen=True)
class Order:
    """What is to be exported.

    Attributes:
        store: the corpus, open for reading.
        output: the folder to make.
        name: what the export is called, as the user said.
        everything: also what has not passed (:mod:`envcraft.corpus.trust`).
        licence: what the user says the sources are licensed under.
    """

    store: Store
    output: Path
    name: str | None = None
    everything: bool = False
    licence: str | None = None

    @property
    def title(self) -> str:
        """What the corpus is called: as its folder, or the folder whose files it has."""
        root = self.store.root.resolve()
        return root.parent.name if root.name.startswith(".") else root.name

    def environments(self) -> Iterator[Exported]:
        """Those to export, in the order of their names, each of which is a path that stays in its folder.

        Raises CorpusDamaged where one does not.
        """
        from envcraft.corpus.trust import PASSED

        wanted = "1" if self.everything else PASSED
        rows = self.store.db.execute(
            "SELECT name, environments.source, environments.class, origin, verdicts.verdict, report, contract, "
            "contract_sha256, rules, seed, budget, driver, image FROM environments "
            "LEFT JOIN verdicts ON verdicts.id = environments.verdict AND verdicts.source = environments.source "
            "AND verdicts.class = environments.class LEFT JOIN settings ON settings.id = verdicts.settings "
            f"WHERE {wanted} ORDER BY name"
        )
        for name, source, env_class, origin, *judged in rows:
            if _leaves(name):
                raise self._astray(name)
            yield Exported(name, source, env_class, json.loads(origin), *judged)

    def nothing(self) -> UsageError:
        """For an exporter that found nothing to export."""
        root = self.store.root
        return UsageError(
            f"{root} has no environment that passes all checks: `envcraft audit {root}` judges them, and --all "
            "exports what has not passed, too"
        )

    def _astray(self, name: str) -> EnvCraftError:
        from envcraft.corpus.store import CorpusDamaged

        root = self.store.root
        mend = f"audit {root.parent}" if self.store.follows_folder else f"corpus rm {root} -- {shlex.quote(name)}"
        return CorpusDamaged(
            f"{root} has an environment called {name!r}, which leads out of any folder that it is written to; "
            f"`envcraft {mend}` removes it"
        )


def _leaves(name: str) -> bool:
    """Whether a name, taken for a path, may lead out of the folder that it is put into, here or on Windows."""
    first, *others = re.split(r"[/\\]", name)
    return not first or re.fullmatch("[A-Za-z]:", first) is not None or ".." in (first, *others) or "\0" in name


class Exporter(ABC):
    """Writes a corpus in one form.

    Attributes:
        name: how ``--to`` names it.
        summary: one line for the help.
    """

    name: str
    summary: str

    @abstractmethod
    def export(self, order: Order) -> list[str]:
        """Make the folder; give lines that say what to do with it. Raises UsageError, EnvCraftError."""


@contextlib.contextmanager
def fresh_folder(output: Path) -> Iterator[Path]:
    """A folder that gets the name `output` once it is whole. Raises UsageError where that is taken, or there can be no
    such folder, EnvCraftError where it cannot be filled.
    """
    try:
        if output.exists() and (not output.is_dir() or any(output.iterdir())):
            raise UsageError(f"{output} exists and is not empty; name a folder that is new or empty")
        output.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{output.name}-", dir=output.parent))
    except OSError as error:
        raise UsageError(f"{output} cannot be written: {error.strerror or error}") from None
    try:
        yield made
        made.chmod(0o755)
        if not output.is_dir():
            os.replace(made, output)
            return
        # Perhaps a link, or the folder that somebody stands in.
        for entry in list(made.iterdir()):
            os.replace(entry, output / entry.name)
    except OSError as error:
        raise EnvCraftError(f"{output} cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(made, ignore_errors=True)
