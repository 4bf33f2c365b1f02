"""The digest of the code that judges: it follows the import graph."""

from __future__ import annotations

import importlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

from envcraft.judging import code_digest
from envcraft.judging.code_digest import modules_of, reachable
from envcraft.judging.driver import Driver
from envcraft.judging.selection import default_checks
from envcraft.registry import offered

PACKAGES = ("envcraft", "envcraft_checks", "envcraft_sandbox", "envcraft_protocol")
#: Modules of other layers, and what none of them may do to a verdict.
BYSTANDERS = ("envcraft.cli.group", "envcraft.corpus.records", "envcraft.reports.html", "envcraft_sandbox.commands")


def roots() -> set[str]:
    drivers = [type(driver).__module__ for driver in offered("envcraft_sandbox_drivers")]
    return {"envcraft.judging.engine", *(type(check).__module__ for check in default_checks()), *drivers}


def digest() -> bytes:
    drivers: list[Driver] = offered("envcraft_sandbox_drivers")
    packages = {name for driver in drivers for name in driver.packages}
    return code_digest.code_digest([type(one) for one in (*default_checks(), *drivers)], packages)


def test_the_modules_are_those_of_the_import_graph() -> None:
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    expected = {root for root in roots() if root in graph.modules}
    for root in list(expected):
        expected |= graph.find_upstream_modules(root)
    modules = {name: path for package in PACKAGES for name, path in modules_of(package).items()}
    assert reachable(roots(), modules) == expected


@pytest.fixture
def copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The packages in another folder, from which the digest reads them."""
    for name in PACKAGES:
        source = Path(next(iter(sys.modules[name].__path__)))
        shutil.copytree(source, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
        monkeypatch.setattr(sys.modules[name], "__path__", [str(tmp_path / name)])
    code_digest._digest.cache_clear()
    yield tmp_path
    code_digest._digest.cache_clear()


def test_a_change_in_any_module_that_judges_changes_the_digest_and_in_no_other(copies: Path) -> None:
    modules = {name: path for package in PACKAGES for name, path in modules_of(package).items()}
    judging = reachable(roots(), modules)
    judging |= {name for name in modules if f"{name}.".startswith(("envcraft_protocol.", "envcraft_sandbox.worker."))}
    before = digest()
    changed = set()
    for name, path in modules.items():
        content = path.read_bytes()
        path.write_bytes(content + b"\n# changed\n")
        code_digest._digest.cache_clear()
        if digest() != before:
            changed.add(name)
        path.write_bytes(content)
    assert changed == judging
    assert not changed & set(BYSTANDERS)
    assert {"envcraft.similarity.behavioural", "envcraft.judging.engine", "envcraft_checks.api"} <= changed


def test_a_module_that_moves_into_a_subfolder_stays_in_the_digest(copies: Path) -> None:
    package = copies / "envcraft" / "judging"
    (package / "inner").mkdir()
    (package / "inner" / "__init__.py").touch()
    (package / "shrink.py").rename(package / "inner" / "shrink.py")
    for path in copies.rglob("*.py"):
        path.write_text(path.read_text("utf-8").replace("envcraft.judging.shrink", "envcraft.judging.inner.shrink"))
    code_digest._digest.cache_clear()
    before = digest()
    moved = package / "inner" / "shrink.py"
    moved.write_text(moved.read_text("utf-8") + "\n# changed\n")
    code_digest._digest.cache_clear()
    assert digest() != before


def test_a_plugin_of_another_project_counts_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "thirdparty"
    package.mkdir()
    (package / "__init__.py").write_text("class Rule:\n    pass\n")
    (package / "beside.py").write_text("NUMBER = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    thirdparty = importlib.import_module("thirdparty")

    before = code_digest.code_digest([thirdparty.Rule])
    (package / "beside.py").write_text("NUMBER = 2\n")
    code_digest._digest.cache_clear()
    assert code_digest.code_digest([thirdparty.Rule]) != before
