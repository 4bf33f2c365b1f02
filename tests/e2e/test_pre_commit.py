"""The pre-commit hook: its command with the changed files as arguments."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

Hook = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def hook(root: Path, tmp_path: Path) -> Hook:
    """Run the hook on files of a folder with the command line of pre-commit: entry, arguments, files."""
    (found,) = yaml.safe_load((root / ".pre-commit-hooks.yaml").read_text())
    (tmp_path / "games").mkdir()
    for name, example in (("good", "snake"), ("bad", "broken_breakout_unknown_import")):
        (tmp_path / "games" / f"{name}.py").write_bytes((root / "examples" / f"{example}.py").read_bytes())
    (tmp_path / "games" / "tiles.py").write_text("class Tiles:\n    size = 8\n")

    def run(*files: str, args: list[str] = found["args"]) -> subprocess.CompletedProcess[str]:
        program, *words = shlex.split(found["entry"])
        return subprocess.run(
            # The script that the installation of EnvCraft creates.
            [Path(sys.executable).with_name(program), *words, *args, "--sandbox", "process", *files],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )

    return run


def test_the_definition_has_what_pre_commit_needs(root: Path) -> None:
    (found,) = yaml.safe_load((root / ".pre-commit-hooks.yaml").read_text())
    wanted: dict[str, Any] = {"id": "envcraft", "language": "python", "types": ["python"]}
    wanted |= {"pass_filenames": True, "require_serial": True}
    assert {name: found[name] for name in wanted} == wanted
    assert found["name"]
    # A user may replace the arguments, so the entry must contain the rest of the command.
    assert "--environments-only" in found["entry"]


@pytest.mark.parametrize(
    ("files", "status"),
    [
        (["games/good.py", "games/tiles.py"], 0),
        (["games/tiles.py"], 0),
        (["games/bad.py", "games/tiles.py"], 1),
        (["games/good.py", "games/gone.py"], 2),
    ],
)
def test_changed_files_are_judged_and_helpers_left_out(hook: Hook, files: list[str], status: int) -> None:
    result = hook(*files)
    assert result.returncode == status, result.stdout + result.stderr
    assert "tiles.py" not in result.stdout


def test_users_may_give_arguments_of_their_own(hook: Hook) -> None:
    result = hook("games/good.py", "games/tiles.py", args=["--checks", "source", "--format", "github"])
    assert result.returncode == 0
    assert "1 passed" in result.stdout
