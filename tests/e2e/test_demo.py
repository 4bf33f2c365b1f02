"""``make demo`` ends with the folder of its files and commands that can be copied."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from click.testing import CliRunner

from envcraft.cli.group import cli

_DEMO = """
import benchmarks.demo as demo
from envcraft.model.verdict import Report

demo.run = lambda: Report("arcade", 0, [])
raise SystemExit(demo.main())
"""


def test_it_says_where_its_files_are_and_what_comes_next(root: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _DEMO],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    [where] = [line for line in done.stdout.splitlines() if line.startswith("The files are in ")]
    assert (root / where.split()[4].rstrip(".")).is_dir()
    commands = [line.split() for line in done.stdout.splitlines() if " explain " in line or line.startswith("  ")]
    assert [command[1] for command in commands] == ["explain", "validate"]
    for program, *arguments in commands:
        assert os.path.basename(program) == "envcraft"
        files = [argument for argument in arguments if argument.endswith(".py")]
        assert all((root / file).is_file() for file in files)
    assert CliRunner().invoke(cli, commands[0][1:]).exit_code == 0
