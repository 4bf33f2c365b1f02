"""SARIF: valid against the OASIS schema with any report, with each finding at its place."""

from __future__ import annotations

import json
import os
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes, urlsplit

import jsonschema
import msgspec
import pytest
from hypothesis import given, settings

from envcraft.model.verdict import Report, Verdict
from envcraft.reports.sarif import SarifReporter
from tests.envcraft.report_samples import MESSAGE, REPORTS, RULES, hostile, many, rendered, sample, subject

SCHEMAS = Path(__file__).resolve().parent.parent / "schemas"


@cache
def validator() -> jsonschema.Draft7Validator:
    schema = json.loads((SCHEMAS / "sarif-schema-2.1.0.json").read_text("utf-8"))
    return jsonschema.Draft7Validator(schema, format_checker=jsonschema.Draft7Validator.FORMAT_CHECKER)


def sarif(report: Report) -> Any:
    """The log, which is valid."""
    log = json.loads(rendered(SarifReporter, report, encoding="ascii"), parse_constant=pytest.fail)
    errors = [f"{error.json_path}: {error.message}" for error in validator().iter_errors(log)]
    assert not errors, errors[:3]
    return log["runs"][0]


def test_schema_rejects_an_invalid_report() -> None:
    assert list(validator().iter_errors({"version": "2.1.0", "runs": [{"tool": {"driver": {}}}]}))


def test_a_finding_is_a_result_with_its_rule_and_place() -> None:
    run = sarif(sample())
    rules = run["tool"]["driver"]["rules"]
    assert [rule["id"] for rule in rules] == list(RULES)
    assert "Sort sets before iterating" in rules[1]["help"]["text"]
    assert "Sort sets before iterating" in rules[1]["help"]["markdown"]
    assert [rule["defaultConfiguration"]["level"] for rule in rules] == ["error", "error", "warning"]
    assert not [rule for rule in rules if "helpUri" in rule]
    same, first, second, order, _ = run["results"]
    assert (same["ruleId"], same["level"]) == ("EC209", "warning")
    assert "region" not in same["locations"][0]["physicalLocation"]
    assert rules[order["ruleIndex"]]["id"] == order["ruleId"] == "EC203"
    assert order["level"] == "error"
    assert order["message"]["text"] == MESSAGE
    place = order["locations"][0]["physicalLocation"]
    assert place["artifactLocation"] == {"uri": "games/bad%20game.py", "uriBaseId": "SRCROOT", "index": 1}
    assert place["region"] == {"startLine": 41}
    assert order["properties"]["number"] == 4
    assert order["properties"]["evidence"] == {"step": 12, "reward": "nan"}
    assert order["properties"]["reproduction"] == {
        "seed": 3,
        "actions": [[0, 1, 0]] * 12,
        "conditions": {"hash_seed": 1, "fresh": True},
    }
    assert first["partialFingerprints"] != second["partialFingerprints"]


def test_what_could_not_be_judged_is_a_notification() -> None:
    run = sarif(sample())
    invocation = run["invocations"][0]
    assert (invocation["executionSuccessful"], invocation["exitCode"]) == (False, 1)
    (notification,) = invocation["toolExecutionNotifications"]
    assert notification["message"]["text"] == "the check api could not judge: the worker stopped answering"
    assert notification["locations"][0]["physicalLocation"]["artifactLocation"]["uri"] == "lost.py"
    artifact = run["artifacts"][1]
    assert artifact["properties"]["skipped"] == {"difficulty": "the budget settled nothing"}
    assert artifact["properties"]["sandbox"]["missing"] == ["Landlock"]
    lost = Report("arcade", 0, [sample().reports[2]])
    assert sarif(lost)["invocations"][0]["exitCode"] == 3
    good = sarif(Report("arcade", 0, [sample().reports[0]]))["invocations"][0]
    assert (good["executionSuccessful"], good["exitCode"], good["toolExecutionNotifications"]) == (True, 0, [])
    alone = subject("a.py", [], reason="the pool is gone")
    alone.verdict = Verdict.ERROR
    (notification,) = sarif(Report("arcade", 0, [alone]))["invocations"][0]["toolExecutionNotifications"]
    assert notification["message"]["text"] == "could not be judged: the pool is gone"


def test_a_fingerprint_outlives_an_edit_of_the_file() -> None:
    before, after = sample(), sample()
    after.reports[1].source_sha256 = "1" * 64
    finding = after.reports[1].checks[2].findings[0]
    after.reports[1].checks[2].findings[0] = msgspec.structs.replace(finding, line=57, message="differs at step 13")
    prints = [[result["partialFingerprints"] for result in sarif(report)["results"]] for report in (before, after)]
    assert prints[0] == prints[1]
    assert len({str(one) for one in prints[0]}) == len(prints[0])


def test_paths_count_from_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "wörk"
    work.mkdir()
    monkeypatch.chdir(work)
    paths = ["a:b.py", str(work / "games" / "ü?#%.py"), "../outside.py", "./x/../y.py", os.fsdecode(b"\xff.py")]
    run = sarif(Report("arcade", 0, [subject(path, []) for path in paths]))
    uris = [artifact["location"]["uri"] for artifact in run["artifacts"]]
    outside = "file://" + str(tmp_path) + "/outside.py"
    assert uris == ["a%3Ab.py", "games/%C3%BC%3F%23%25.py", outside, "y.py", "%FF.py"]
    assert [artifact["location"].get("uriBaseId") for artifact in run["artifacts"]].count("SRCROOT") == 4
    assert str(tmp_path) not in json.dumps(run["originalUriBaseIds"])


def test_hostile_words_stay_words() -> None:
    run = sarif(hostile())
    messages = [result["message"]["text"] for result in run["results"]]
    assert not [message for message in messages if "](" in message]
    assert not [message for message in messages if {"\x1b", "\x00", "\n", "\u202e"} & set(message)]


def test_a_corpus_is_valid() -> None:
    assert len(sarif(many(300))["results"]) == 400


@settings(deadline=None, max_examples=60)
@given(REPORTS)
def test_any_report_is_valid(report: Report) -> None:
    run = sarif(report)
    for artifact, judged in zip(run["artifacts"], report.reports, strict=True):
        uri = urlsplit(artifact["location"]["uri"])
        assert not uri.netloc
        assert not uri.query + uri.fragment
        here = os.path.abspath(judged.path)
        assert os.path.abspath(os.fsdecode(unquote_to_bytes(uri.path))) == here
