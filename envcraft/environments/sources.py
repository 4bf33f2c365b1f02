"""Finds an environment's source and verdict, and decides whether its code may run in this process."""

from __future__ import annotations

import contextlib
import itertools
import os
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import msgspec

from envcraft.config import settings
from envcraft.contracts.lookup import contract_named
from envcraft.corpus.store import FOLDER_CORPUS, CorpusDamaged, Store, decode, environments, find, is_corpus
from envcraft.corpus.store.environments import EnvironmentRow
from envcraft.corpus.trust import contract_of, last_verdicts
from envcraft.errors import UsageError
from envcraft.judging.settings import contract_digest
from envcraft.judging.verdict_cache import CachedVerdict, cached, last_contract
from envcraft.model.contract import Contract
from envcraft.model.project import with_project
from envcraft.model.target import Kind, Project, kind_of, read_target
from envcraft.model.verdict import SubjectReport, Verdict, plain

#: The environment variable that names a corpus.
VARIABLE = "ENVCRAFT_CORPUS"
_DEFAULT = "arcade"
_NO_VERDICT = "has no verdict"
_SANDBOX, _TRUST = "sandbox='auto'", "trust=True"
_SANDBOXED = f"{_SANDBOX} runs it in a sandbox"


class Untrusted(UsageError):
    """No verdict and no argument allows an environment's code to run in this process."""

    @property
    def in_a_command(self) -> str:
        return str(self).replace(_SANDBOX, "--sandbox auto").replace(_TRUST, "--trust")


class EnvSource(msgspec.Struct, frozen=True):
    """The source of one environment, and what a corpus says about it.

    Attributes:
        name: What messages call it.
        path: The file with the source.
        source: The file's bytes.
        sha256: Their SHA-256.
        env_class: The class to construct; None for a file that has exactly one.
        contract: Its contract.
        verdict: The last verdict on this source under this contract; None if there is none.
        doubt: Why that is no pass that counts; empty if it is one.
        folder: The folder or corpus to audit for a verdict.
        audited: Whether `folder` is a corpus or has been audited.
        entry: Its name in the corpus that has the verdict.
        origin: Where it comes from, as the corpus says.
        project: The files of its project that it needs; None if it needs none.
    """

    name: str
    path: str
    source: bytes
    sha256: str
    env_class: str | None
    contract: Contract
    verdict: Verdict | None
    doubt: str
    folder: str
    entry: str = ""
    origin: dict[str, Any] = {}
    project: Project | None = None
    audited: bool = True

    def ensure_trusted(self) -> None:
        """Raises Untrusted, with the next step, unless the environment has passed."""
        if not self.doubt:
            return
        contract = self.contract.name
        option = "" if contract == _DEFAULT else f" --contract {contract}"
        # A file of no audited folder needs no audit of the whole folder.
        command = f"audit {self.folder}" if self.audited else f"validate {self.name}"
        step = f"`envcraft {command}{option}` judges it"
        if not option and not self.audited:
            step += " (with --contract NAME, if it is made for another contract)"
        if self.verdict is Verdict.FAIL:
            shown = f"corpus show {self.folder} {self.entry}" if self.entry else f"validate {self.path}{option}"
            step = f"`envcraft {shown}` says why"
        if self.project is not None and self.project.modules:
            raise Untrusted(
                f"{self.name} imports files of its project, and only single files that have passed run in your own "
                f"process: import its class yourself, or {_SANDBOXED}"
            )
        raise Untrusted(
            f"{self.name} {self.doubt} under the contract {contract}, and only what has passed runs in your own "
            f"process: {step}, {_SANDBOXED}, and {_TRUST} runs it here anyway"
        )


def default_corpus() -> Path | None:
    """The corpus that ENVCRAFT_CORPUS names, else ``corpus`` in ``[tool.envcraft]``, else None. Raises UsageError."""
    if named := os.environ.get(VARIABLE):
        return Path(named)
    path, table = settings(Path.cwd())
    value = table.get("corpus")
    if value is None:
        return None
    if not isinstance(value, str):
        raise UsageError(f"{path}: corpus must be the path of a corpus, not {value!r}")
    return path.parent / value


def needed_corpus(corpus: str | os.PathLike[str] | None) -> Path:
    """The root of `corpus`, or of the default corpus. Raises UsageError if there is none."""
    if corpus is None and (corpus := default_corpus()) is None:
        raise UsageError(
            f"no corpus is named: give its path, set {VARIABLE}, or set corpus in [tool.envcraft] of pyproject.toml"
        )
    return find(Path(corpus)).resolve()


def names(corpus: str | os.PathLike[str] | None = None, pattern: str = "*") -> list[str]:
    """The names of a corpus's environments that match a shell pattern, independent of their verdicts.

    Args:
        corpus: The corpus; by default the one that ENVCRAFT_CORPUS or ``corpus`` in ``[tool.envcraft]`` names.
        pattern: The pattern; the ``.py`` at the end of a name is optional.

    Returns:
        The names, sorted.

    Raises:
        UsageError: There is no corpus.
    """
    with Store(needed_corpus(corpus)) as store:
        every = environments.names(store)
    return [one for one in every if fnmatchcase(one, pattern) or fnmatchcase(one.removesuffix(".py"), pattern)]


def resolve(target: str | os.PathLike[str], name: str | None = None, contract: str | None = None) -> EnvSource:
    """Find the environment `name` of the corpus `target`, or the one in the file `target`.

    Args:
        target: A corpus, a folder that was audited, or a Python file.
        name: An environment of the corpus; optional if the corpus has exactly one.
        contract: The contract; by default the one under which the environment has passed, the last of several, else
            that of its last verdict, else ``arcade``.

    Returns:
        The source, with its last verdict under the contract.

    Raises:
        UsageError: There is no such environment or contract.
        CorpusDamaged: The corpus cannot be read.
    """
    if not isinstance(target, str | os.PathLike):
        kind = target if isinstance(target, type) else type(target)
        words = "a file, or an environment of a corpus; to construct an instance of a class, call the class"
        raise UsageError(f"{kind.__name__} is a Python object, and envcraft.make takes {words}")
    path = Path(target)
    if path.is_file() or path.suffix == ".py":
        if name is not None:
            raise UsageError(f"{path} is a file, and has no environment {name}: name a corpus, or leave {name} out")
        return _of_file(path, contract)
    if not path.exists() and kind_of(str(target)) is Kind.ID:
        words = "envcraft.make takes a file or an environment of a corpus, and gymnasium.make makes a registered one"
        raise UsageError(f"{target} is an id; {words}")
    root = find(path)
    with Store(root) as store:
        (name, sha256, env_class), origin = _row(store, path, name)
        source = store.source(sha256)
        folder = root.parent if root.name == FOLDER_CORPUS else root
        place = str(store.place(sha256))
        project = _project(folder / name, sha256) if store.follows_folder and folder is not root else None
        judged = _judged(store, name, place, source, sha256, env_class, contract, str(folder), project)
        return msgspec.structs.replace(judged, entry=name, origin=origin)


def _project(file: Path, sha256: str) -> Project | None:
    """The files of its project that a file of an audited folder needs, if the file is still as it was judged."""
    try:
        target = read_target(str(file))
    except UsageError:
        return None
    return with_project(target).project if target.sha256 == sha256 else None


def _row(store: Store, path: Path, name: str | None) -> EnvironmentRow:
    """The row of an environment; the ``.py`` at the end of its name is optional."""
    if name is None:
        rows = list(itertools.islice(environments.rows(store), 2))
        if len(rows) == 1:
            return rows[0]
        such = f", such as {rows[0].environment.name}" if rows else ""
        raise UsageError(f"{path} has {'several environments: name one' if rows else 'no environment'}{such}")
    for spelling in (name, f"{name}.py"):
        row = environments.get(store, plain(spelling))
        if row is not None:
            return row
    raise UsageError(f"{path} has no environment {name}; `envcraft corpus list {path}` lists them")


def _of_file(path: Path, contract: str | None) -> EnvSource:
    """A file as it is now, with its verdict in the nearest audited folder above it or from ``envcraft validate``."""
    target = with_project(read_target(str(path)))
    whole = path.resolve()
    for parent in whole.parents:
        if not is_corpus(parent / FOLDER_CORPUS):
            continue
        with Store(parent / FOLDER_CORPUS) as store:
            found = environments.with_source(store, target.sha256, plain(str(whole.relative_to(parent))))
            entry, env_class = (found.name, found.env_class) if found else ("", "")
            found_there = (target.source, target.sha256, env_class, contract, str(parent), target.project)
            judged = _judged(store, str(path), str(whole), *found_there)
            return _validated(msgspec.structs.replace(judged, entry=entry), contract)
    chosen = contract_named(contract or _DEFAULT)
    source = EnvSource(
        str(path), str(whole), target.source, target.sha256, None, chosen, None, _NO_VERDICT, str(whole.parent)
    )
    return _validated(msgspec.structs.replace(source, project=target.project, audited=False), contract)


def _validated(audited: EnvSource, contract: str | None) -> EnvSource:
    """A file with the verdict that ``envcraft validate`` has given, if no audit has, or if that verdict is ``fail``."""
    wanted = audited.contract.name if audited.verdict is not None else contract
    by_contract: dict[str, list[CachedVerdict]] = {}
    for kept in cached(audited.sha256):
        if wanted in (None, kept.settings.contract) and _current(kept, audited.project):
            by_contract.setdefault(kept.settings.contract, []).append(kept)
    if not by_contract:
        return audited if audited.verdict is not None or contract else _as_judged_before(audited)
    failed = {name for name, given in by_contract.items() if any(one.verdict is Verdict.FAIL for one in given)}
    # Another budget or seed does not revoke a finding.
    name = next((name for name in by_contract if name not in failed), next(iter(by_contract)))
    if name in failed:
        verdict, doubt, entry = Verdict.FAIL, f"has the verdict {Verdict.FAIL.value}", ""
    elif audited.verdict is None:
        verdict, doubt, entry = Verdict.PASS, "", audited.entry
    else:
        return audited
    return msgspec.structs.replace(
        audited,
        env_class=audited.env_class or by_contract[name][0].env_class,
        contract=contract_named(name),
        verdict=verdict,
        doubt=doubt,
        entry=entry,
    )


def _as_judged_before(file: EnvSource) -> EnvSource:
    """A file without a verdict that counts, under the contract of the verdict that earlier code has given."""
    with contextlib.suppress(UsageError):
        if name := last_contract(file.sha256):
            return msgspec.structs.replace(file, contract=contract_named(name))
    return file


def _current(kept: CachedVerdict, project: Project | None) -> bool:
    """Whether the contract of a verdict still promises the same, and the files of the project are the same."""
    try:
        contract = contract_named(kept.settings.contract)
    except UsageError:
        return False
    files = project.digests if project is not None and contract.project else {}
    return contract_digest(contract) == kept.settings.contract_sha256 and kept.project == files


def _judged(
    store: Store,
    name: str,
    path: str,
    source: bytes,
    sha256: str,
    env_class: str,
    contract: str | None,
    folder: str,
    project: Project | None = None,
) -> EnvSource:
    """A source and class with what a corpus says about them. Raises CorpusDamaged."""
    last = last_verdicts(store, sha256, env_class)
    chosen = contract_named(contract or contract_of(last) or _DEFAULT)
    given = last.get(chosen.name)
    # A verdict under an earlier version of the contract says nothing about this one.
    if given is None or given.contract_sha256 != contract_digest(chosen):
        found = EnvSource(name, path, source, sha256, env_class or None, chosen, None, _NO_VERDICT, folder)
        return msgspec.structs.replace(found, project=project)
    try:
        report = decode(given.report)
    except msgspec.DecodeError as error:
        raise CorpusDamaged(f"the report on {name} in {store.root} cannot be read: {error}") from None
    doubt = given.doubt or _doubt(report, project, path)
    chosen_class = env_class or report.env_class
    found = EnvSource(name, path, source, sha256, chosen_class, chosen, given.verdict, doubt, folder)
    return msgspec.structs.replace(found, project=project)


def _doubt(report: SubjectReport, project: Project | None, path: str) -> str:
    """Why a pass of a file with others of its project does not count for the file at `path`; empty if it does."""
    if report.project is None:
        return ""
    if any(file.endswith(".py") for file in report.project.files):
        return "has passed together with other files"
    same = project is not None and project.digests == report.project.files
    beside = project is not None and os.path.join(project.root, project.path) == path
    return "" if same and beside else "has passed with data files that are not beside it now, or have changed,"
