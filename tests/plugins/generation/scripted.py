"""A workbench whose model and judges say what a test wants."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

from envcraft.stages import Attempt, Case, Outcome, Played, PolicyTry, Question, Reply, Stage, Workbench
from envcraft.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

PROFILE = {"steps": 1000, "frames": 400, "rewards": 5, "moves": 8, "longest": 200}


class ScriptedBench(Workbench):
    """Gives `answers` in turn, the last one again and again; `judged` says which findings a source has, `plays` how a
    policy does. What was asked and kept is remembered.
    """

    def __init__(
        self,
        answers: Sequence[str | Reply],
        judged: Callable[[str], Sequence[Finding]] = lambda source: (),
        plays: Callable[[str], Played] | None = None,
        profile: dict[str, Any] | None = None,
    ) -> None:
        self.answers, self.judged, self.plays, self.profile = list(answers), judged, plays, profile
        self.asked: list[Question] = []
        self.published: list[int] = []

    async def ask(self, case: Case, question: Question) -> Reply:
        answer = self.answers[min(len(self.asked), len(self.answers) - 1)]
        self.asked.append(question)
        return answer if isinstance(answer, Reply) else Reply(answer, provenance={"request": str(len(self.asked))})

    async def judge(self, case: Case, attempt: Attempt) -> None:
        attempt.report = report(attempt.source, *self.judged(attempt.source))
        attempt.profile = dict(PROFILE if self.profile is None else self.profile)

    async def play(self, case: Case, attempt: Attempt, policy: str) -> Played:
        assert self.plays is not None
        return self.plays(policy)

    def keep_brief(self, case: Case, text: str, provenance: dict[str, Any]) -> None:
        case.brief = text

    def keep_attempt(self, case: Case, attempt: Attempt) -> None:
        case.attempts = [other for other in case.attempts if other.number != attempt.number] + [attempt]

    def drop_attempts(self, case: Case, number: int) -> None:
        case.attempts = [attempt for attempt in case.attempts if attempt.number < number]

    def keep_policy(self, case: Case, policy: PolicyTry) -> None:
        case.policies.append(policy)

    def publish(self, case: Case, attempt: Attempt) -> str:
        self.published.append(attempt.number)
        return "game.py"


def finding(code: str, message: str = "it is wrong", line: int | None = None, **evidence: Any) -> Finding:
    repro = Repro(3, [[1, 0, 0], [4, 1, 0]])
    severity = Severity.WARNING if code == "EC806" else Severity.ERROR
    return Finding(code, severity, message, line, evidence, repro)


CHECKS = {
    "0": "source",
    "1": "api",
    "2": "determinism",
    "4": "observation",
    "6": "instawin",
    "7": "instadeath",
    "8": "difficulty",
}


def report(source: str, *found: Finding, difficulty: Verdict = Verdict.PASS) -> SubjectReport:
    """A report of a few checks with these findings; `difficulty` is what that check says without any."""
    checks = []
    for digit, name in CHECKS.items():
        mine = [one for one in found if one.code[2] == digit]
        verdict = Verdict.FAIL if any(one.severity is Severity.ERROR for one in mine) else Verdict.PASS
        if name == "difficulty" and not mine:
            verdict = difficulty
        checks.append(CheckReport(name, verdict, 0.1, mine, "not all states were reached" if verdict == "skip" else ""))
    overall = Verdict.FAIL if any(check.verdict is Verdict.FAIL for check in checks) else Verdict.PASS
    sha256 = hashlib.sha256(source.encode()).hexdigest()
    return SubjectReport("game.py", "GameEnv", sha256, overall, "process", 0.5, 100, checks)


def case(**known: Any) -> Case:
    return Case("c0", "Errand", "Fetch the key.", **known)


def run(stage: Stage, about: Case, bench: Workbench) -> Outcome:
    return asyncio.run(stage.run(about, bench))


def fenced(source: str) -> str:
    return f"Here it is.\n\n```python\n{source}```\n"
