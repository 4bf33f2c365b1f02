"""The GitHub Action: bash runs each of its scripts as GitHub does, except the installation.

The environment that the tests run in has EnvCraft installed; the words that would install it are read instead.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ENVIRONMENT = Path("examples/snake.py")
BROKEN = Path("examples/broken_breakout_unknown_import.py")
#: Inputs that create a file if a shell interprets them.
HOSTILE = (
    "$(touch owned)",
    "`touch owned`",
    "; touch owned #",
    '"; touch owned; "',
    "'; touch owned; '",
    "| touch owned",
    "& touch owned",
    "${IFS}touch${IFS}owned",
    "--exit-zero",
    "--output=owned",
    "* ?",
)


@pytest.fixture
def action(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((root / "action.yml").read_text())
    return found


def steps(action: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [step for step in action["runs"]["steps"] if kind in step]


def run(
    action: dict[str, Any], step: dict[str, Any], folder: Path, **inputs: str
) -> tuple[subprocess.CompletedProcess[str], dict[str, str]]:
    """Run the script of a step in a folder; return the process and the contents of GitHub's files."""
    values = {f"inputs.{name}": given.get("default", "") for name, given in action["inputs"].items()}
    values |= {f"inputs.{name.replace('_', '-')}": value for name, value in inputs.items()}
    given = {
        name: re.sub(r"\$\{\{ (\S+) \}\}", lambda found: values[found[1]], str(value))
        for name, value in step.get("env", {}).items()
    }
    files = {name: folder.parent / name for name in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY")}
    for file in files.values():
        file.write_text("")
    script = folder.parent / "script.sh"
    script.write_text(step["run"])
    assert step["shell"] == "bash"
    process = subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", script],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=480,
        env={
            **os.environ,
            # The interpreter of the job.
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "GITHUB_WORKSPACE": str(folder),
            "GITHUB_ACTION_PATH": str(folder / "the action"),
            **{name: str(file) for name, file in files.items()},
            **given,
        },
    )
    return process, {name: file.read_text() for name, file in files.items()}


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A checkout with a good environment, a broken one, and settings for a short test."""
    made = tmp_path / "checkout"
    (made / "some games").mkdir(parents=True)
    (made / "some games" / "good.py").write_bytes((root / ENVIRONMENT).read_bytes())
    (made / "bad.py").write_bytes((root / BROKEN).read_bytes())
    (made / "pyproject.toml").write_text(
        '[tool.envcraft]\nchecks = ["source"]\nsandbox = "process"\noutput = "swallowed"\n'
    )
    return made


def test_no_input_is_written_into_a_script(action: dict[str, Any]) -> None:
    assert action["runs"]["using"] == "composite"
    scripts = steps(action, "run")
    assert len(scripts) == 2
    assert not [script for script in scripts if "${{" in script["run"]]
    named = set(re.findall(r"inputs\.([\w-]+)", json.dumps(action["runs"])))
    assert named == set(action["inputs"])


def test_the_action_installs_its_own_checkout(root: Path, action: dict[str, Any], folder: Path) -> None:
    (install,) = [step for step in steps(action, "run") if "install" in step["run"]]
    shim = folder.parent / "bin" / "python"
    shim.parent.mkdir()
    shim.write_text('#!/bin/bash\nprintf "%s\\n" "$@"\n')
    shim.chmod(0o755)
    process, _ = run(action, {**install, "run": f'PATH="{shim.parent}:$PATH"\n{install["run"]}'}, folder)
    words = process.stdout.splitlines()
    assert words[:3] == ["-P", "-m", "pip"]
    assert words[-1] == str(folder / "the action")
    # The package that pip installs has the module that the next step runs.
    project = tomllib.loads((root / "pyproject.toml").read_text())
    assert "envcraft" in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    (wanted,) = [step["with"]["python-version"] for step in steps(action, "uses")]
    assert wanted == "${{ inputs.python-version }}"
    assert project["project"]["requires-python"] == f">={action['inputs']['python-version']['default']}"


@pytest.mark.parametrize(
    ("targets", "status", "said"),
    [
        ("some games/good.py", 0, "::notice title=EnvCraft::1 passed"),
        ("some games\nbad.py\n", 1, "::error file=bad.py,line="),
        ("bad.py\n\nnowhere.py", 2, "::error file=bad.py,line="),
        ("", 2, ""),
    ],
)
def test_annotations_summary_and_status(
    action: dict[str, Any], folder: Path, targets: str, status: int, said: str
) -> None:
    (step,) = [step for step in steps(action, "run") if step.get("id") == "validate"]
    process, written = run(action, step, folder, targets=targets, sarif="envcraft report.sarif")
    assert process.returncode == status, process.stderr
    assert said in process.stdout
    assert written["GITHUB_OUTPUT"] == f"status={status}\n"
    if targets:
        assert "EnvCraft" in written["GITHUB_STEP_SUMMARY"]
        assert "EC002" in written["GITHUB_STEP_SUMMARY"] or status == 0
        assert json.loads((folder / "envcraft report.sarif").read_text())["version"] == "2.1.0"


def test_inputs_come_before_the_settings(action: dict[str, Any], folder: Path) -> None:
    (step,) = [step for step in steps(action, "run") if step.get("id") == "validate"]
    given = {"contract": "gymnasium", "budget": "quick", "sandbox": "process"}
    process, _ = run(action, step, folder, targets="some games/good.py", **given)
    assert process.returncode == 0
    assert "contract gymnasium" in process.stdout
    assert run(action, step, folder, targets="bad.py", sandbox="none such")[0].returncode == 2


def test_modules_of_the_checkout_are_not_imported(action: dict[str, Any], folder: Path) -> None:
    for name in ("click", "envcraft", "pip", "sitecustomize"):
        (folder / f"{name}.py").write_text("open('owned', 'w')\n")
    for step in steps(action, "run"):
        # The help of pip is enough: nothing must be installed.
        script = step["run"].replace(" install ", " install --help ")
        process, _ = run(action, {**step, "run": script}, folder, targets="some games/good.py")
        assert process.returncode == 0, process.stderr
    assert not (folder / "owned").exists()


@pytest.mark.parametrize("words", HOSTILE)
@pytest.mark.parametrize("name", ["targets", "contract", "budget", "sandbox", "sarif"])
def test_hostile_inputs_are_words(action: dict[str, Any], folder: Path, name: str, words: str) -> None:
    (step,) = [step for step in steps(action, "run") if step.get("id") == "validate"]
    inputs = {"targets": "bad.py", name: words}
    process, written = run(action, step, folder, **inputs)
    assert not [path for path in (folder / "owned", folder.parent / "owned") if path.exists()]
    # A file may have such a name, but no contract, budget or sandbox has.
    expected = 1 if name == "sarif" else 2
    assert process.returncode == expected, process.stderr
    assert written["GITHUB_OUTPUT"] == f"status={expected}\n"
    if name == "sarif":
        assert (folder / words).exists()
