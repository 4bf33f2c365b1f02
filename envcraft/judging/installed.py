"""Locate the packages of this interpreter, without importing them, so that a worker can import what the host can."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec


class Installed(msgspec.Struct, frozen=True):
    """Folders other than those of the interpreter and its ``site-packages``.

    Attributes:
        paths: import paths in order (``PYTHONPATH``, ``.pth`` files, the user's own packages).
        folders: other folders that must be readable, such as projects that are installed as editable.
    """

    paths: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()


def installed() -> Installed:
    """Return the folders that this process can import from, except that of the script or the working directory."""
    entries = sys.path if sys.flags.safe_path else sys.path[1:]
    paths = [os.path.abspath(entry) for entry in entries if entry]
    projects = list(_editable())
    return Installed(tuple(_besides(paths)), tuple(path for path in _besides(projects) if path not in paths))


def is_installed(file: Path) -> bool:
    """Whether a module's file belongs to an installed package or to Python, and not only to a folder on ``sys.path``.

    Test runners and scripts put folders of a project on the path, which no worker imports from.
    """
    import site
    import sysconfig

    places = sysconfig.get_paths()
    folders = [places[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    folders += [*site.getsitepackages(), site.getusersitepackages(), *_editable()]
    return any(file.is_relative_to(folder) for folder in folders)


def _besides(paths: list[str]) -> Iterator[str]:
    """Yield the existing paths outside the interpreter's own folders."""
    own = [os.path.abspath(prefix) for prefix in (sys.prefix, sys.base_prefix, sys.exec_prefix)]
    for path in dict.fromkeys(paths):
        if path != "/" and os.path.exists(path) and not any(Path(path).is_relative_to(prefix) for prefix in own):
            yield path


def _editable() -> Iterator[str]:
    """Yield the folders of projects that are installed as editable (PEP 610)."""
    # These are slow to import, and targets that are files do not need them.
    import importlib.metadata
    import json
    import urllib.parse
    import urllib.request

    for distribution in importlib.metadata.distributions():
        try:
            source = json.loads(distribution.read_text("direct_url.json") or "{}")
            url = urllib.parse.urlsplit(source["url"]) if source.get("dir_info", {}).get("editable") else None
        except (ValueError, OSError, AttributeError, KeyError):
            continue
        if url is not None and url.scheme == "file":
            yield os.path.abspath(urllib.request.url2pathname(url.path))
