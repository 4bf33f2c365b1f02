"""What to judge: a Python file, a class of an installed package, or an environment that a package has registered; and
the privileged policies to judge with.

Only files are read here. A package is never imported on the host: the worker imports it, and says which file its class
comes from. Importing this module costs nothing, so that commands can look at their files before anything heavy.
"""

from __future__ import annotations

import ast
import base64
import hashlib
import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

import msgspec

from envcraft.errors import UsageError

if TYPE_CHECKING:
    from envcraft_protocol import jobs

#: Larger files are not read: no environment of this kind is anywhere near.
MAX_SOURCE = 2 * 1024**2
_PARSING = threading.Lock()
#: Up to this length, callers share the tree of a source: each check of a subject asks for it, and parsing is slow.
_SHARED = 64 * 1024

_NAME = r"[^\W\d]\w*"
_CLASS = re.compile(rf"{_NAME}(?:\.{_NAME})*:{_NAME}(?:\.{_NAME})*")
#: As Gymnasium writes ids: ``[module:][namespace/]name[-vN]``.
_ID = re.compile(r"(?:[\w.]+:)?(?:[\w:-]+/)?[\w:.-]+")
_VERSION = re.compile(r"-v\d+$")
#: The name under which a syntax tree keeps its nodes.
_NODES = "envcraft_nodes"
_Item = TypeVar("_Item")


class Kind(StrEnum):
    """How a target names its environment."""

    SOURCE = "source"  #: a Python file
    MODULE = "module"  #: ``package.module:Class``
    ID = "id"  #: a registered id


class Project(msgspec.Struct, frozen=True):
    """The files that a file imports or reads below the folder of its project, as they were when they were read.

    Attributes:
        root: the folder of the files.
        module: the dotted name of the file, below the folder that its imports start from; "" if the target is no file.
        path: the file's path below `root`, with slashes; "" if the target is no file.
        files: the bytes of the other files by path.
        modules: the top-level modules of the project that these files import; relative imports with their dots.
        named: the user named the module, so that a contract for single files does not leave the project out.
        imports: the folders below `root` that imports start from; () for `root` alone.
    """

    root: str
    module: str
    path: str
    files: dict[str, bytes]
    modules: frozenset[str] = frozenset()
    named: bool = False
    imports: tuple[str, ...] = ()

    @property
    def digests(self) -> dict[str, str]:
        """The SHA-256 of each file by path."""
        import hashlib

        return {path: hashlib.sha256(data).hexdigest() for path, data in sorted(self.files.items())}

    def for_worker(self) -> jobs.Project:
        """The part that the worker needs."""
        files = {path: base64.b64encode(data).decode("ascii") for path, data in self.files.items()}
        return {"module": self.module, "path": self.path, "files": files, "imports": list(self.imports or (".",))}


class Target(msgspec.Struct, frozen=True):
    """One environment to judge.

    Attributes:
        path: the target as it was named: a file, ``package.module:Class`` or an id.
        source: the file's bytes; empty for what is installed.
        env_class: picks one of several classes of a file.
        kwargs: what the constructor is given.
        wrappers: ``module:callable`` of what is applied to each instance, the innermost first.
        project: the files of its project that a file or wrappers need; None if they need none.
        cells: the first line of each cell of a notebook that the source is joined from, by the cell's name.
    """

    path: str
    source: bytes = b""
    env_class: str | None = None
    kind: Kind = Kind.SOURCE
    kwargs: dict[str, Any] = {}
    wrappers: tuple[str, ...] = ()
    project: Project | None = None
    cells: dict[str, int] = {}

    @property
    def sha256(self) -> str:
        """Of the file, or of the target's name where the file is not known on this side."""
        # Slow to import, and not needed before the first worker is on its way.
        import hashlib

        return hashlib.sha256(self.source if self.kind is Kind.SOURCE else self.path.encode()).hexdigest()

    @property
    def text(self) -> str:
        """The source as text. Raises UnicodeDecodeError."""
        return self.source.decode("utf-8-sig")

    @property
    def installed(self) -> bool:
        """Whether a worker needs what is installed beside the contract's libraries."""
        return self.kind is not Kind.SOURCE or bool(self.wrappers)

    def for_worker(self) -> jobs.Target:
        """The part that the worker needs. Raises UnicodeDecodeError."""
        kwargs, wrappers = self.kwargs, list(self.wrappers)
        project = self.project.for_worker() if self.project is not None else None
        if self.kind is Kind.SOURCE:
            filename = Path(self.path).name
            described: jobs.SourceTarget = {
                "kind": "source",
                "kwargs": kwargs,
                "wrappers": wrappers,
                "filename": filename,
                "source": self.text,
                "class": self.env_class,
            }
            if project is not None:
                described["project"] = project
            return described
        installed: jobs.ModuleTarget | jobs.RegisteredTarget
        if self.kind is Kind.MODULE:
            module, _, name = self.path.partition(":")
            installed = {"kind": "module", "kwargs": kwargs, "wrappers": wrappers, "module": module, "class": name}
        else:
            installed = {"kind": "id", "kwargs": kwargs, "wrappers": wrappers, "id": self.path}
        if project is not None:
            installed["project"] = project
        return installed


class LazyTargets(Sequence[Target], Generic[_Item]):
    """A sequence of targets that reads each item on access, in the accessing thread, and keeps none."""

    def __init__(self, items: Sequence[_Item], read: Callable[[_Item], Target]) -> None:
        self._items, self._read = items, read

    def __len__(self) -> int:
        return len(self._items)

    @overload
    def __getitem__(self, index: int) -> Target: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Target]: ...
    def __getitem__(self, index: int | slice) -> Target | Sequence[Target]:
        if isinstance(index, slice):
            return LazyTargets(self._items[index], self._read)
        return self._read(self._items[index])


def kind_of(name: str) -> Kind | None:
    """Whether a name is a class of a module or an id; None for a path."""
    if name.endswith(".py"):
        return None
    if _CLASS.fullmatch(name):
        return Kind.MODULE
    named = _ID.fullmatch(name) and (_VERSION.search(name) or ":" in name)
    return Kind.ID if named else None


class PolicyFile(msgspec.Struct, frozen=True):
    """A privileged policy to run in the worker.

    Attributes:
        path: its file, or the name of the player that has it.
        source: its text.
        common: whether it is for many environments, some of which it may not be able to play.
    """

    path: str
    source: str
    common: bool = False


def read_target(path: str, env_class: str | None = None) -> Target:
    """Read a file to judge. Raises UsageError if it cannot be read."""
    try:
        with open(path, "rb") as stream:
            return Target(path, stream.read(MAX_SOURCE + 1), env_class)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from None


def read_policy(path: str) -> PolicyFile:
    """Read a privileged policy. Raises UsageError if it cannot be read, is not Python or defines no policy."""
    try:
        source = Path(path).read_text("utf-8")
        tree = parse(source)
    except SyntaxError as error:
        raise UsageError(f"the policy {path} is not valid Python: {error.msg} (line {error.lineno})") from None
    except RecursionError:
        raise UsageError(f"the policy {path} is nested too deeply") from None
    except OSError as error:
        raise UsageError(f"the policy {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"the policy {path} is not Python text") from None
    except ValueError as error:
        raise UsageError(f"the policy {path} is not valid Python: {error}") from None
    if not any(map(_may_play, nodes(tree))):
        raise UsageError(f"{path} is not a policy: it defines no function policy(env) and no class with act(state)")
    return PolicyFile(path, source)


def _may_play(node: ast.AST) -> bool:
    """Whether a part of a module may define a policy."""
    if isinstance(node, ast.FunctionDef):
        return node.name in ("policy", "act")
    if isinstance(node, ast.ImportFrom):
        return any((alias.asname or alias.name) in ("policy", "*") for alias in node.names)
    # A class may have `act` from a base.
    return (isinstance(node, ast.ClassDef) and bool(node.bases)) or (isinstance(node, ast.Name) and node.id == "policy")


def read_known(path: str, sha256: str) -> bytes:
    """Return the content of a Python file; b"" if it cannot be read, is too large or has another digest."""
    # A worker may name the file, and opening a pipe would wait for ever.
    if not path.endswith(".py") or not os.path.isfile(path):
        return b""
    try:
        with open(path, "rb") as stream:
            data = stream.read(MAX_SOURCE + 1)
    except (OSError, ValueError):
        return b""
    return data if hashlib.sha256(data).hexdigest() == sha256 else b""


def parse(source: bytes | str) -> ast.Module:
    """The syntax tree of a source, which must not be changed. Raises SyntaxError, ValueError, RecursionError,
    MemoryError.
    """
    return _known(source) if len(source) <= _SHARED else _parse(source)


@lru_cache(8, typed=True)
def _known(source: bytes | str) -> ast.Module:
    return _parse(source)


def _parse(source: bytes | str) -> ast.Module:
    # In Python 3.11 and 3.12 two threads share the parser's depth counter (CPython issue 106905).
    with _PARSING:
        return ast.parse(source)


def nodes(tree: ast.Module) -> list[ast.AST]:
    """All nodes of a module's tree, which keeps them: each check of a subject looks at them. The order is that of
    ``ast.walk``.
    """
    kept = vars(tree)
    if _NODES not in kept:
        # Without the tree itself, which would be garbage in a cycle.
        kept[_NODES] = walk(tree)[1:]
    return [tree, *kept[_NODES]]


def walk(tree: ast.AST) -> list[ast.AST]:
    """A node and all below it in the order of ``ast.walk``, in half of its time."""
    found = [tree]
    for node in found:
        for name in node._fields:
            value = getattr(node, name, None)
            if isinstance(value, list):
                found += [each for each in value if isinstance(each, ast.AST)]
            elif isinstance(value, ast.AST):
                found.append(value)
    return found


def imported(source: bytes) -> Iterator[str]:
    """The top-level modules that a source imports anywhere; none if it does not parse."""
    try:
        tree = parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    yield from imports(tree)


def imports(tree: ast.Module) -> Iterator[str]:
    """The top-level modules that a syntax tree imports anywhere."""
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]
