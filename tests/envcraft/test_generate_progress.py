"""``envcraft generate --family`` shows how far it is on a terminal, and only there."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

_COMMAND = (sys.executable, "-m", "envcraft", "generate", "--family", "tetris", "--count", "3", "--output")


def test_a_terminal_shows_how_many_are_written(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "rb", buffering=0) as screen:
        subprocess.run(
            [*_COMMAND, tmp_path / "games"], stdout=subprocess.DEVNULL, stderr=theirs, timeout=120, check=True
        )
        os.close(theirs)
        shown = screen.read(65536).decode()
    assert "tetris" in shown
    assert "3/3" in shown


def test_a_file_has_no_progress(tmp_path: Path) -> None:
    done = subprocess.run([*_COMMAND, tmp_path / "games"], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr == ""
    assert done.stdout.startswith("wrote 3, kept 0 that exist; validate them with `envcraft validate")
