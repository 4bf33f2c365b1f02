"""The real command line on ``examples/``: its JSON report, and the replay of every finding."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from evaluation.fixtures import examples

#: `make demo` uses the strongest sandbox.
SANDBOX = ("--sandbox", "process")
_VERDICT = {"enum": ["pass", "fail", "skip", "error"]}
_FINDING = {
    "type": "object",
    "required": ["code", "severity", "message", "line", "evidence", "repro"],
    "properties": {
        "code": {"pattern": "^EC[0-9]{3}$"},
        "severity": {"enum": ["error", "warning"]},
        "message": {"type": "string", "minLength": 1},
        "line": {"type": ["integer", "null"], "minimum": 1},
        "evidence": {"type": "object"},
        "repro": {
            "type": "object",
            "required": ["seed", "actions", "conditions"],
            "properties": {"seed": {"type": "integer"}, "actions": {"type": "array"}, "conditions": {"type": "object"}},
        },
    },
}
_CHECK = {
    "type": "object",
    "required": ["check", "verdict", "seconds", "findings"],
    "properties": {"verdict": _VERDICT, "seconds": {"type": "number"}, "findings": {"items": _FINDING}},
}
_SUBJECT = {
    "type": "object",
    "required": ["path", "env_class", "source_sha256", "verdict", "isolation", "seconds", "steps", "checks"],
    "properties": {
        "source_sha256": {"pattern": "^[0-9a-f]{64}$"},
        "verdict": _VERDICT,
        "isolation": {"const": "process"},
        "seconds": {"type": "number"},
        "steps": {"type": "integer", "minimum": 0},
        "checks": {"type": "array", "items": _CHECK, "minItems": 9},
    },
}
SCHEMA = {
    "type": "object",
    "required": ["schema", "envcraft", "contract", "seed", "reports"],
    "properties": {
        "schema": {"const": 1},
        "contract": {"const": "arcade"},
        "seed": {"const": 0},
        "reports": {"type": "array", "items": _SUBJECT},
    },
}


def envcraft(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "envcraft", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=900, check=False)


@pytest.fixture(scope="module")
def report(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("examples") / "report.json"
    files = [str(fixture.path.relative_to(root)) for fixture in examples()]
    options = (*SANDBOX, "--budget", "quick", "--format", "json", "--output", str(path))
    done = envcraft("validate", *files, *options, cwd=root)
    assert done.returncode == 1, done.stderr
    return path


def test_json_follows_the_schema(report: Path) -> None:
    data: dict[str, Any] = json.loads(report.read_text())
    jsonschema.validate(data, SCHEMA)
    assert len(data["reports"]) == len(examples())


def test_examples_get_the_codes_of_their_headers(report: Path, root: Path) -> None:
    entries = {entry["path"]: entry for entry in json.loads(report.read_text())["reports"]}
    assert sum(not fixture.codes for fixture in examples()) >= 8
    assert sum(bool(fixture.codes) for fixture in examples()) >= 12
    for fixture in examples():
        entry = entries[str(fixture.path.relative_to(root))]
        codes = {
            finding["code"]
            for check in entry["checks"]
            for finding in check["findings"]
            if finding["severity"] == "error"
        }
        assert codes == fixture.codes, entry["path"]
        assert entry["verdict"] == ("fail" if fixture.codes else "pass"), entry["path"]


@pytest.mark.parametrize("name", [fixture.path.name for fixture in examples() if not fixture.codes])
def test_a_policy_wins_each_game(name: str, root: Path) -> None:
    options = ("--policy", f"examples/policies/{name}", "--budget", "quick", "--format", "concise", "--strict")
    done = envcraft("validate", f"examples/{name}", *options, *SANDBOX, cwd=root)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed, 0 failed, 0 undecided" in done.stdout + done.stderr


def test_every_finding_is_reproduced(report: Path, root: Path) -> None:
    findings = [
        finding
        for entry in json.loads(report.read_text())["reports"]
        for check in entry["checks"]
        for finding in check["findings"]
    ]
    done = envcraft("replay", str(report), *SANDBOX, cwd=root)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(findings) >= 12
    for finding in findings:
        assert finding["code"] in done.stdout
    assert "not reproduced" not in done.stdout


def test_gif_of_a_reproduction(report: Path, root: Path, tmp_path: Path) -> None:
    picture = tmp_path / "finding.gif"
    codes = [
        finding["code"]
        for entry in json.loads(report.read_text())["reports"]
        for check in entry["checks"]
        for finding in check["findings"]
    ]
    number = str(codes.index("EC107") + 1)
    done = envcraft("replay", str(report), "--finding", number, "--gif", str(picture), *SANDBOX, cwd=root)
    assert done.returncode == 0, done.stdout + done.stderr
    assert picture.read_bytes().startswith(b"GIF89a")
