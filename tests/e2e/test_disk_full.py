"""A full disk ends every command with one sentence and status 3, leaves nothing half-written, and can still be read.

The disk is a small tmpfs in a mount namespace of the test's own; where the system allows none, only ``/dev/full`` is
tested.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.envcraft.conftest import ENVIRONMENT

COMMAND = [sys.executable, "-m", "envcraft"]
FULL = Path("/dev/full")
#: Words that would mean a traceback, or more than a sentence.
TROUBLE = ("Traceback", "Exception", "a bug in EnvCraft")
#: Judges a file without playing it.
JUDGING = ["--sandbox", "process", "--budget", "quick", "--checks", "source"]


def mounting() -> list[str]:
    """The command that runs a program in a mount namespace of its own; empty where that is forbidden."""
    for words in (["unshare", "-m"], ["unshare", "-rm"]):
        try:
            tried = subprocess.run([*words, "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, timeout=60)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if tried.returncode == 0:
            return words
    return []


def sentence(stderr: str) -> str:
    """The one line that a command ends with."""
    assert not [words for words in TROUBLE if words in stderr], stderr
    [line] = [line for line in stderr.splitlines() if line.startswith("Error: ")]
    return line


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["explain", "EC203"], ["checks"], ["validate", "walk.py", *JUDGING, "--format", "json"]],
    ids=lambda words: words[0],
)
def test_output_to_a_full_device(arguments: list[str], tmp_path: Path) -> None:
    (tmp_path / "walk.py").write_text(ENVIRONMENT)
    with FULL.open("wb") as full:
        done = subprocess.run(
            [*COMMAND, *arguments], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=240
        )
    assert done.returncode == 3
    assert "cannot be written: No space left on device" in sentence(done.stderr)


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full")
@pytest.mark.parametrize("options", [["--report", f"json:{FULL}"], ["--format", "json", "--output", str(FULL)]])
def test_a_report_to_a_full_device(options: list[str], tmp_path: Path) -> None:
    (tmp_path / "walk.py").write_text(ENVIRONMENT)
    words = [*COMMAND, "validate", "walk.py", *JUDGING, *options]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert done.returncode == 3
    expected = f"Error: {FULL} cannot be written: No space left on device; free some space and try again"
    assert sentence(done.stderr) == expected
    # The verdict is not lost with the report.
    assert "1 passed, 0 failed, 0 undecided\n" in done.stderr


#: Fills a small disk that holds a corpus, and runs each command there; prints its status, its errors and what is left.
SCRIPT = """
set -u
mount -t tmpfs -o size=400k tmpfs "$1"
cd "$1"
mkdir games
cp "$2" games/walk.py
envcraft() { "$PYTHON" -m envcraft "$@"; }
envcraft corpus init corpus >/dev/null && envcraft corpus add corpus games >/dev/null || exit 9
dd if=/dev/zero of=fill bs=1k 2>/dev/null
find . -type f | sort >"$3/before"
number=0
while IFS= read -r line; do
    envcraft $line >"$3/$number.out" 2>"$3/$number.err"
    echo "$?" >"$3/$number.status"
    number=$((number + 1))
done <"$3/commands"
find . -type f ! -name 'corpus.sqlite-*' | sort >"$3/after"
"""
READING = ("corpus list corpus", "corpus show corpus walk.py")
WRITING = (
    "corpus init other",
    "corpus add corpus games --replace",
    "generate --family tetris --count 2 --output made",
    "audit games --sandbox process --budget quick --checks source",
    "validate games/walk.py --sandbox process --budget quick --checks source --report json:report.json",
    "new Walker",
)


@pytest.mark.skipif(not mounting(), reason="a tmpfs cannot be mounted in a namespace here")
def test_commands_on_a_full_disk(tmp_path: Path) -> None:
    disk, told, source = tmp_path / "disk", tmp_path / "told", tmp_path / "walk.py"
    disk.mkdir()
    told.mkdir()
    source.write_text(ENVIRONMENT)
    (told / "commands").write_text("".join(f"{line}\n" for line in (*READING, *WRITING)))
    script = tmp_path / "script.sh"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHON": sys.executable, "TMPDIR": str(disk), "PYTHONDONTWRITEBYTECODE": "1"}
    words = [*mounting(), "bash", script, disk, source, told]
    done = subprocess.run([str(word) for word in words], env=environment, capture_output=True, text=True, timeout=480)
    assert done.returncode == 0, done.stderr
    for number, line in enumerate((*READING, *WRITING)):
        status, err = (told / f"{number}.status").read_text().strip(), (told / f"{number}.err").read_text()
        if line in READING:
            assert (line, status, err) == (line, "0", "")
            assert "walk.py" in (told / f"{number}.out").read_text()
        else:
            assert (line, status) == (line, "3"), err
            words_of_it = sentence(err)
            assert "disk is full" in words_of_it or "No space left on device" in words_of_it, line
    before, after = ((told / name).read_text().splitlines() for name in ("before", "after"))
    assert after == [name for name in before if not name.startswith("./corpus/corpus.sqlite-")]
