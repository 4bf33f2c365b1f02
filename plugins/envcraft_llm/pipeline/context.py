"""The stage context of a corpus: it calls the model, judges in the sandbox and stores everything in the corpus."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Any

from envcraft import __version__
from envcraft.errors import EnvCraftError
from envcraft.generation.history import History
from envcraft.generation.stages import (
    Attempt,
    ConceptState,
    PolicyAttempt,
    PolicyEvaluation,
    StageContext,
    StageReply,
    StageRequest,
)
from envcraft.model.target import Target
from envcraft_llm.findings import to_repair
from envcraft_llm.model import Message, Model, Request

from .judging import JudgeExecutor

#: Characters of the title in an environment's name.
_TITLE_LENGTH = 40


class CorpusWriteError(EnvCraftError):
    """The corpus cannot be written."""


class CorpusContext(StageContext):
    """The services of the stages, on top of a corpus.

    Args:
        history: Tables of generation in the corpus.
        model: The model, or the dispatcher of several.
        judges: Executor of checks.
        model_for: Returns the name of the model for a stage.
        effort: Reasoning effort, or "".
    """

    def __init__(
        self, history: History, model: Model, judges: JudgeExecutor, model_for: Callable[[str], str], effort: str = ""
    ) -> None:
        self._history = history
        self._model = model
        self._judges = judges
        self._model_for = model_for
        self._effort = effort

    async def generate(self, state: ConceptState, request: StageRequest) -> StageReply:
        """Return a model's completion.

        Raises:
            RequestFailed: If this request failed.
            ModelUnavailable: If no request can succeed.
        """
        model_request = Request(
            self._model_for(request.stage),
            tuple(Message(role, text) for role, text in request.messages),  # type: ignore[arg-type]
            effort=self._effort,
            schema=request.schema,
            sample=request.sample,
            stage=request.stage,
            concept=state.concept,
            attempt=request.attempt,
        )
        completion = await self._model.generate(model_request)
        provenance = {"model": model_request.model, "request": model_request.key(), "prompt": request.prompt}
        if completion.model and completion.model != model_request.model:
            provenance["answered_by"] = completion.model
        return StageReply(completion.text, completion.finish == "length", provenance)

    async def judge(self, state: ConceptState, attempt: Attempt) -> None:
        """Run all checks on an attempt, unless its source has a report already. Raises JudgingError."""
        known = self._history.judged(attempt, state) or _same_source(state, attempt)
        attempt.report, attempt.profile = known or await self._judges.judge(_target(state, attempt))

    async def play(self, state: ConceptState, attempt: Attempt, policy: str) -> PolicyEvaluation:
        """Run a privileged policy on an attempt's environment. Raises JudgingError."""
        report, (wins, episodes) = await self._judges.play(_target(state, attempt), policy)
        return PolicyEvaluation(report, wins, episodes)

    def keep_brief(self, state: ConceptState, text: str, provenance: dict[str, Any]) -> None:
        state.brief = text
        self._history.keep_brief(state, text, provenance)

    def keep_attempt(self, state: ConceptState, attempt: Attempt) -> None:
        state.attempts = [other for other in state.attempts if other.number != attempt.number] + [attempt]
        state.attempts.sort(key=lambda other: other.number)
        result = ""
        if attempt.report is not None:
            result = "gutted" if attempt.degenerate else "faulty" if to_repair(attempt.report) else "sound"
        with _write_errors():
            self._history.keep_attempt(state, attempt, result)

    def drop_attempts(self, state: ConceptState, number: int) -> None:
        state.attempts = [attempt for attempt in state.attempts if attempt.number < number]
        self._history.drop_attempts(state, number)

    def keep_policy(self, state: ConceptState, policy: PolicyAttempt) -> None:
        state.policies = [other for other in state.policies if other.number != policy.number] + [policy]
        state.policies.sort(key=lambda other: other.number)
        self._history.keep_policy(state, policy)

    def publish(self, state: ConceptState, attempt: Attempt) -> str:
        name = f"{file_name(state)}.py"
        origin = {
            "concept": state.concept,
            "title": state.title,
            "attempt": attempt.number,
            "envcraft": __version__,
            "generated": attempt.provenance,
        }
        with _write_errors():
            self._history.publish(state, attempt, name, origin)
        return name


@contextlib.contextmanager
def _write_errors() -> Iterator[None]:
    """Raise OSError as CorpusWriteError, to distinguish it from errors of a stage's own files."""
    try:
        yield
    except OSError as error:
        where = error.filename or "the corpus"
        raise CorpusWriteError(f"{where} cannot be written: {error.strerror or error}") from None


def file_name(state: ConceptState) -> str:
    """Return a name for a concept's environment, without ``.py``: a unique identifier."""
    title = re.sub(r"[^a-z0-9]+", "_", state.title.lower()).strip("_")[:_TITLE_LENGTH].strip("_")
    return f"{title or 'game'}_{state.concept[:8]}" if title[:1].isalpha() else f"game_{state.concept[:8]}"


def _same_source(state: ConceptState, attempt: Attempt) -> tuple[Any, dict[str, Any]] | None:
    """The report and the profile of another attempt with the same source, judged under the settings of this run."""
    for other in state.attempts:
        if other.number == attempt.number or other.report is None:
            continue
        if (other.source, other.env_class) == (attempt.source, attempt.env_class):
            return other.report, other.profile
    return None


def _target(state: ConceptState, attempt: Attempt) -> Target:
    return Target(f"{file_name(state)}.py", attempt.source.encode(), attempt.env_class or None)
