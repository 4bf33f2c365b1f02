"""The fixture `envcraft` and the marker of the same name."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Iterable
from os import PathLike
from typing import Any, NoReturn, TypedDict, Unpack

import pytest

from envcraft.errors import EnvCraftError, UsageError
from envcraft.model.verdict import CheckReport, SubjectReport, Verdict
from envcraft.pytest_plugin import words
from envcraft.pytest_plugin.items import could_not_judge, count, settle
from envcraft.pytest_plugin.judging import Case, Judged, judge_of, settings, spec_of
from envcraft.pytest_plugin.settings import SETTINGS
from envcraft.registry import did_you_mean

Judgeable = type | str | PathLike[str]


class Options(TypedDict, total=False):
    """The options of a call. Checks are a list, or names separated by commas."""

    checks: str | Iterable[str]
    skip: str | Iterable[str]
    contract: str
    budget: str
    seed: int
    sandbox: str


class EnvCraft:
    """Judge environments from within a test.

    The test's marker gives the defaults of each call. Equal calls share one sandbox run.

    Attributes:
        report: in a test that stands for one check, what the check found; else None.
    """

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._node: pytest.Item = request.node
        self.report: CheckReport | None = None
        if isinstance(case := getattr(request, "param", None), Case):
            self.report = settle(self._node, case).own

    def judge(self, target: Judgeable | None = None, **options: Unpack[Options]) -> SubjectReport:
        """Judge an environment and return its report."""
        return self._judge(target, options).report

    def check(self, target: Judgeable | None = None, **options: Unpack[Options]) -> SubjectReport:
        """Judge an environment and fail the test if it fails.

        The test is an error if a check could not judge.
        """
        judged = self._judge(target, options)
        if judged.report.verdict is Verdict.FAIL:
            pytest.fail(words.failure(judged, judged.report.checks), pytrace=False)
        if judged.report.verdict is Verdict.ERROR:
            raise could_not_judge(words.error(judged, judged.report.checks))
        return judged.report

    def _judge(self, target: Judgeable | None, options: Options) -> Judged:
        config = self._node.config
        given = marked(self._node) | {name: value for name, value in options.items() if value is not None}
        marker_target = given.pop("target", None)
        target = marker_target if target is None else target
        try:
            if unknown := sorted(set(given) - set(SETTINGS)):
                raise UsageError(f"there is no option {did_you_mean(unknown[0], SETTINGS)}")
            if target is None:
                raise UsageError("the target is missing: pass one, or name one in the marker envcraft")
            judged = judge_of(config).subject(spec_of(target, config.rootpath), settings(config, given))
        except EnvCraftError as error:
            raise could_not_judge(words.unjudged(error)) from None
        count(self._node, judged)
        return judged


def cases(test: pytest.Item) -> list[Case]:
    """Return one case for each check of a marked test, or none if the marker names no target."""
    marker = marked(test)
    target = marker.pop("target", None)
    if target is None:
        if not _asks(test):
            _wrong_marker(
                test, "names no target, and the test does not take the fixture envcraft, so nothing is judged"
            )
        return []
    try:
        chosen = settings(test.config, marker)
        spec = spec_of(target, test.config.rootpath)
        # Else the test of each check would be the same error.
        judge_of(test.config).target(spec)
        selected = chosen.selected(chosen.severity(test.config.rootpath))
        return [Case(spec, chosen.for_one(), check.name) for check in selected]
    except EnvCraftError as error:
        _wrong_marker(test, f"is invalid: {error}")


def _asks(test: Any) -> bool:
    """Return whether a test, or a fixture of it, takes the fixture envcraft."""
    definitions = itertools.chain.from_iterable(test._fixtureinfo.name2fixturedefs.values())
    return any(
        "envcraft" in names
        for names in (inspect.signature(test.function).parameters, *(one.argnames for one in definitions))
    )


def marked(test: pytest.Item) -> dict[str, Any]:
    """Join the arguments of a test's markers; the nearest marker wins."""
    found: dict[str, Any] = {}
    for marker in test.iter_markers("envcraft"):
        given = dict(marker.kwargs)
        if unknown := sorted(set(given) - {"target", *SETTINGS}):
            _wrong_marker(test, f"has no {unknown[0]}; it takes target, {', '.join(SETTINGS)}")
        if len(marker.args) + ("target" in given) > 1:
            _wrong_marker(test, "takes one target")
        if marker.args:
            given["target"] = marker.args[0]
        found = {name: value for name, value in given.items() if value is not None} | found
    return found


def _wrong_marker(test: pytest.Item, words: str) -> NoReturn:
    # The sentence has the words of the error that is handled: pytest would print them a second time.
    raise pytest.fail.Exception(f"the marker envcraft of {test.name} {words}", pytrace=False) from None
