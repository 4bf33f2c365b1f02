"""The report's JSON is a public format."""

from __future__ import annotations

import json
from typing import Any

import jsonschema
import msgspec
import numpy as np
import pytest

from envcraft import __version__
from envcraft.model.verdict import (
    CheckReport,
    Finding,
    Report,
    Repro,
    SandboxReport,
    Severity,
    SubjectReport,
    Verdict,
    overall,
)

_FINDING = {
    "type": "object",
    "required": ["code", "severity", "message", "line", "evidence", "repro"],
    "properties": {
        "code": {"type": "string", "pattern": r"^EC\d{3}$"},
        "severity": {"enum": ["error", "warning"]},
        "message": {"type": "string"},
        "line": {"type": ["integer", "null"]},
        "evidence": {"type": "object"},
        "repro": {
            "type": "object",
            "required": ["seed", "actions", "conditions"],
            "properties": {
                "seed": {"type": "integer"},
                "actions": {"type": "array"},
                "conditions": {"type": "object"},
            },
        },
    },
}
_CHECK = {
    "type": "object",
    "required": ["check", "verdict", "seconds", "findings"],
    "properties": {
        "verdict": {"enum": ["pass", "fail", "skip", "error"]},
        "seconds": {"type": "number"},
        "findings": {"type": "array", "items": _FINDING},
    },
}
_SUBJECT = {
    "type": "object",
    "required": ["path", "env_class", "source_sha256", "verdict", "isolation", "seconds", "steps", "checks", "sandbox"],
    "properties": {
        "source_sha256": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
        "isolation": {"enum": ["container", "namespace", "process"]},
        "steps": {"type": "integer"},
        "checks": {"type": "array", "items": _CHECK},
        "sandbox": {
            "type": "object",
            "required": ["driver", "layers", "missing", "image"],
            "properties": {
                "driver": {"type": "string"},
                "layers": {"type": "array", "items": {"type": "string"}},
                "missing": {"type": "array", "items": {"type": "string"}},
                "image": {"type": ["string", "null"], "pattern": "^sha256:[0-9a-f]{64}$"},
            },
        },
    },
}
SCHEMA = {
    "type": "object",
    "required": ["schema", "envcraft", "contract", "seed", "reports"],
    "properties": {
        "schema": {"const": 1},
        "envcraft": {"const": __version__},
        "contract": {"type": "string"},
        "seed": {"type": "integer"},
        "reports": {"type": "array", "items": _SUBJECT},
    },
}


def report(**evidence: Any) -> Report:
    finding = Finding(
        "EC301", Severity.ERROR, "the reward is nan", 4, evidence, Repro(1, [[0, 0, 0]], {"render": True})
    )
    check = CheckReport("reward", Verdict.FAIL, 0.5, [finding])
    ran_in = SandboxReport("docker", ["no network"], ["swap limit"], "sha256:" + "0" * 64)
    subject = SubjectReport("a.py", "A", "0" * 64, Verdict.FAIL, "container", 1.0, 7, [check], "docker", sandbox=ran_in)
    return Report("arcade", 0, [subject])


def test_json_follows_the_schema_and_comes_back() -> None:
    encoded = report(step=3).to_json()
    jsonschema.validate(json.loads(encoded), SCHEMA)
    assert list(json.loads(encoded))[:4] == ["schema", "envcraft", "contract", "seed"]
    assert msgspec.json.decode(encoded, type=Report) == report(step=3)


def test_the_schema_of_this_test_can_fail() -> None:
    broken = json.loads(report().to_json())
    broken["reports"][0]["checks"][0]["findings"][0]["code"] = "E1"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(broken, SCHEMA)


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (float("nan"), "nan"),
        (float("-inf"), "-inf"),
        (np.float32(1.5), 1.5),
        (np.bool_(True), True),
        (2**80, str(2**80)),
        (2**63, 2**63),
        ("lone \udc80", "lone \\udc80"),
        ((1, None), [1, None]),
        ({1: {"a": float("inf")}}, {"1": {"a": "inf"}}),
        (b"x", "b'x'"),
    ],
)
def test_evidence_of_any_kind_can_be_written(value: Any, written: Any) -> None:
    decoded = json.loads(report(value=value).to_json())
    assert decoded["reports"][0]["checks"][0]["findings"][0]["evidence"]["value"] == written


@pytest.mark.parametrize(
    ("verdicts", "wanted"),
    [
        ([], "pass"),
        (["pass", "skip"], "pass"),
        (["skip"], "pass"),
        (["pass", "error", "skip"], "error"),
        (["error", "fail", "pass"], "fail"),
    ],
)
def test_a_failure_comes_before_an_error(verdicts: list[str], wanted: str) -> None:
    assert overall([CheckReport("c", Verdict(verdict)) for verdict in verdicts]) == wanted
