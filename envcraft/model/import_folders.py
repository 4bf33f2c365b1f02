"""The folders that a project's tests import from, as its settings or its layout say. No code runs here."""

from __future__ import annotations

import configparser
import functools
import os
import shlex
import sys
from pathlib import Path

#: The files that make a folder a project, and the section that has the settings of pytest.
_SETTINGS = {
    "pytest.ini": "pytest",
    ".pytest.ini": "pytest",
    "pyproject.toml": "",
    "tox.ini": "pytest",
    "setup.cfg": "tool:pytest",
    "setup.py": "",
}
#: The folder of the packages in the layout that Python's packaging guide calls by this name.
_LAYOUT = "src"


@functools.lru_cache(1024)
def import_folders(folder: Path) -> tuple[Path, ...]:
    """Find the folders that the files of a folder are imported with.

    These are the folders of pytest's setting ``pythonpath``, and ``src`` unless it is a package.

    Args:
        folder: an absolute path. The nearest folder above that has settings is its project.

    Returns:
        Folders of the project.
    """
    project = project_folder(folder)
    if project is None:
        return ()
    named = [path for name in _SETTINGS if (project / name).is_file() for path in _python_path(project / name)]
    named += [] if (project / _LAYOUT / "__init__.py").is_file() else [_LAYOUT]
    found = dict.fromkeys(Path(os.path.normpath(project / path)) for path in named)
    return tuple(each for each in found if each.is_relative_to(project) and each.is_dir())


@functools.lru_cache(1024)
def project_folder(folder: Path) -> Path | None:
    """Find the nearest folder, from this one up, that has settings of a project."""
    for each in (folder, *folder.parents):
        if any((each / name).is_file() for name in _SETTINGS):
            return each
    return None


def is_importable(package: str, folder: Path) -> bool:
    """Whether Python finds a package without looking into a folder, and without importing it: it is installed, also
    where an editable installation or ``PYTHONPATH`` leads back to a project.
    """
    from importlib.machinery import PathFinder

    folder = folder.resolve()
    installed = _is_editable(folder)
    path = [each for each in sys.path if installed or Path(each or ".").resolve() != folder]
    return PathFinder.find_spec(package, path) is not None


def _is_editable(folder: Path) -> bool:
    """Whether an editable installation has put a folder, which may be the working directory, on Python's path."""
    import site

    for each in (*site.getsitepackages(), site.getusersitepackages()):
        for file in Path(each).glob("*.pth"):
            try:
                lines = file.read_text("utf-8", "replace").splitlines()
            except OSError:
                continue
            if any(Path(each, line).resolve() == folder for line in lines if line and not line.startswith("import")):
                return True
    return False


def _python_path(file: Path) -> list[str]:
    """pytest's setting ``pythonpath`` in a file; [] if it is not there."""
    try:
        text = file.read_text("utf-8")
        if "pythonpath" not in text:
            return []
        if file.suffix == ".toml":
            # The parser is slow to import.
            import tomllib

            table = tomllib.loads(text)["tool"]["pytest"]
            value = table.get("ini_options", table)["pythonpath"]
        else:
            parser = configparser.ConfigParser(interpolation=None)
            parser.read_string(text)
            value = parser[_SETTINGS[file.name]]["pythonpath"]
        return shlex.split(value) if isinstance(value, str) else [str(each) for each in value]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, configparser.Error):
        return []
