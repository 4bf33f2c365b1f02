"""The workbench of a corpus: models behind their seam, judges beside it, and everything kept as it is made."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Any

from envcraft import __version__
from envcraft.corpus.history import History
from envcraft.errors import EnvCraftError
from envcraft.stages import Attempt, Case, Played, PolicyTry, Question, Reply, Workbench
from envcraft.target import Target
from envcraft_llm.findings import to_repair
from envcraft_llm.model import Message, Model, Request

from .judging import Judges

#: Of the name of an environment, so many letters are its title's.
_TITLE = 40


class NotKept(EnvCraftError):
    """The corpus cannot be written to."""


class Bench(Workbench):
    """What stages work with. `named` gives the model of a stage, `effort` how hard it thinks."""

    def __init__(
        self, history: History, model: Model, judges: Judges, named: Callable[[str], str], effort: str = ""
    ) -> None:
        self.judges = judges
        self._history = history
        self._model = model
        self._named = named
        self._effort = effort

    async def ask(self, case: Case, question: Question) -> Reply:
        """Raises ModelFailure, ModelStopped."""
        request = Request(
            self._named(question.stage),
            tuple(Message(role, text) for role, text in question.messages),  # type: ignore[arg-type]
            effort=self._effort,
            schema=question.schema,
            sample=question.sample,
            stage=question.stage,
            concept=case.concept,
            attempt=question.attempt,
        )
        answer = await self._model.ask(request)
        provenance = {"model": request.model, "request": request.key(), "prompt": question.prompt}
        if answer.model and answer.model != request.model:
            provenance["answered_by"] = answer.model
        return Reply(answer.text, answer.finish == "length", provenance)

    async def judge(self, case: Case, attempt: Attempt) -> None:
        """Raises CouldNotJudge."""
        known = self._history.judged(attempt, case) or _same(case, attempt)
        attempt.report, attempt.profile = known or await self.judges.judge(_target(case, attempt))

    async def play(self, case: Case, attempt: Attempt, policy: str) -> Played:
        """Raises CouldNotJudge."""
        report, (wins, episodes) = await self.judges.play(_target(case, attempt), policy)
        return Played(report, wins, episodes)

    def keep_brief(self, case: Case, text: str, provenance: dict[str, Any]) -> None:
        case.brief = text
        self._history.keep_brief(case, text, provenance)

    def keep_attempt(self, case: Case, attempt: Attempt) -> None:
        case.attempts = [other for other in case.attempts if other.number != attempt.number] + [attempt]
        case.attempts.sort(key=lambda other: other.number)
        result = ""
        if attempt.report is not None:
            result = "gutted" if attempt.gutted else "faulty" if to_repair(attempt.report) else "sound"
        with _kept():
            self._history.keep_attempt(case, attempt, result)

    def drop_attempts(self, case: Case, number: int) -> None:
        case.attempts = [attempt for attempt in case.attempts if attempt.number < number]
        self._history.drop_attempts(case, number)

    def keep_policy(self, case: Case, policy: PolicyTry) -> None:
        case.policies = [other for other in case.policies if other.number != policy.number] + [policy]
        case.policies.sort(key=lambda other: other.number)
        self._history.keep_policy(case, policy)

    def publish(self, case: Case, attempt: Attempt) -> str:
        name = f"{file_name(case)}.py"
        origin = {
            "concept": case.concept,
            "title": case.title,
            "attempt": attempt.number,
            "envcraft": __version__,
            "generated": attempt.provenance,
        }
        with _kept():
            self._history.publish(case, attempt, name, origin)
        return name


@contextlib.contextmanager
def _kept() -> Iterator[None]:
    """Tell what the disk refuses apart from what a stage does with files of its own. Raises NotKept."""
    try:
        yield
    except OSError as error:
        where = error.filename or "the corpus"
        raise NotKept(f"{where} cannot be written: {error.strerror or error}") from None


def file_name(case: Case) -> str:
    """A name for the file of a concept's environment, without ``.py``: an identifier that no other concept has."""
    title = re.sub(r"[^a-z0-9]+", "_", case.title.lower()).strip("_")[:_TITLE].strip("_")
    return f"{title or 'game'}_{case.concept[:8]}" if title[:1].isalpha() else f"game_{case.concept[:8]}"


def _same(case: Case, attempt: Attempt) -> tuple[Any, dict[str, Any]] | None:
    """What was found out about the same source in another attempt, as this run judges."""
    for other in case.attempts:
        if other.number == attempt.number or other.report is None:
            continue
        if (other.source, other.env_class) == (attempt.source, attempt.env_class):
            return other.report, other.profile
    return None


def _target(case: Case, attempt: Attempt) -> Target:
    return Target(f"{file_name(case)}.py", attempt.source.encode(), attempt.env_class or None)
