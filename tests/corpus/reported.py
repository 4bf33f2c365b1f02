"""A corpus for reports, made without judging: hundreds of verdicts of every kind, some with hostile text."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest

from envcraft.corpus.report import media
from envcraft.corpus.store import Environment, Store
from envcraft.model.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict, overall

from .conftest import SETTINGS

SIZE = 620
CHECKS = ("source", "api", "determinism", "difficulty")
#: A name, and a text for every field that an environment controls.
HOSTILE = "=<img src=x onerror=a()>'\"&\u202e</script><script>document.title='owned'</script>.py"
CODES = {"source": "EC002", "api": "EC107", "determinism": "EC203"}


def fill(store: Store, size: int = SIZE) -> None:
    settings = store.settings(SETTINGS)
    # The tests do not depend on the disk.
    with pytest.MonkeyPatch.context() as patch, store.transaction():
        patch.setattr(os, "fsync", lambda descriptor: None)
        for number in range(size):
            name = f"games/env{number:04}.py" if number else HOSTILE
            data = source(number)
            store.add(name, data, origin={"attempt": number % 3} if number % 2 else {"words": HOSTILE})
            if number == 7:
                continue
            sha256 = hashlib.sha256(data).hexdigest()
            verdict = store.insert(sha256, "", settings, report(name, number, sha256))
            store.db.execute("UPDATE environments SET verdict = ? WHERE name = ?", (verdict, name))


def source(number: int) -> bytes:
    """A different program for each number, except 100, 101 and 102, which differ in a comment."""
    bits = 100 if number in (101, 102) else number
    words = [hashlib.sha256(f"{bits} {bit}".encode()).hexdigest()[:8] for bit in range(10)]
    body = [
        f"{'while' if bits >> bit & 1 else 'if'} w{word} == w{word[::-1]}:\n    v{word} = '{word * 2}'"
        for bit, word in enumerate(words)
    ]
    return "\n".join([f"# {number}", "import gymnasium", *([HOSTILE] if not number else []), *body, ""]).encode()


def report(name: str, number: int, sha256: str) -> SubjectReport:
    """Every fifth fails `api`, every seventh `determinism`; one cannot be imported, and one is an error."""
    failed = {"source": number == 11, "api": number % 5 == 0, "determinism": number % 7 == 0}
    words = HOSTILE if not number else f"step() raises at step {number}"
    checks = []
    for check in CHECKS:
        found = [
            Finding(CODES[check], Severity.ERROR, words, 2, {"traceback": words}, Repro(number, [[1, 0, 0]]))
            for _ in range(2 if failed.get(check) and check == "api" else failed.get(check, False))
        ]
        verdict = Verdict.FAIL if found else Verdict.PASS
        if check == "api" and number % 5 == 3:
            # A skipped check does not block the later ones.
            verdict = Verdict.SKIP
        if check == "difficulty":
            verdict = Verdict.SKIP if number % 2 else Verdict.ERROR if number == 22 else verdict
        if check != "source" and failed["source"]:
            found, verdict = [], Verdict.SKIP
        if check == "determinism" and not found:
            found = [Finding("EC209", Severity.WARNING, "the seed changes nothing")] if number % 10 == 1 else []
        checks.append(CheckReport(check, verdict, 0.1, found, words if verdict is Verdict.SKIP else ""))
    seconds = 90.0 if number == 33 else 1.0 + (number % 17) / 10
    env_class = HOSTILE if not number else "Game"
    return SubjectReport(name, env_class, sha256, overall(checks), "process", seconds, 1000 + number, checks)


def picture(store: Store, name: str) -> None:
    """Give an environment a preview: a white block that moves."""
    frames = [np.full((84, 84, 3), 60, np.uint8) for _ in range(media.FRAMES)]
    for step, frame in enumerate(frames):
        frame[40:46, step * 6 : step * 6 + 6] = 255
    data = media.encode(frames)
    row = store.db.execute("SELECT name, source, class FROM environments WHERE name = ?", (name,)).fetchone()
    media.record(store, Environment(*row), "test", data)


def written(root: Path, output: Path) -> Path:
    """The report on the corpus at `root`."""
    from envcraft.corpus.report.site import build
    from envcraft.judging.selection import all_checks

    with Store(root) as store:
        build(store, output, all_checks())
    return output
