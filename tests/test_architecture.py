"""The structure that ARCHITECTURE.md describes: no import cycles, a docstring for each package, no way from tests to
benchmarks or back.
"""

from __future__ import annotations

import ast
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
PACKAGES: list[str] = PROJECT["importlinter"]["root_packages"]
FOLDERS = [ROOT / folder for folder in PROJECT["hatch"]["build"]["targets"]["wheel"]["packages"]]
#: Folders of data: source files that the package writes, or gives to others.
DATA = {"templates", "skeleton"}


@cache
def imports() -> dict[str, set[str]]:
    """The modules that each module imports. Lazy, typing and relative imports count."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_have_no_cycle(package: str) -> None:
    own = {module: found for module, found in imports().items() if module.partition(".")[0] == package}
    try:
        TopologicalSorter(own).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_packages_have_docstrings(folder: Path) -> None:
    packages = {path.parent for path in folder.rglob("*.py") if not DATA & set(path.parts)}
    for package in packages:
        assert ast.get_docstring(ast.parse((package / "__init__.py").read_text("utf-8"))), package


@pytest.mark.parametrize(
    ("folder", "forbidden"),
    [("tests", {"benchmarks"}), ("benchmarks", {"tests"}), ("evaluation", {"benchmarks", "tests"})],
)
def test_tests_and_benchmarks_share_only_evaluation(folder: str, forbidden: set[str]) -> None:
    for path in (ROOT / folder).rglob("*.py"):
        if "fixtures" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not forbidden & {name.partition(".")[0] for name in names}, path
