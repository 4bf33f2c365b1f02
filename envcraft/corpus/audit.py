"""One audit: which environments it selects, which of them have a verdict already, and the judging of the others.

Data that grows with the corpus stays in the database or is read row by row. Only the names of the environments to judge
are in memory.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence

import msgspec

from envcraft.corpus.shared import Shared, shared_codes
from envcraft.corpus.store import FOLDER_CORPUS, CorpusDamaged, Environment, Store, audits, decode, environments
from envcraft.corpus.store.audits import FindingRow, Projects, Selection
from envcraft.errors import EnvCraftError, TargetLost, UsageError
from envcraft.judging.selection import all_checks
from envcraft.model.events import Event, SubjectFinished
from envcraft.model.project import with_project
from envcraft.model.target import LazyTargets, Target
from envcraft.model.verdict import Outcome, SubjectReport, Verdict


def stored_targets(store: Store, environments: Sequence[Environment], folder: str = "") -> LazyTargets[Environment]:
    """Environments of a corpus as targets. Those of a folder have the files of their projects.

    Args:
        store: the corpus.
        environments: the environments in order.
        folder: the folder that paths start with.

    Returns:
        The targets. Reading one raises TargetLost if its source is missing or has changed.
    """
    return LazyTargets(environments, stored_reader(store, folder))


def stored_reader(store: Store, folder: str = "") -> Callable[[Environment], Target]:
    """Return the function that :func:`stored_targets` reads targets with. Any thread may call it."""
    beside = store.root.parent if store.root.name == FOLDER_CORPUS and store.follows_folder else None
    place = folder or beside

    def read(environment: Environment) -> Target:
        name, source, env_class = environment
        path = os.path.join(folder, name)
        try:
            target = Target(path, store.source(source), env_class or None)
        except CorpusDamaged as error:
            raise TargetLost(path, env_class or None, source, str(error)) from None
        if place is None:
            return target
        file = msgspec.structs.replace(target, path=os.path.join(place, name))
        return msgspec.structs.replace(with_project(file), path=path)

    return read


class Audit:
    """An audit of a corpus, which is inserted into the store when this object is made.

    Args:
        store: the corpus, open for writing.
        settings: the row number of the settings.
        selection: which environments.
        folder: the folder that paths in reports start with.
        resume: whether to keep the settled verdicts that exist; otherwise all selected environments are judged.
        complete: whether verdicts that ended at the first error are not settled.
        projects: for a folder, what :func:`follow` found. Verdicts with other files of a project are deleted.

    Attributes:
        number: the row number of the audit.
        selected: how many environments are selected.
        pending: the environments to judge: one for each source and class.
        judged: how many environments were to be judged, in all stages.
        kept: the reports on environments that could not be judged again; their earlier verdicts stay.
    """

    def __init__(
        self,
        store: Store,
        settings: int,
        selection: Selection,
        folder: str = "",
        resume: bool = True,
        complete: bool = False,
        projects: Projects | None = None,
    ) -> None:
        self.store, self.settings, self.selection, self.folder = store, settings, selection, folder
        self.kept: list[SubjectReport] = []
        self._projects = projects
        outdated = self._outdated()
        self.selected, self._whole = audits.select(store, selection, settings)
        audits.forget(store, outdated)
        self._resume, self._complete = resume, complete
        self.judged = 0
        self._start(self.selected)

    def _outdated(self) -> list[int]:
        return [] if self._projects is None else audits.outdated(self.store, self.settings, self._projects)

    def _start(self, selected: int) -> None:
        self.pending = audits.pending(self.store, self.settings, not self._resume, self._complete)
        self.judged += len(self.pending)
        known = selected - len(self.pending)
        self.number = audits.start(self.store, self.settings, selected, known, self._whole)

    def advance(self, settings: int) -> int:
        """Go on with the environments that pass, under other settings: their verdicts count from now on.

        Args:
            settings: the row number of the other settings.

        Returns:
            The number of these environments.
        """
        self.end()
        selected = audits.advance(self.store, self.settings, settings)
        self.settings = settings
        audits.forget(self.store, self._outdated())
        self._start(selected)
        return selected

    @property
    def known(self) -> int:
        """How many environments had a verdict already, or share one that was pending."""
        return max(self.selected - self.judged, 0)

    @property
    def targets(self) -> LazyTargets[Environment]:
        """The pending environments as targets."""
        return stored_targets(self.store, self.pending, self.folder)

    def run(self, judging: Generator[tuple[int, Event], None, None], report: Callable[[Event], None]) -> None:
        """Store the verdicts on the pending environments.

        Args:
            judging: events, each with the number of its environment, from 1. It is closed at the end.
            report: called with each event after its verdict is stored.

        Raises:
            Exception: the judging failed.
        """
        with contextlib.closing(judging) as events:
            for number, event in events:
                if isinstance(event, SubjectFinished) and not self.store.record(
                    self.pending[number - 1], self.settings, event.report
                ):
                    self.kept.append(event.report)
                report(event)

    def end(self) -> None:
        """Store that the audit is complete."""
        audits.end(self.store, self.number)

    def reports(self) -> Iterator[SubjectReport]:
        """The verdicts on all selected environments, sorted by name, each with the path of its environment."""
        for name, text in audits.reports(self.store):
            yield msgspec.structs.replace(decode(text), path=self.path(name))

    def report(self, name: str) -> SubjectReport | None:
        """The verdict on one environment; None if there is none."""
        text = audits.report(self.store, name)
        return None if text is None else decode(text)

    def findings(self) -> Iterator[FindingRow]:
        """The findings of all selected environments, sorted by name; names are paths."""
        for row in audits.findings(self.store):
            yield row._replace(name=self.path(row.name))

    def verdicts(self) -> dict[str, int]:
        """The number of environments with each verdict that occurs."""
        counts = audits.verdict_counts(self.store)
        return {verdict.value: counts[verdict] for verdict in Verdict if verdict in counts}

    def outcomes(self) -> dict[Outcome, int]:
        """The number of environments with each outcome that occurs: the verdicts, with the undecided ones apart."""
        counts = {Outcome(verdict): count for verdict, count in self.verdicts().items()}
        if undecided := audits.undecided(self.store):
            counts |= {Outcome.PASS: counts[Outcome.PASS] - undecided, Outcome.UNDECIDED: undecided}
        return {outcome: counts[outcome] for outcome in Outcome if counts.get(outcome)}

    def undecided(self) -> dict[str, int]:
        """The number of environments that each check left undecided, the most frequent check first."""
        return audits.undecided_checks(self.store)

    def codes(self) -> dict[str, int]:
        """The number of environments with each code, the most frequent code first."""
        return audits.code_counts(self.store)

    def warning_codes(self) -> set[str]:
        """The codes that the environments have as warnings only."""
        return audits.warning_codes(self.store)

    def shared(self) -> list[Shared]:
        """The codes that nearly all of the environments have that pass or fail."""
        verdicts = self.verdicts()
        return shared_codes(self.codes(), verdicts.get("pass", 0) + verdicts.get("fail", 0), all_checks())

    def totals(self) -> tuple[int, float]:
        """The environment steps and the seconds of all verdicts, including those of earlier audits."""
        return audits.totals(self.store)

    def out_of_time(self) -> int:
        """The number of environments whose verdict the clock decided. The next audit judges them again."""
        return audits.out_of_time(self.store)

    def path(self, name: str) -> str:
        """The path of an environment in reports."""
        return os.path.join(self.folder, name)

    def name(self, path: str) -> str | None:
        """The name of the selected environment with this path in reports; None if there is none."""
        name = os.path.relpath(path, self.folder) if self.folder else path
        return name if audits.is_selected(self.store, name) else None


def follow(store: Store, files: Iterable[tuple[str, Target]], with_projects: bool = False) -> Projects:
    """Make the environments of a corpus those of a folder. The verdicts on removed environments stay.

    Args:
        store: the corpus of the folder, open for writing.
        files: the names and targets of the folder's environments.
        with_projects: whether environments are judged with the files of their projects.

    Returns:
        These files of each environment that has some, if `with_projects`.

    Raises:
        UsageError: if environments have one text and different files of their projects.
        EnvCraftError: if a source cannot be written.
    """
    found: dict[tuple[str, str], dict[str, str]] = {}
    names: dict[tuple[str, str], list[str]] = {}

    def added() -> Iterator[str]:
        for name, target in files:
            try:
                store.add(name, target.source, target.env_class or "")
            except OSError as error:
                raise EnvCraftError(f"cannot copy {target.path} to {store.root}: {error.strerror}") from None
            if with_projects and target.project is not None:
                key = (target.sha256, target.env_class or "")
                names.setdefault(key, []).append(name)
                if found.setdefault(key, target.project.digests) != target.project.digests:
                    raise _ambiguous(names[key])
            yield name

    with store.transaction():
        audits.replace_environments(store, added())
        for (source, env_class), named in names.items():
            if len(every := environments.names_of(store, source, env_class)) != len(named):
                raise _ambiguous(every)
    store.prune()
    return found


def _ambiguous(names: list[str]) -> UsageError:
    return UsageError(
        f"{names[0]} and {names[-1]} have the same text and import different files, but an audit has one verdict for "
        "one text: change one of them, or audit their folders one by one"
    )
