"""The runner: takes concepts through the stages concurrently, each from where an earlier run left it."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from envcraft.corpus.store import CorpusBusy, CorpusDamaged
from envcraft.errors import SandboxUnavailable
from envcraft.generation.history import History
from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome
from envcraft_llm.endpoint.journal import TRANSIENT
from envcraft_llm.model import ModelUnavailable, RequestFailed

from .context import CorpusWriteError
from .judging import JudgingError

#: Failures that are not the concept's; a later run tries the concept again.
_RETRIED = TRANSIENT | {"broken"}
#: Errors of the model, the sandbox or the corpus, which end the run.
_FATAL = (
    ModelUnavailable,
    JudgingError,
    SandboxUnavailable,
    CorpusWriteError,
    CorpusBusy,
    CorpusDamaged,
    sqlite3.Error,
)


@dataclass
class RunProgress:
    """Progress of a run.

    Attributes:
        total: Number of concepts.
        settled: Concepts with a final outcome, from this run or an earlier one.
        processed: Concepts among them that this run worked on.
        in_stage: By stage, how many concepts are in it.
        outcomes: Number of outcomes of this run by stage and result.
        errors: Why concepts could not be judged.
    """

    total: int = 0
    settled: int = 0
    processed: int = 0
    in_stage: dict[str, int] = field(default_factory=dict)
    outcomes: dict[tuple[str, str], int] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)


class PipelineRunner:
    """One run over concepts that are in the corpus.

    Args:
        history: Tables of generation in the corpus.
        stages: All stages, in order.
        first: Name of the first stage to run, or "".
        last: Name of the last stage to run, or "".
        on_change: Called after each change of `progress`.

    Attributes:
        progress: Progress of the run.
    """

    def __init__(
        self,
        history: History,
        stages: Sequence[Stage],
        first: str = "",
        last: str = "",
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        names = [stage.name for stage in stages]
        begin = names.index(first) if first else 0
        self._required = names[:begin]
        self._stages = stages[begin : names.index(last) + 1 if last else None]
        self._history = history
        self.on_change = on_change
        self._unavailable: ModelUnavailable | None = None
        self.progress = RunProgress()

    async def run(self, concepts: Sequence[str], context: StageContext, concurrency: int) -> None:
        """Take every concept as far as possible.

        Args:
            concepts: Ids of the concepts.
            context: Services of the stages.
            concurrency: Number of concepts in progress at a time.

        Raises:
            ModelUnavailable: If no request can succeed, once no concept can continue without one.
            EnvCraftError: If the sandbox or the corpus fails.
            sqlite3.Error: If the corpus cannot be written.
        """
        self.progress.total = len(concepts)
        remaining = iter(concepts)
        tasks = [asyncio.create_task(self._work(remaining, context)) for _ in range(min(concurrency, len(concepts)))]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        if self._unavailable is not None:
            raise self._unavailable

    async def _work(self, remaining: Iterator[str], context: StageContext) -> None:
        for concept in remaining:
            if self._unavailable is not None:
                return
            try:
                worked = await self._advance(concept, context)
            except ModelUnavailable as unavailable:
                # Concepts that need no model continue; this one stays as it is.
                self._unavailable = self._unavailable or unavailable
                return
            except JudgingError as error:
                self.progress.errors.append(str(error))
            else:
                self.progress.settled += 1
                self.progress.processed += worked
            self.on_change()

    async def _advance(self, concept: str, context: StageContext) -> bool:
        """Take a concept as far as possible, and return whether there was anything to do."""
        # The outcomes alone first: most concepts of a resumed run need nothing else.
        outcomes = self._history.outcomes(concept)
        if any(name not in outcomes or outcomes[name].result != "passed" for name in self._required):
            return False
        next_stage = next((stage for stage in self._stages if not _settled(outcomes.get(stage.name))), None)
        ended = any(_settled(outcome) and outcome.result != "passed" for outcome in outcomes.values())
        if next_stage is None or ended:
            return False
        state = self._history.state(concept)
        assert state is not None
        for stage in self._stages:
            outcome = state.outcomes.get(stage.name)
            if outcome is None or not _settled(outcome):
                outcome = await self._run_stage(stage, state, context)
            if outcome.result != "passed":
                break
        return True

    async def _run_stage(self, stage: Stage, state: ConceptState, context: StageContext) -> StageOutcome:
        """Return the outcome of a stage once it is stored."""
        self._count(stage.name, 1)
        try:
            outcome = await stage.run(state, context)
        except RequestFailed as failure:
            outcome = StageOutcome("failed", f"{failure.kind}: {failure}", {"failure": failure.kind})
        except _FATAL:
            raise
        except Exception as error:
            # A plugin's stage may raise anything: it costs one concept, not the run.
            reason = f"the stage broke: {type(error).__name__}: {error}"
            outcome = StageOutcome("failed", reason, {"failure": "broken"})
        finally:
            self._count(stage.name, -1)
        self._history.keep_outcome(state, stage.name, outcome)
        state.outcomes[stage.name] = outcome
        key = stage.name, outcome.result
        self.progress.outcomes[key] = self.progress.outcomes.get(key, 0) + 1
        self.on_change()
        return outcome

    def _count(self, stage: str, change: int) -> None:
        self.progress.in_stage[stage] = self.progress.in_stage.get(stage, 0) + change
        self.on_change()


def _settled(outcome: StageOutcome | None) -> bool:
    """Whether an outcome is final."""
    return outcome is not None and outcome.facts.get("failure") not in _RETRIED
