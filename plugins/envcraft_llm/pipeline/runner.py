"""Takes concepts through the stages: many at a time, each from where it was left, until all are settled."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from envcraft.corpus.history import History
from envcraft.corpus.store import CorpusBusy, CorpusDamaged
from envcraft.errors import SandboxUnavailable
from envcraft.stages import Case, Outcome, Stage, Workbench
from envcraft_llm.model import ModelFailure, ModelStopped

from .bench import NotKept
from .judging import CouldNotJudge

#: Failures that are not of the concept: a later run tries again.
PASSING = frozenset({"disconnected", "timeout", "server-error", "garbage", "broken"})
#: What is of the model, the sandbox or the corpus, whichever stage meets it.
_ENDING = (ModelStopped, CouldNotJudge, SandboxUnavailable, NotKept, CorpusBusy, CorpusDamaged, sqlite3.Error)


@dataclass
class Tally:
    """How far a run has come.

    Attributes:
        total: concepts.
        settled: concepts that have come to an end, in this run or before.
        fresh: those of them that this run has done something for.
        under_way: by stage, how many concepts are in it.
        now: outcomes of this run, by stage and result.
        unjudged: what could not be judged, in words.
    """

    total: int = 0
    settled: int = 0
    fresh: int = 0
    under_way: dict[str, int] = field(default_factory=dict)
    now: dict[tuple[str, str], int] = field(default_factory=dict)
    unjudged: list[str] = field(default_factory=list)


class Run:
    """One run over concepts that are in the corpus already.

    `first` and `last` are the stages between which it stays; what is settled before is not done again. `told` is called
    whenever the tally has changed.
    """

    def __init__(
        self,
        history: History,
        stages: Sequence[Stage],
        first: str = "",
        last: str = "",
        told: Callable[[], None] = lambda: None,
    ) -> None:
        names = [stage.name for stage in stages]
        begin = names.index(first) if first else 0
        self._before = names[:begin]
        self._stages = stages[begin : names.index(last) + 1 if last else None]
        self._history = history
        self.told = told
        self._stopped: ModelStopped | None = None
        self.tally = Tally()

    async def run(self, concepts: Sequence[str], bench: Workbench, at_once: int) -> None:
        """Take every concept as far as it comes, `at_once` of them at a time. Raises ModelStopped once nothing is under
        way that could go on, EnvCraftError; sqlite3.Error where the corpus cannot be written to.
        """
        self.tally.total = len(concepts)
        waiting = iter(concepts)
        workers = [asyncio.create_task(self._work(waiting, bench)) for _ in range(min(at_once, len(concepts)))]
        try:
            await asyncio.gather(*workers)
        finally:
            for worker in workers:
                worker.cancel()
            await asyncio.gather(*workers, return_exceptions=True)
        if self._stopped is not None:
            raise self._stopped

    async def _work(self, waiting: Iterator[str], bench: Workbench) -> None:
        for concept in waiting:
            if self._stopped is not None:
                return
            try:
                worked = await self._take(concept, bench)
            except ModelStopped as stopped:
                # What needs no model goes on; what needs one ends here, as it was.
                self._stopped = self._stopped or stopped
                return
            except CouldNotJudge as error:
                self.tally.unjudged.append(str(error))
            else:
                self.tally.settled += 1
                self.tally.fresh += worked
            self.told()

    async def _take(self, concept: str, bench: Workbench) -> bool:
        """Take a concept as far as it comes; give whether there was anything to do."""
        # Looked at first, since most concepts of a run that is resumed need nothing else.
        outcomes = self._history.outcomes(concept)
        if any(name not in outcomes or outcomes[name].result != "passed" for name in self._before):
            return False
        missing = next((stage for stage in self._stages if not _settled(outcomes.get(stage.name))), None)
        ended = any(_settled(found) and found.result != "passed" for found in outcomes.values())
        if missing is None or ended:
            return False
        case = self._history.case(concept)
        assert case is not None
        for stage in self._stages:
            outcome = case.outcomes.get(stage.name)
            if outcome is None or not _settled(outcome):
                outcome = await self._outcome(stage, case, bench)
            if outcome.result != "passed":
                break
        return True

    async def _outcome(self, stage: Stage, case: Case, bench: Workbench) -> Outcome:
        """What a stage says, once it is kept."""
        self._count(stage.name, 1)
        try:
            outcome = await stage.run(case, bench)
        except ModelFailure as failure:
            outcome = Outcome("failed", f"{failure.kind}: {failure}", {"failure": failure.kind})
        except _ENDING:
            raise
        except Exception as error:
            # A stage may be anybody's: one concept is lost, and the others go on.
            words = f"the stage broke: {type(error).__name__}: {error}"
            outcome = Outcome("failed", words, {"failure": "broken"})
        finally:
            self._count(stage.name, -1)
        self._history.keep_outcome(case, stage.name, outcome)
        case.outcomes[stage.name] = outcome
        key = stage.name, outcome.result
        self.tally.now[key] = self.tally.now.get(key, 0) + 1
        self.told()
        return outcome

    def _count(self, stage: str, change: int) -> None:
        self.tally.under_way[stage] = self.tally.under_way.get(stage, 0) + change
        self.told()


def _settled(outcome: Outcome | None) -> bool:
    """Whether an outcome stands: one that is of no concept's making is tried again by a later run."""
    return outcome is not None and outcome.facts.get("failure") not in PASSING
