"""The fork server imports libraries once, unless they start threads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

_PRELOADS = "import sys\nfrom envcraft_sandbox.worker import server\nprint(server._preload(sys.argv[1:]))"


def preloaded(folder: Path, *modules: str) -> str:
    argv = [sys.executable, "-c", _PRELOADS, *modules]
    # As in a worker, NumPy starts no threads.
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(argv, cwd=folder, env=alone, capture_output=True, text=True, check=True)
    return ran.stdout.strip()


def test_what_starts_a_thread_is_not_shared(tmp_path: Path) -> None:
    threads = "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    (tmp_path / "quiet.py").write_text("import random\nDRAWN = random.random()\n")
    (tmp_path / "busy.py").write_text(threads)
    (tmp_path / "raises.py").write_text("raise ValueError\n")
    assert preloaded(tmp_path, "quiet", "raises") == "['quiet']"
    assert preloaded(tmp_path, "quiet", "busy") == "[]"


def test_an_allocator_that_expects_forks_may_have_a_thread(tmp_path: Path) -> None:
    (tmp_path / "allocator.py").write_text(
        "import ctypes, threading\n"
        "def run():\n"
        "    ctypes.CDLL(None).prctl(15, b'jemalloc_bg_thd', 0, 0, 0)\n"
        "    ready.set()\n"
        "    threading.Event().wait()\n"
        "ready = threading.Event()\n"
        "threading.Thread(target=run, daemon=True).start()\n"
        "ready.wait()\n"
    )
    assert preloaded(tmp_path, "allocator") == "['allocator']"
