"""The wheel and the source distribution: what they hold, and that the wheel works where the checkout is absent.

No test needs the network. The dependencies come from the interpreter that runs the tests.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pytest
import yaml

import envcraft
from tests.e2e.interpreters import VERSIONS, interpreter

#: Data that the code reads at run time.
DATA = {
    "envcraft/corpus/report/templates/base.html",
    "envcraft/corpus/report/templates/style.css",
    "envcraft/corpus/export/skeleton/pyproject.toml.txt",
    "envcraft/reports/page.css",
    "envcraft/reports/page.js",
    "envcraft/reports/palette.css",
    "envcraft_checks/guides/EC203.md",
    "envcraft_dqn/study/templates/report.html.j2",
    "envcraft_llm/concepts/pools/genres.toml",
    "envcraft_llm/demo.jsonl.gz",
    "envcraft_llm/prompts/code.md",
    "envcraft_sandbox/image/Dockerfile",
}
#: What the source distribution needs beside the packages, so that `make test` works from it.
SOURCES = {
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CITATION.cff",
    "CONTRIBUTING.md",
    "LICENSE",
    "Makefile",
    "README.md",
    "SECURITY.md",
    "action.yml",
    "benchmarks/demo.py",
    "constraints.txt",
    "docs/generate.py",
    "evaluation/judge.py",
    "examples/snake.py",
    "pyproject.toml",
    "tests/conftest.py",
}
#: Runs in another interpreter: compile the modules in argv[1], and look for the modules of the standard library that
#: argv[2] names.
PROBE = """
import compileall, importlib.util, sys
missing = [name for name in sys.argv[2].split(",") if importlib.util.find_spec(name) is None]
compiled = compileall.compile_dir(sys.argv[1], quiet=1, force=True)
sys.exit(f"no modules {missing}" if missing else not compiled)
"""


@dataclass(frozen=True)
class Built:
    """The two archives, the files in them, and the folder that the wheel was unpacked in."""

    wheel: Path
    sdist: Path
    installed: Path
    wheel_files: frozenset[str]
    sdist_files: frozenset[str]


@pytest.fixture(scope="module")
def built(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Built:
    folder = tmp_path_factory.mktemp("dist")
    _hatchling(root, folder)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        wheel_files = frozenset(archive.namelist())
        archive.extractall(folder / "installed")
    with tarfile.open(sdist) as tar:
        sdist_files = frozenset(name.partition("/")[2] for name in tar.getnames())
    return Built(wheel, sdist, folder / "installed", wheel_files, sdist_files)


def _hatchling(source: Path, folder: Path, *options: str) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), *options]
    result = subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 0, result.stderr


def _packages(root: Path) -> list[Path]:
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    return [root / name for name in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]]


def test_versions_are_the_same_everywhere(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    citation = yaml.safe_load((root / "CITATION.cff").read_text("utf-8"))
    newest = re.search(r"^## (\S+)", (root / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert newest is not None
    assert {project["version"], citation["version"], newest[1]} == {envcraft.__version__}
    assert citation["license"] == project["license"]


def test_the_wheel_holds_the_packages_and_nothing_else(root: Path, built: Built) -> None:
    wanted = {
        (package.name / path.relative_to(package)).as_posix()
        for package in _packages(root)
        for path in package.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    files = {name for name in built.wheel_files if ".dist-info/" not in name}
    assert files == wanted
    assert files >= DATA
    assert files >= {f"{package.name}/py.typed" for package in _packages(root)}


def test_the_source_distribution_holds_all_that_make_test_needs(built: Built) -> None:
    assert built.sdist_files >= SOURCES
    assert not [name for name in built.sdist_files if {"__pycache__", ".venv", "dist"} & set(PurePosixPath(name).parts)]


def test_the_source_distribution_builds_the_same_wheel(built: Built, tmp_path: Path) -> None:
    shutil.unpack_archive(built.sdist, tmp_path)
    (source,) = tmp_path.iterdir()
    _hatchling(source, tmp_path / "again", "-t", "wheel")
    (again,) = (tmp_path / "again").glob("*.whl")
    with zipfile.ZipFile(built.wheel) as first, zipfile.ZipFile(again) as second:
        assert {name: first.read(name) for name in first.namelist()} == {
            name: second.read(name) for name in second.namelist()
        }


def test_an_index_accepts_the_metadata(built: Built) -> None:
    command = [sys.executable, "-m", "twine", "check", "--strict", str(built.wheel), str(built.sdist)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_wheel_works_in_a_bare_environment(root: Path, built: Built, tmp_path: Path) -> None:
    venv.create(tmp_path / "bare", with_pip=False, symlinks=True)
    python = tmp_path / "bare" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", "--quiet"]
    installed = subprocess.run([*pip, str(built.wheel)], capture_output=True, text=True, timeout=240, check=False)
    assert installed.returncode == 0, installed.stderr
    # The dependencies. Python reads no .pth file in a folder that a .pth file adds, so the checkout stays out.
    (packages,) = (tmp_path / "bare" / "lib").glob("python*/site-packages")
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*command: str) -> subprocess.CompletedProcess[str]:
        program = [str(python.parent / "envcraft"), *command] if command[0] != "-c" else [str(python), *command]
        return subprocess.run(
            program, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=240, check=False
        )

    where = run("-c", "import envcraft, envcraft_checks; print(envcraft.__file__); print(envcraft_checks.__file__)")
    assert [Path(line).parent.parent for line in where.stdout.splitlines()] == [packages, packages], where.stderr
    assert envcraft.__version__ in run("--version").stdout
    examples = [root / "examples" / name for name in ("snake.py", "broken_invaders_nan_reward.py")]
    options = ["--budget", "quick", "--sandbox", "process", "--format", "json"]
    judged = run("validate", *options, *map(str, examples))
    assert judged.returncode == 1, judged.stderr
    good, bad = json.loads(judged.stdout)["reports"]
    assert (good["verdict"], bad["verdict"]) == ("pass", "fail")
    assert "EC301" in {found["code"] for check in bad["checks"] for found in check["findings"]}
    assert "PYTHONHASHSEED" in run("explain", "EC203").stdout


@pytest.mark.parametrize("version", VERSIONS)
def test_the_wheel_compiles_under_each_interpreter(built: Built, version: str, tmp_path: Path) -> None:
    """Its syntax and the modules of the standard library that it imports; `make interpreters` runs the examples."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"no Python {version} on this machine")
    shutil.copytree(built.installed, tmp_path / "wheel")
    modules = sorted(_imported(built.installed) & sys.stdlib_module_names)
    assert {"json", "sqlite3", "tomllib"} <= set(modules)
    result = subprocess.run(
        [python, "-c", PROBE, str(tmp_path / "wheel"), ",".join(modules)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr


def _imported(folder: Path) -> set[str]:
    """The top-level modules that the files of a folder import at the beginning of a line."""
    pattern = re.compile(r"^\s*(?:from|import) (\w+)", re.MULTILINE)
    return {name for path in folder.rglob("*.py") for name in pattern.findall(path.read_text("utf-8"))}
