"""``make interpreters``: install the wheel of ``dist/`` under the newer Pythons of this machine, and validate examples.

It needs a package index. A version that is absent or whose dependencies cannot be installed is reported and skipped.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from evaluation.fixtures import ROOT, expected

#: The versions after the oldest one, which `make test` runs under.
VERSIONS = ("3.12", "3.13", "3.14")
EXAMPLES = ("snake.py", "lander.py", "broken_invaders_nan_reward.py", "broken_pong_global_random.py")
_INSTALL_SECONDS = 120


def interpreter(version: str) -> str | None:
    """The path of a Python of this version that starts, on PATH or among pyenv's; None if there is none."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    candidates = [shutil.which(f"python{version}"), *map(str, sorted(pyenv.glob(f"versions/{version}.*/bin/python")))]
    asks = "import sys; print('.'.join(map(str, sys.version_info[:2])))"
    for candidate in filter(None, candidates):
        found = subprocess.run([candidate, "-c", asks], capture_output=True, text=True, timeout=60, check=False)
        if found.stdout.strip() == version:
            return candidate
    return None


def main() -> int:
    wheels = sorted((ROOT / "dist").glob("*.whl"), key=lambda path: path.stat().st_mtime)
    if not wheels:
        print("dist/ has no wheel: run `make dist`", file=sys.stderr)
        return 2
    results = {}
    for version in VERSIONS:
        with tempfile.TemporaryDirectory() as folder:
            results[version] = judge(version, wheels[-1], Path(folder))
        print(f"Python {version}: {results[version]}", flush=True)
    return int(any(result.startswith("wrong") for result in results.values()))


def judge(version: str, wheel: Path, folder: Path) -> str:
    """Install `wheel` in a new environment in `folder` and validate the examples there; return what came of it."""
    python = interpreter(version)
    if python is None:
        return "not on this machine"
    subprocess.run([python, "-m", "venv", "--without-pip", str(folder / "venv")], check=True, timeout=_INSTALL_SECONDS)
    program = folder / "venv" / "bin"
    try:
        installed = _install(wheel, program / "python")
    except subprocess.TimeoutExpired:
        return "the dependencies cannot be installed: out of time"
    if installed.returncode:
        return f"the dependencies cannot be installed: {installed.stderr.strip().splitlines()[-1]}"
    files = [ROOT / "examples" / name for name in EXAMPLES]
    options = ["--budget", "quick", "--sandbox", "process", "--format", "json"]
    command = [str(program / "envcraft"), "validate", *options, *map(str, files)]
    judged = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if judged.returncode != 1:
        return f"wrong: exit status {judged.returncode}: {judged.stderr}"
    for file, report in zip(files, json.loads(judged.stdout)["reports"], strict=True):
        codes = {
            each["code"] for check in report["checks"] for each in check["findings"] if each["severity"] == "error"
        }
        if not expected(file) <= codes or bool(codes) != bool(expected(file)):
            return f"wrong: {file.name} has {sorted(codes)} and not {sorted(expected(file))}"
    return f"{len(files)} examples judged as expected"


def _install(wheel: Path, python: Path) -> subprocess.CompletedProcess[str]:
    """As in the Makefile: uv takes a fraction of pip's time, and pip installs where uv cannot reach an index."""

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(words, capture_output=True, text=True, timeout=_INSTALL_SECONDS, check=False)

    uv = Path(sys.executable).with_name("uv")
    installed = run(str(uv), "pip", "install", "--quiet", "--compile-bytecode", "--python", str(python), str(wheel))
    if installed.returncode:
        run(str(python), "-m", "ensurepip")
        pip = (str(python), "-m", "pip", "install", "--quiet", "--retries", "1", "--timeout", "30")
        installed = run(*pip, str(wheel))
    return installed


if __name__ == "__main__":
    sys.exit(main())
