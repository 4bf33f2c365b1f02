"""The files of a target's project: a read-only copy in the job's folder, which ends with the job."""

from __future__ import annotations

import base64
import importlib
import os
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType

from envcraft_protocol.jobs import Project

_READ_ONLY = 0o444
_INIT = "__init__.py"


def lay_out(project: Project, source: str | None) -> None:
    """Write a project below the working directory, and let imports find its modules.

    Args:
        project: the files, and the place of the target among them.
        source: the text of the target; None if it is installed.
    """
    root = os.getcwd()
    files = {path: base64.b64decode(data) for path, data in project["files"].items()}
    if source is not None:
        files[project["path"]] = source.encode()
    for path, data in files.items():
        place = os.path.join(root, path)
        os.makedirs(os.path.dirname(place), exist_ok=True)
        # A job cannot change the mode of a file afterwards.
        with open(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, _READ_ONLY), "wb") as stream:
            stream.write(data)
    sys.path[:0] = starts = [os.path.normpath(os.path.join(root, each)) for each in project.get("imports", ["."])]
    folder = os.path.dirname(os.path.join(root, project["path"]))
    if folder not in starts:
        # Last: a module of a package may have the name of a library.
        sys.path.append(folder)
    importlib.invalidate_caches()


def in_package(project: Project) -> bool:
    """Whether the target is a module of a package, or a package itself."""
    return "." in project["module"] or project["path"].endswith(_INIT)


def import_target(project: Project, code: CodeType) -> ModuleType | None:
    """Import the target as the module of its package, after the packages around it, with `code` as its code.

    Returns:
        The module; None if an installed package has the same name and is imported already.
    """
    finder = _Finder(project, code)
    sys.meta_path.insert(0, finder)
    module = importlib.import_module(project["module"])
    return module if module.__loader__ is finder else None


class _Finder(MetaPathFinder, Loader):
    """Finds one module, and executes code that was compiled before."""

    def __init__(self, project: Project, code: CodeType) -> None:
        self._project = project
        self._code = code

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self._project["module"]:
            return None
        spec = ModuleSpec(
            fullname, self, origin=self._code.co_filename, is_package=self._project["path"].endswith(_INIT)
        )
        spec.has_location = True
        if spec.submodule_search_locations is not None:
            spec.submodule_search_locations.append(os.path.dirname(os.path.abspath(self._project["path"])))
        return spec

    def exec_module(self, module: ModuleType) -> None:
        exec(self._code, module.__dict__)  # noqa: S102 (that is what a sandbox is for)
