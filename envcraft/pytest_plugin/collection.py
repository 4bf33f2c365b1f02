"""Collect environment files by parsing their source, without importing it."""

from __future__ import annotations

import ast
import os
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from envcraft.cli.commands.validate import is_excluded
from envcraft.corpus.store import is_corpus
from envcraft.environments.targets import refuse_corpus
from envcraft.errors import EnvCraftError
from envcraft.model import classes
from envcraft.model.target import MAX_SOURCE, parse
from envcraft.pytest_plugin.items import CheckItem
from envcraft.pytest_plugin.judging import CASE, Case, Spec, judge_of, settings

if TYPE_CHECKING:
    from envcraft.pytest_plugin.judging import Settings

_TESTS = ("conftest.py", "test_*.py", "*_test.py")
#: Patterns of ``python_files`` that would match every environment.
_EVERYTHING = ("*", "*.py")


class Collection:
    """The plugin that ``--envcraft`` registers to collect environment files. Raises UsageError if an option is wrong.

    Attributes:
        settings: how they are judged.
        checks: the names of the checks that run.
        excluded: the number of environment files that the settings exclude.
    """

    def __init__(self, config: pytest.Config) -> None:
        for named in config.args:
            refuse_corpus(os.path.relpath(config.invocation_params.dir / named.partition("::")[0]))
        self.settings = chosen = settings(config)
        self.checks = [check.name for check in chosen.selected(chosen.severity(config.rootpath))]
        self.excluded = 0

    def pytest_ignore_collect(self, collection_path: Path) -> bool | None:
        """Leave out what a corpus keeps, which are copies of sources."""
        return True if is_corpus(collection_path) else None

    def pytest_report_header(self) -> str:
        given = self.settings
        return f"envcraft: contract {given.contract}, budget {given.budget}, seed {given.seed}, sandbox {given.sandbox}"

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """End the run if the sandbox does not work: else each test would be the same error."""
        config = session.config
        # The controller of xdist has no items, and an error in its workers would look like a crash.
        distributed = config.getoption("dist", "no") != "no"
        runs = distributed or any(isinstance(item, CheckItem) for item in session.items)
        if config.option.collectonly or hasattr(config, "workerinput") or not runs:
            return
        try:
            judge_of(config).require_sandbox(self.settings)
        except EnvCraftError as error:
            raise pytest.UsageError(str(error)) from None

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
        if is_left_out(file_path, parent.session, self.settings.exclude):
            self.excluded += 1
            return []
        # Other collectors would import the file, and a package as the parent would import its __init__.py.
        file: EnvironmentFile = EnvironmentFile.from_parent(parent.session, path=file_path)
        file.line, file.settings, file.checks = line, self.settings, self.checks
        return [file]

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, session: pytest.Session, items: list[pytest.Item]) -> None:
        """Leave out what other environments derive from and cannot be made alone, as `envcraft validate` does."""
        files = dict.fromkeys(item.path for item in items if isinstance(item, CheckItem))
        with _without_warnings():
            derived = {path: classes.derivation(_read(path) or b"", path) for path in files}
        bases = {each for above, _ in derived.values() for each in above}
        left_out = {path for path, (_, own) in derived.items() if own and own <= bases and not session.isinitpath(path)}
        items[:] = [item for item in items if not (isinstance(item, CheckItem) and item.path in left_out)]


class EnvironmentFile(pytest.File):
    """A file with an environment class at `line`; its items are the checks."""

    line: int
    settings: Settings
    checks: list[str]

    def collect(self) -> Iterator[CheckItem]:
        spec = Spec(str(self.path))
        for check in self.checks:
            item: CheckItem = CheckItem.from_parent(self, name=check)
            item.line, item.stash[CASE] = self.line, Case(spec, self.settings.for_one(), check)
            item.add_marker("envcraft")
            if self.config.pluginmanager.hasplugin("xdist"):
                item.add_marker(pytest.mark.xdist_group(self.nodeid))
            yield item


def is_test_module(path: Path, config: pytest.Config) -> bool:
    """Return whether a file's name makes it a test module."""
    added = [pattern for pattern in config.getini("python_files") if pattern not in _EVERYTHING]
    return any(fnmatch(str(path) if "/" in pattern else path.name, pattern) for pattern in (*_TESTS, *added))


def is_left_out(path: Path, session: pytest.Session, exclude: tuple[str, ...]) -> bool:
    """Return whether a glob pattern matches a file below the folder that the command line names."""
    if not exclude or session.isinitpath(path):
        return False
    folder = next(filter(session.isinitpath, path.parents), session.path)
    return is_excluded(str(path), str(folder), exclude)


def environment_line(path: Path) -> int | None:
    """Return the line of the first environment class of a file, or None; `envcraft validate` judges the same files of a
    folder.

    A file that cannot be read counts as an environment, which then is an error.
    """
    source = _read(path)
    if source is None:
        return 1
    with _without_warnings():
        return classes.environment_line(source, path)


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
            return stream.read(MAX_SOURCE + 1)
    except OSError:
        return None


def _parse(source: bytes) -> ast.Module | None:
    try:
        with _without_warnings():
            return parse(source)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return None


@contextmanager
def _without_warnings() -> Iterator[None]:
    """Ignore the invalid escape sequences of an environment, which are not a matter of this run."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
