"""A root file system made from the running interpreter: its standard library, the libraries, and what they link to.

The interpreter and the shared libraries keep their paths, so the loader and its cache work. The Python libraries, which
may lie anywhere, go into one folder.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import io
import os
import py_compile
import re
import struct
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from envcraft.errors import SandboxUnavailable, UsageError

from . import leftovers
from .packages import Package

#: The folders of the worker and of the libraries in every image.
WORKER_ROOT = "/opt/envcraft"
LIBRARIES_ROOT = "/opt/libraries"

_NEEDED = ("numpy", "gymnasium", "pillow", "xxhash")
_WELCOME = ("pygame-ce", "scipy")
_OMITTED_FOLDERS = {
    "__pycache__", "dist-packages", "ensurepip", "idlelib", "lib2to3", "pydoc_data", "site-packages", "test", "tests",
    "tkinter", "turtledemo",
}  # fmt: skip
_OMITTED_FILES = ("_test", "_tkinter", "_xxtest", "_ctypes_test", "turtle.py")
#: The container's own mounts hide these.
_HIDDEN = ("/tmp/", "/proc/", "/dev/", "/sys/", "/run/")
_SYSTEM_FILES = ("/etc/ld.so.cache", "/usr/lib/locale/C.utf8")
_ETC = {
    "/etc/passwd": b"nobody:x:65534:65534:nobody:/tmp:/nonexistent\n",
    "/etc/group": b"nogroup:x:65534:\n",
    "/etc/nsswitch.conf": b"passwd: files\ngroup: files\nhosts: files\n",
    "/etc/hosts": b"",
}
_REQUIREMENT = re.compile(r"\s*([A-Za-z0-9._-]+)\s*([^;]*)(;.*)?")
_LINKED = re.compile(r"(?:=>)?\s+(/\S+) \(0x")


class Root:
    """Files by their path in the image. `python` is its interpreter."""

    def __init__(self, python: str) -> None:
        self.python = python
        self._files: dict[str, Path | bytes] = {}

    def __len__(self) -> int:
        return len(self._files)

    def add(self, path: str, content: Path | bytes) -> None:
        self._files.setdefault(path, content)

    def names(self) -> Iterator[str]:
        return iter(self._files)

    def files(self) -> Iterator[Path]:
        """The contents that are files of this machine."""
        return (content for content in self._files.values() if isinstance(content, Path))

    def write(self, stream: IO[bytes]) -> None:
        """Write the root as a tar stream. Root owns every file, and only root may write. Raises OSError."""
        made: set[str] = set()
        with tarfile.open(fileobj=stream, mode="w|", bufsize=1 << 20) as tar:
            for folder, mode in {"/tmp": 0o1777, "/proc": 0o755, "/dev": 0o755, "/sys": 0o755, "/run": 0o755}.items():
                _make_folder(tar, folder, made, mode)
            for path, content in sorted(self._files.items()):
                _make_folder(tar, os.path.dirname(path), made)
                entry = tarfile.TarInfo(path.lstrip("/"))
                entry.mode = 0o644
                if isinstance(content, bytes):
                    entry.size = len(content)
                    tar.addfile(entry, io.BytesIO(content))
                    continue
                with content.open("rb") as source:
                    status = os.fstat(source.fileno())
                    entry.size, entry.mtime = status.st_size, int(status.st_mtime)
                    if status.st_mode & 0o100:
                        entry.mode = 0o755
                    tar.addfile(entry, source)


def collect(worker: Iterable[tuple[str, bytes]], packages: Sequence[Package] = ()) -> Root:
    """Collect all files that the worker needs, and `packages`.

    Args:
        worker: the worker's sources by path.
        packages: additional libraries.

    Raises:
        SandboxUnavailable: the interpreter or a library cannot be copied.
        UsageError: a package is not installed in the required version.
    """
    _check_installed(packages)
    root = Root(os.path.realpath(sys.executable))
    if root.python.startswith(_HIDDEN):
        raise SandboxUnavailable(f"the interpreter {root.python} lies in a folder that containers replace; use another")
    root.add(root.python, Path(root.python))
    for name in ("stdlib", "platstdlib"):
        for path in _tree(Path(os.path.realpath(sysconfig.get_path(name)))):
            _add_module(root, str(path), path)
    gathered: set[str] = set()
    for distribution in _distributions([package.name for package in packages]):
        for name, path in _installed(distribution):
            _add_module(root, f"{LIBRARIES_ROOT}/{name}", path)
            gathered.add(str(path))
    # Shared libraries inside a Python library lie beside it.
    for library in _shared_libraries(root.files()) - gathered:
        root.add(library, Path(library))
    for place in map(Path, _SYSTEM_FILES):
        for path in [place] if place.is_file() else _tree(place):
            root.add(str(path), path)
    for name, content in _ETC.items():
        root.add(name, content)
    for name, source in worker:
        root.add(f"{WORKER_ROOT}/{name}", source)
        _add_bytecode(root, f"{WORKER_ROOT}/{name}", source)
    return root


def _check_installed(packages: Iterable[Package]) -> None:
    """Raises UsageError with every package that is not installed, or in another version."""
    wrong = []
    for package in packages:
        try:
            version = importlib.metadata.version(package.name)
        except importlib.metadata.PackageNotFoundError:
            wrong.append(f"{package} ({package.place}) is not installed")
        else:
            if package.version not in (None, version):
                wrong.append(f"{package} ({package.place}) is installed as {version}")
    if wrong:
        raise UsageError(
            f"the base host copies the libraries of {sys.executable}: {'; '.join(wrong)}; install the packages "
            "with pip, or use a base image that has pip"
        )


def _distributions(more: Iterable[str]) -> Iterator[importlib.metadata.Distribution]:
    """What the worker needs, `more` and their requirements, and other libraries of games where they are installed."""
    wanted, seen = [*_NEEDED, *_WELCOME, *more], set()
    while wanted:
        name = wanted.pop(0)
        key = Package(name).key
        if key in seen:
            continue
        seen.add(key)
        try:
            distribution = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            # A marker excludes it, or it is optional.
            if name in _NEEDED:
                raise SandboxUnavailable(f"{name} is not installed; run `pip install {name}`") from None
            continue
        yield distribution
        for line in distribution.requires or ():
            found = _REQUIREMENT.match(line)
            if found and "extra" not in (found[3] or ""):
                wanted.append(found[1])


def _installed(distribution: importlib.metadata.Distribution) -> Iterator[tuple[str, Path]]:
    """The files of a library: the name below its folder, and the path here. Raises SandboxUnavailable."""
    if distribution.files is None:
        raise SandboxUnavailable(
            f"the installation of {distribution.name} does not list its files; install it with pip"
        )
    for file in distribution.files:
        if ".." not in file.parts and not _OMITTED_FOLDERS.intersection(file.parts):
            path = Path(os.path.realpath(str(distribution.locate_file("")))) / file
            if path.is_file():
                yield str(file), path


def _tree(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if name not in _OMITTED_FOLDERS and not name.startswith("config-"))
        for name in sorted(names):
            path = Path(parent, name)
            if not name.startswith(_OMITTED_FILES) and path.is_file():
                yield path


def _add_module(root: Root, name: str, path: Path) -> None:
    """Add a file and, for a module, its bytecode: a container cannot store what it compiles."""
    root.add(name, path)
    if path.suffix == ".py":
        cache = Path(importlib.util.cache_from_source(str(path)))
        if _is_fresh(cache, path):
            root.add(importlib.util.cache_from_source(name), cache)
        else:
            _add_bytecode(root, name, path.read_bytes())


def _is_fresh(cache: Path, source: Path) -> bool:
    """Whether bytecode was compiled from this source (PEP 552: magic, flags, time, size)."""
    try:
        with cache.open("rb") as stream:
            head = stream.read(16)
        status = source.stat()
    except OSError:
        return False
    stamp = struct.pack("<4sIII", importlib.util.MAGIC_NUMBER, 0, int(status.st_mtime), status.st_size)
    return head == stamp


def _add_bytecode(root: Root, path: str, source: bytes) -> None:
    """Compile a module into bytecode that ignores the source's modification time; skip it if it does not compile."""
    with tempfile.TemporaryDirectory(prefix="compile-", dir=leftovers.folder()) as folder:
        module, target = Path(folder, "module.py"), Path(folder, "module.pyc")
        module.write_bytes(source)
        mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
        if py_compile.compile(str(module), str(target), path, quiet=2, invalidation_mode=mode):
            root.add(importlib.util.cache_from_source(path), target.read_bytes())


def _shared_libraries(files: Iterable[Path]) -> set[str]:
    """The libraries that the binaries among `files` link to, directly or indirectly, and the loader.

    Raises SandboxUnavailable.
    """
    binaries = sorted({str(path) for path in files if ".so" in path.name or path.name.startswith("python")})
    try:
        listed = subprocess.run(["ldd", *binaries], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise SandboxUnavailable("ldd is not installed; build on an image instead (`--base`)") from None
    return {os.path.normpath(path) for path in _LINKED.findall(listed.stdout)}


def _make_folder(tar: tarfile.TarFile, path: str, made: set[str], mode: int = 0o755) -> None:
    if path in made or path in ("", "/"):
        return
    _make_folder(tar, os.path.dirname(path), made)
    made.add(path)
    entry = tarfile.TarInfo(path.lstrip("/"))
    entry.type = tarfile.DIRTYPE
    entry.mode = mode
    tar.addfile(entry)
