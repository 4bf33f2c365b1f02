"""The examples of the rules' guides, and the judging of all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from envcraft.contracts.lookup import contract_named
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan
from envcraft.judging.guide import Example, guide_of
from envcraft.judging.selection import all_checks, driver_named
from envcraft.judging.severity import SeverityPolicy
from envcraft.model.target import PolicyFile, Target
from envcraft.model.verdict import SubjectReport
from evaluation.judge import LIMITS, judge_plans


def examples_of_guides(checks: Iterable[Check]) -> dict[str, tuple[Check, Example]]:
    """The example of each code that has a guide, with its check."""
    found = {}
    for check in checks:
        for rule in check.rules:
            if guide := guide_of(check, rule.code):
                found[rule.code] = check, guide.code()
    return found


def judge_examples(codes: Iterable[str], sandbox: str = "auto") -> Iterator[tuple[str, SubjectReport]]:
    """Judge the examples of these codes by their own check, at `quick` unless they name another budget."""
    codes, driver = list(codes), driver_named(sandbox)
    every = all_checks()
    examples = examples_of_guides(every)
    plans = []
    for code in codes:
        check, example = examples[code]
        settings = example.settings
        rule = check.rule(code)
        # A check that always runs judges what happened while others played.
        player = "api" if check.always else check.name
        plans.append(
            Plan(
                [Target(f"{code}.py", example.source.encode())],
                contract_named(settings.get("contract", "arcade")),
                driver,
                [each for each in every if each.gate or each.always or each.name == player],
                BUDGETS[settings.get("budget", "quick")],
                limits=LIMITS,
                # For an author, an error of the policy is wrong use and no finding.
                severity=SeverityPolicy(comments=not rule.about_policy, select=() if rule.default else (code,)),
                policy=PolicyFile("policy.py", example.policy) if example.policy else None,
                parallel_jobs=1,
            )
        )
    for number, report in judge_plans(plans):
        yield codes[number], report
