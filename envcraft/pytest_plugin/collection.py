"""Collect environment files by parsing their source, without importing it."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Generator, Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from envcraft.judging.selection import select_checks
from envcraft.pytest_plugin.items import CheckItem
from envcraft.pytest_plugin.judging import CASE, Case, Spec

if TYPE_CHECKING:
    from envcraft.pytest_plugin.judging import Settings

_TESTS = ("conftest.py", "test_*.py", "*_test.py")
#: Patterns of ``python_files`` that would match every environment.
_EVERYTHING = ("*", "*.py")
#: As :data:`envcraft.model.target.MAX_SOURCE`, whose module takes longer to load than a folder to collect.
_MAX_SOURCE = 2 * 1024**2


class Collection:
    """The plugin that ``--envcraft`` registers to collect environment files."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def pytest_report_header(self) -> str:
        given = self.settings
        return f"envcraft: contract {given.contract}, budget {given.budget}, seed {given.seed}, sandbox {given.sandbox}"

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collect_file(
        self, file_path: Path, parent: pytest.Collector
    ) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
        collectors = yield
        if file_path.suffix != ".py" or is_test_module(file_path, parent.config):
            return collectors
        line = environment_line(file_path)
        if line is None and parent.session.isinitpath(file_path) and not defines_tests(file_path):
            line = 1
        if line is None:
            return collectors
        # Other collectors would import the file, and a package as the parent would import its __init__.py.
        file: EnvironmentFile = EnvironmentFile.from_parent(parent.session, path=file_path)
        file.line, file.settings = line, self.settings
        return [file]


class EnvironmentFile(pytest.File):
    """A file with an environment class at `line`; its items are the checks."""

    line: int
    settings: Settings

    def collect(self) -> Iterator[CheckItem]:
        spec = Spec(str(self.path))
        for check in select_checks(self.settings.checks, self.settings.skip):
            item: CheckItem = CheckItem.from_parent(self, name=check.name)
            item.line, item.stash[CASE] = self.line, Case(spec, self.settings.for_one(), check.name)
            item.add_marker("envcraft")
            if self.config.pluginmanager.hasplugin("xdist"):
                item.add_marker(pytest.mark.xdist_group(self.nodeid))
            yield item


def is_test_module(path: Path, config: pytest.Config) -> bool:
    """Return whether a file's name makes it a test module."""
    added = [pattern for pattern in config.getini("python_files") if pattern not in _EVERYTHING]
    return any(fnmatch(str(path) if "/" in pattern else path.name, pattern) for pattern in (*_TESTS, *added))


def environment_line(path: Path) -> int | None:
    """Return the line of the first environment class of a file that imports gymnasium, or None.

    A file that does not parse but mentions both counts as an environment: the check ``source`` reports the error. So
    does a file that cannot be read, which then is an error.
    """
    source = _read(path)
    if source is None:
        return 1
    if b"gym" not in source or b"class" not in source:
        return None
    tree = _parse(source)
    if tree is None:
        return 1
    if not any(_imports_gymnasium(node) for node in ast.walk(tree)):
        return None
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return next((node.lineno for node in classes if _is_environment(node)), None)


def defines_tests(path: Path) -> bool:
    """Return whether a file defines functions or classes that pytest would run."""
    tree = _parse(_read(path) or b"")
    return tree is not None and any(
        isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and node.name.lower().startswith("test")
        for node in tree.body
    )


def _read(path: Path) -> bytes | None:
    try:
        with path.open("rb") as stream:
            return stream.read(_MAX_SOURCE)
    except OSError:
        return None


def _parse(source: bytes) -> ast.Module | None:
    try:
        with warnings.catch_warnings():
            # Invalid escape sequences of an environment are not a matter of this run.
            warnings.simplefilter("ignore")
            return ast.parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


def _imports_gymnasium(node: ast.AST) -> bool:
    names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        names = [node.module]
    return any(name.partition(".")[0] in ("gymnasium", "gym") for name in names)


def _is_environment(node: ast.ClassDef) -> bool:
    bases = [_last_name(base) for base in node.bases]
    if any(base.endswith("Wrapper") for base in bases):
        return False
    methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    return any(base.endswith("Env") for base in bases) or {"reset", "step"} <= methods


def _last_name(base: ast.expr) -> str:
    """``Env`` for ``Env``, ``gym.Env`` and ``gym.Env[Observation, Action]``."""
    if isinstance(base, ast.Subscript):
        return _last_name(base.value)
    return base.attr if isinstance(base, ast.Attribute) else base.id if isinstance(base, ast.Name) else ""
