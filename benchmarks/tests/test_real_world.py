"""The table of yields counts environments, not findings, and leaves out what could not be judged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.real_world import main, table


def report(path: str, verdict: str, *codes: str) -> dict[str, Any]:
    found = [{"code": code, "severity": "error", "message": f"{code} is there", "line": 3} for code in codes]
    return {"path": path, "verdict": verdict, "seconds": 2.0, "steps": 100, "checks": [{"findings": found}]}


REPORTS = [
    report("a.py", "fail", "EC107", "EC107", "EC204"),
    report("b.py", "fail", "EC204"),
    report("c.py", "pass"),
    report("d.py", "pass"),
    report("e.py", "error", "EC301"),
]


def test_environments_are_counted() -> None:
    lines = table(REPORTS).splitlines()
    assert lines[0].startswith("4 environments were judged, 1 could not be: 2 pass, 2 fail.")
    assert lines[4:] == [
        "| EC107 | error | 1 | 25.0% (0.6% to 80.6%) |",
        "| EC204 | error | 2 | 50.0% (6.8% to 93.2%) |",
    ]


def test_a_sample_names_file_and_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "report.json"
    path.write_text(json.dumps({"reports": REPORTS}))
    main([str(path), "--sample", "1"])
    assert "EC107 a.py:3 EC107 is there" in capsys.readouterr().out
