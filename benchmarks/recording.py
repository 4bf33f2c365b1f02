"""``make pictures``: run a new user's first commands and draw ``docs/first-commands.svg``, the README's recording.

Each line of the picture appears at the time at which the command printed it. Prints the seconds of each command.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.text import Text

ROOT = Path(__file__).resolve().parent.parent
WIDTH = 104
#: The commands, and the number of their last lines that are shown.
COMMANDS = (
    ("envcraft validate lantern.py", 16),
    ("envcraft validate games/", 2),
    ("envcraft validate gymnasium:CartPole-v1 --contract gymnasium", 2),
    ("python cell.py   # ends with envcraft.validate(Lantern), for a class of the notebook", 2),
    ("pytest --envcraft games/ -q", 3),
)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        console = Console(file=io.StringIO(), record=True, width=WIDTH, force_terminal=True, highlight=False)
        console._environ = {}
        shown: list[float] = []
        now = 0.0
        for command, most in COMMANDS:
            lines, seconds = run(command.partition("#")[0].split(), Path(folder))
            print(f"{seconds:5.1f} s  {command}", flush=True)
            show(console, shown, [Text(f"$ {command}", style="bold")], now)
            show(console, shown, [Text.from_ansi(line) for line in lines[-most:]], now + seconds)
            show(console, shown, [Text(f"{seconds:.1f} s", style="dim"), Text()], now + seconds)
            # A reader needs a moment before the next command.
            now += seconds + 2
    svg = animated(console.export_svg(title="First commands", unique_id="first"), shown)
    (ROOT / "docs" / "first-commands.svg").write_text(svg, "utf-8")
    print("wrote docs/first-commands.svg")


def prepare(folder: Path) -> None:
    """Write what a new user has: one game, a folder of games, and a class in a cell."""
    environment = Path(sys.executable).parent
    subprocess.run([environment / "envcraft", "new", "Lantern"], cwd=folder, check=True, capture_output=True)
    source = (folder / "lantern.py").read_text("utf-8")
    (folder / "cell.py").write_text(f"{source}\n\nimport envcraft\n\nprint(envcraft.validate(Lantern))\n", "utf-8")
    (folder / "games").mkdir()
    for name in ("snake.py", "sokoban.py", "lander.py"):
        shutil.copy(ROOT / "examples" / name, folder / "games")


def run(command: list[str], folder: Path) -> tuple[list[str], float]:
    """Run a command as a terminal would, and return the lines of its output and its seconds."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "FORCE_COLOR": "1", "COLUMNS": str(WIDTH), "ENVCRAFT_CACHE": ""}
    started = time.monotonic()
    done = subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False
    )
    return done.stdout.rstrip().splitlines(), time.monotonic() - started


def show(console: Console, shown: list[float], lines: list[Text], at: float) -> None:
    """Print lines, and note the time of each row that they take."""
    for line in lines:
        for row in line.wrap(console, WIDTH) or [line]:
            console.print(row, no_wrap=True, overflow="crop")
            shown.append(at)


def animated(svg: str, shown: list[float]) -> str:
    """Let each row of a picture of a terminal appear at its time, in seconds."""

    def delayed(found: re.Match[str]) -> str:
        return f'{found[0]} style="animation: appear 0s {shown[int(found[1])]:.1f}s both"'

    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL).replace("Fira Code, monospace", "monospace")
    svg = re.sub(r'clip-path="url\(#first-line-(\d+)\)"', delayed, svg)
    appear = "@keyframes appear { from { visibility: hidden } to { visibility: visible } }"
    return svg.replace("<style>", f"<style>\n    {appear}", 1)


if __name__ == "__main__":
    main()
