"""JUnit XML: well formed with any strings, and junitparser reads the content of the report."""

from __future__ import annotations

from xml.etree import ElementTree

from hypothesis import given, settings
from junitparser import Error, Failure, JUnitXml, Skipped, TestCase, TestSuite

from envcraft.model.verdict import CheckReport, Report, Verdict
from envcraft.reports.junit import JUnitReporter
from tests.envcraft.report_samples import MESSAGE, REPORTS, TRACEBACK, hostile, many, rendered, sample, subject

_KINDS = {Verdict.FAIL: Failure, Verdict.ERROR: Error, Verdict.SKIP: Skipped}


def suites(report: Report) -> list[TestSuite]:
    """What junitparser reads, through a stream that takes nothing but ASCII."""
    root = JUnitXml.fromstring(rendered(JUnitReporter, report, encoding="ascii").encode())
    assert isinstance(root, JUnitXml)
    return list(root)


def test_each_check_is_a_case() -> None:
    good, bad, lost = suites(sample())
    assert [good.name, bad.name, lost.name] == ["good.py", "games/bad game.py", "lost.py"]
    cases = {case.name: case for case in bad}
    assert list(cases) == ["source", "api", "determinism", "difficulty"]
    assert {case.classname for case in bad} == {"games/bad game.py"}
    assert cases["api"].time == 1.25
    assert cases["source"].result == []
    (failure,) = cases["api"].result
    assert isinstance(failure, Failure)
    assert failure.type == "EC107"
    assert failure.message == "EC107: step 155 raises IndexError (and 1 more finding)"
    assert failure.text.count("step 155 raises IndexError") == 2
    (skipped,) = cases["difficulty"].result
    assert isinstance(skipped, Skipped)
    assert skipped.message == "the budget settled nothing"
    (error,) = next(case for case in lost if case.name == "api").result
    assert isinstance(error, Error)
    assert error.message == "the worker stopped answering"


def test_counts_and_times() -> None:
    good, bad, lost = suites(sample())
    assert [(suite.tests, suite.failures, suite.errors, suite.skipped) for suite in (good, bad, lost)] == [
        (2, 0, 0, 0),
        (4, 2, 0, 1),
        (2, 0, 1, 0),
    ]
    assert good.time == 2.5
    root = JUnitXml.fromstring(rendered(JUnitReporter, sample()).encode())
    assert (root.tests, root.failures, root.errors, root.skipped, root.time) == (8, 2, 1, 1, 7.5)


def test_properties_say_how_it_was_judged() -> None:
    properties = {prop.name: prop.value for prop in suites(sample())[1].properties()}  # type: ignore[no-untyped-call]
    assert properties["class"] == "Game"
    assert properties["contract"] == "arcade"
    assert properties["seed"] == "3"
    assert properties["steps"] == "20480"
    assert properties["isolation"] == "container"
    assert properties["not in force"] == "Landlock"


def test_the_output_tells_how_to_see_it_again() -> None:
    good, bad, _ = suites(sample())
    cases = {case.name: case for case in bad}
    output = cases["determinism"].system_out
    for words in (
        "#4 EC203 hash-seed (error) games/bad game.py:41",
        MESSAGE,
        "fix: Sort sets before iterating over them.",
        "step: 12",
        "reproduction: seed 3, 12 actions, hash_seed 1, fresh worker",
        '"actions": [[0, 1, 0]',
        "envcraft validate 'games/bad game.py' --seed 3 --checks source,api,determinism,difficulty --format json ",
        "envcraft replay report.json --finding 3",
        "#5 EC209 same-seeds (warning)",
    ):
        assert words in output, words
    assert TRACEBACK.strip() in cases["api"].system_out
    warned = next(case for case in good if case.name == "determinism")
    assert warned.result == []
    assert "#1 EC209" in warned.system_out


def test_a_subject_lost_before_any_check_is_an_error() -> None:
    alone = subject("a.py", [CheckReport("source", Verdict.PASS)], reason="the pool is gone")
    alone.verdict = Verdict.ERROR
    (suite,) = suites(Report("arcade", 0, [alone]))
    assert (suite.tests, suite.errors) == (2, 1)


def test_hostile_words_stay_words() -> None:
    read = suites(hostile())
    assert len(read) == len(hostile().reports)
    for suite in read:
        assert [type(case.result[0]) if case.result else None for case in suite] == [None, Failure, Skipped, Error]
    allowed = {"testsuites", "testsuite", "properties", "property", "testcase", "failure", "error", "skipped"}
    root = ElementTree.fromstring(rendered(JUnitReporter, hostile()))
    assert {element.tag for element in root.iter()} == allowed | {"system-out"}


def test_a_corpus_is_read() -> None:
    assert len(suites(many(300))) == 300


@settings(deadline=None, max_examples=100)
@given(REPORTS)
def test_any_report_is_read(report: Report) -> None:
    for suite, judged in zip(suites(report), report.reports, strict=True):
        cases: list[TestCase] = list(suite)
        for case, check in zip(cases, judged.checks, strict=False):
            found = [type(result) for result in case.result]
            assert found == ([] if check.verdict is Verdict.PASS else [_KINDS[check.verdict]])
        lost = judged.verdict is Verdict.ERROR and not [c for c in judged.checks if c.verdict is Verdict.ERROR]
        assert len(cases) == len(judged.checks) + lost
