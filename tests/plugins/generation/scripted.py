"""A stage context whose completions and verdicts the test scripts."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

from envcraft.generation.stages import (
    Attempt,
    ConceptState,
    PolicyAttempt,
    PolicyEvaluation,
    Stage,
    StageContext,
    StageOutcome,
    StageReply,
    StageRequest,
)
from envcraft.model.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

PROFILE = {"steps": 1000, "frames": 400, "rewards": 5, "moves": 8, "longest": 200}


class ScriptedContext(StageContext):
    """Replies with `answers` in order, and with the last one repeatedly.

    `judged` returns the findings of a source, `plays` the evaluation of a policy. Requests and published attempts are
    recorded.
    """

    def __init__(
        self,
        answers: Sequence[str | StageReply],
        judged: Callable[[str], Sequence[Finding]] = lambda source: (),
        plays: Callable[[str], PolicyEvaluation] | None = None,
        profile: dict[str, Any] | None = None,
    ) -> None:
        self.answers, self.judged, self.plays, self.profile = list(answers), judged, plays, profile
        self.requests: list[StageRequest] = []
        self.published: list[int] = []

    async def generate(self, state: ConceptState, request: StageRequest) -> StageReply:
        answer = self.answers[min(len(self.requests), len(self.answers) - 1)]
        self.requests.append(request)
        return (
            answer
            if isinstance(answer, StageReply)
            else StageReply(answer, provenance={"request": str(len(self.requests))})
        )

    async def judge(self, state: ConceptState, attempt: Attempt) -> None:
        attempt.report = report(attempt.source, *self.judged(attempt.source))
        attempt.profile = dict(PROFILE if self.profile is None else self.profile)

    async def play(self, state: ConceptState, attempt: Attempt, policy: str) -> PolicyEvaluation:
        assert self.plays is not None
        return self.plays(policy)

    def keep_brief(self, state: ConceptState, text: str, provenance: dict[str, Any]) -> None:
        state.brief = text

    def keep_attempt(self, state: ConceptState, attempt: Attempt) -> None:
        state.attempts = [other for other in state.attempts if other.number != attempt.number] + [attempt]

    def drop_attempts(self, state: ConceptState, number: int) -> None:
        state.attempts = [attempt for attempt in state.attempts if attempt.number < number]

    def keep_policy(self, state: ConceptState, policy: PolicyAttempt) -> None:
        state.policies.append(policy)

    def publish(self, state: ConceptState, attempt: Attempt) -> str:
        self.published.append(attempt.number)
        return "game.py"


def finding(code: str, message: str = "it is wrong", line: int | None = None, **evidence: Any) -> Finding:
    repro = Repro(3, [[1, 0, 0], [4, 1, 0]])
    severity = Severity.WARNING if code in ("EC806", "EC808", "EC809") else Severity.ERROR
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
    """Return a report with these findings; `difficulty` is the verdict of that check if it has none."""
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


def state(**known: Any) -> ConceptState:
    return ConceptState("c0", "Errand", "Fetch the key.", **known)


def run(stage: Stage, about: ConceptState, context: StageContext) -> StageOutcome:
    return asyncio.run(stage.run(about, context))


def fenced(source: str) -> str:
    return f"Here it is.\n\n```python\n{source}```\n"
