"""Each rule has a guide, whose example has the defect."""

from __future__ import annotations

import ast

import pytest

from envcraft.judging.guide import guide_file
from envcraft.judging.selection import all_checks
from envcraft.model.verdict import SubjectReport
from envcraft.registry import offered
from evaluation.guides import examples_of_guides, judge_examples

RULES = {rule.code: (rule, check) for check in all_checks() for rule in check.rules}
EXAMPLES = examples_of_guides(all_checks())
#: Codes whose example is not judged here.
APART = {
    "EC010": "an example of megabytes is none; a test of its own makes such a file",
    **dict.fromkeys(("EC851", "EC852", "EC853"), "it trains for minutes; tests/plugins/dqn judges such games"),
}


@pytest.fixture(scope="session")
def reports(request: pytest.FixtureRequest) -> dict[str, SubjectReport]:
    # Only the examples that options such as -k have left.
    items = [item for item in request.session.items if isinstance(item, pytest.Function)]
    chosen = {item.callspec.params.get("code") for item in items if hasattr(item, "callspec")}
    # Faster than a container for each worker.
    bubblewrap = next(driver for driver in offered("envcraft_sandbox_drivers") if driver.name == "bubblewrap")
    sandbox = "bubblewrap" if bubblewrap.probe().works else "auto"
    return dict(judge_examples((set(EXAMPLES) & chosen) - set(APART), sandbox))


@pytest.mark.parametrize("code", RULES)
def test_the_example_has_the_defect(code: str, reports: dict[str, SubjectReport]) -> None:
    assert code in EXAMPLES, f"{code} has no guide: write {guide_file(RULES[code][1], code)}"
    if code in APART:
        ast.parse(EXAMPLES[code][1].source)
        return
    found = {finding.code: finding.message for check in reports[code].checks for finding in check.findings}
    assert code in found, found


def test_no_guide_is_left_over() -> None:
    folders = {guide_file(check, "").parent for check in all_checks()}
    files = {path.stem for folder in folders if folder.is_dir() for path in folder.iterdir()}
    assert files <= set(RULES)
