"""Which source an environment has, what it was judged to be, and whether its code may run in this process."""

from __future__ import annotations

import json
import os
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import msgspec

from envcraft.contract import Contract, envcraft_contracts
from envcraft.corpus.settings import contract_digest
from envcraft.corpus.store import BESIDE, CorpusDamaged, Store, decode, find, is_corpus
from envcraft.corpus.trust import contract_of, last_verdicts
from envcraft.errors import UsageError
from envcraft.pyproject import settings
from envcraft.target import read_target
from envcraft.verdict import Verdict, plain

#: The environment variable that names a corpus.
VARIABLE = "ENVCRAFT_CORPUS"
_DEFAULT = "arcade"
_NONE = "has no verdict"


class Untrusted(UsageError):
    """Nobody has said that an environment's code may run in this process."""


class Found(msgspec.Struct, frozen=True):
    """An environment, and what is known of it.

    Attributes:
        name: what it is called in messages.
        path: the file that has the source.
        source: the file's bytes.
        sha256: their digest.
        env_class: the class to use; None where the file says that itself, having only one.
        contract: what it promises.
        verdict: the last one on exactly this source under exactly this contract; None where there is none.
        doubt: in words, why that is no pass that counts; empty where it is.
        folder: what to audit, so that there is one.
        entry: its name in the corpus that has the verdict.
        origin: where a corpus says that it comes from.
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

    def ensure_trusted(self) -> None:
        """Raises Untrusted, with the next step, unless it has passed."""
        if not self.doubt:
            return
        contract = self.contract.name
        option = "" if contract == _DEFAULT else f" --contract {contract}"
        step = f"`envcraft audit {self.folder}{option}` judges it"
        if self.verdict is Verdict.FAIL:
            step = f"`envcraft corpus show {self.folder} {self.entry}` says why"
        raise Untrusted(
            f"{self.name} {self.doubt} under the contract {contract}, and only what has passed runs in your own "
            f"process: {step}, sandbox='auto' runs it in a sandbox, and trust=True runs it here all the same"
        )


def default_corpus() -> Path | None:
    """The corpus that ENVCRAFT_CORPUS names, else ``corpus`` in ``[tool.envcraft]``; None where neither does. Raises
    UsageError.
    """
    if named := os.environ.get(VARIABLE):
        return Path(named)
    path, table = settings(Path.cwd())
    told = table.get("corpus")
    if told is None:
        return None
    if not isinstance(told, str):
        raise UsageError(f"{path}: corpus must be the path of a corpus, and is {told!r}")
    return path.parent / told


def needed_corpus(corpus: str | os.PathLike[str] | None) -> Path:
    """The root of `corpus`, or of the default one. Raises UsageError where there is none."""
    if corpus is None and (corpus := default_corpus()) is None:
        raise UsageError(
            f"no corpus is named: give its path, set {VARIABLE}, or set corpus in [tool.envcraft] of pyproject.toml"
        )
    return find(Path(corpus)).resolve()


def names(corpus: str | os.PathLike[str] | None = None, pattern: str = "*") -> list[str]:
    """The names of a corpus's environments that fit a shell pattern, in order, whatever was judged of them.

    Without `corpus` it is the one that ENVCRAFT_CORPUS names, or ``corpus`` in ``[tool.envcraft]``. The ``.py`` at the
    end of a name may be left out of the pattern. Raises UsageError where there is no corpus.
    """
    with Store(needed_corpus(corpus)) as store:
        found = [str(name) for (name,) in store.db.execute("SELECT name FROM environments ORDER BY name")]
    return [one for one in found if fnmatchcase(one, pattern) or fnmatchcase(one.removesuffix(".py"), pattern)]


def locate(target: str | os.PathLike[str], name: str | None = None, contract: str | None = None) -> Found:
    """Find the environment `name` of the corpus `target`, or the one in the file `target`.

    Without `name` the corpus must have exactly one. Without `contract` it is the one that the environment has passed,
    last if several, else ``arcade``. Raises UsageError, CorpusDamaged.
    """
    path = Path(target)
    if path.is_file() or path.suffix == ".py":
        if name is not None:
            raise UsageError(f"{path} is a file, and has no environment {name}: name a corpus, or leave {name} out")
        return _in_file(path, contract)
    root = find(path)
    with Store(root) as store:
        name, sha256, env_class, origin = _row(store, path, name)
        source = store.source(sha256)
        folder = root.parent if root.name == BESIDE else root
        found = _found(store, name, str(store.place(sha256)), source, sha256, env_class, contract, str(folder))
        return msgspec.structs.replace(found, entry=name, origin=json.loads(origin))


def _row(store: Store, path: Path, name: str | None) -> tuple[str, str, str, str]:
    """The name, source, class and origin of an environment, ``.py`` at the end of whose name may be left out."""
    if name is None:
        rows: list[tuple[str, str, str, str]] = store.db.execute(
            "SELECT name, source, class, origin FROM environments ORDER BY name LIMIT 2"
        ).fetchall()
        if len(rows) == 1:
            return rows[0]
        such = f", such as {rows[0][0]}" if rows else ""
        raise UsageError(f"{path} has {'several environments: name one' if rows else 'no environment'}{such}")
    for spelling in (name, f"{name}.py"):
        row: tuple[str, str, str, str] | None = store.db.execute(
            "SELECT name, source, class, origin FROM environments WHERE name = ?", (plain(spelling),)
        ).fetchone()
        if row is not None:
            return row
    raise UsageError(f"{path} has no environment {name}; `envcraft corpus list {path}` lists them")


def _in_file(path: Path, contract: str | None) -> Found:
    """A file as it is now, with the verdict that the nearest audited folder above has on it."""
    target = read_target(str(path))
    whole = path.resolve()
    for parent in whole.parents:
        if not is_corpus(parent / BESIDE):
            continue
        with Store(parent / BESIDE) as store:
            row = store.db.execute(
                "SELECT name, class FROM environments WHERE source = ? ORDER BY name = ? DESC LIMIT 1",
                (target.sha256, plain(str(whole.relative_to(parent)))),
            ).fetchone()
            entry, env_class = row or ("", "")
            found = _found(store, str(path), str(whole), target.source, target.sha256, env_class, contract, str(parent))
            return msgspec.structs.replace(found, entry=entry)
    promised = contract_named(contract or _DEFAULT)
    return Found(str(path), str(whole), target.source, target.sha256, None, promised, None, _NONE, str(whole.parent))


def _found(
    store: Store, name: str, path: str, source: bytes, sha256: str, env_class: str, contract: str | None, folder: str
) -> Found:
    """What a corpus knows of a source and class."""
    last = last_verdicts(store, sha256, env_class)
    chosen = contract_named(contract or contract_of(last) or _DEFAULT)
    given = last.get(chosen.name)
    if given is None or given.contract_sha256 != contract_digest(chosen):
        # None, or one on other promises under the same name.
        return Found(name, path, source, sha256, env_class or None, chosen, None, _NONE, folder)
    try:
        judged = decode(given.report).env_class
    except msgspec.DecodeError as error:
        raise CorpusDamaged(f"the report on {name} in {store.root} cannot be read: {error}") from None
    return Found(name, path, source, sha256, env_class or judged, chosen, given.verdict, given.doubt, folder)


def contract_named(name: str) -> Contract:
    """A contract by its name; only those of plugins and of ``pyproject.toml`` take loading the plugins. Raises
    UsageError.
    """
    for contract in envcraft_contracts():
        if contract.name == name:
            return contract
    from envcraft.commands import choices

    return choices.contract_named(name)
