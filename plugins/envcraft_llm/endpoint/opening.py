"""A model, put together of its parts as a command wants it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.errors import EnvCraftError, UsageError
from envcraft_llm.model import Answer, Model, ModelFailure, ModelStopped, Request

from .settings import ModelChoice

if TYPE_CHECKING:
    from .accounts import Accounts
    from .batch import BatchModel
    from .client import EndpointModel
    from .journal import Journal, Outcome
    from .pace import Pace


class OpenedModel(Model):
    """An endpoint behind its journal, at a pace that it can keep up, with accounts.

    A request that the journal knows is not asked again, and one that is being asked is not asked beside. What is under
    way goes on, and is written, where those who asked are cancelled: `close` waits for it.

    Attributes:
        accounts: tokens, cost and outcomes by stage, and the rate of tokens.
    """

    def __init__(
        self,
        accounts: Accounts,
        pace: Pace,
        journal: Journal | None = None,
        endpoint: EndpointModel | BatchModel | None = None,
    ) -> None:
        self.accounts = accounts
        self._pace, self._journal, self._endpoint = pace, journal, endpoint
        self._asking: dict[str, asyncio.Task[Outcome]] = {}
        self._closed = False

    @property
    def limit(self) -> int:
        """How many requests may be under way now; 0 without an endpoint."""
        return self._pace.limit if self._endpoint else 0

    @property
    def under_way(self) -> int:
        """How many requests are with the endpoint."""
        return self._pace.under_way

    async def ask(self, request: Request) -> Answer:
        key = request.key()
        task = self._asking.get(key)
        if task is None:
            if (known := self._known(request, key)) is not None:
                return _answer(known)
            if self._endpoint is None:
                raise ModelStopped(self._missing(request))
            if self._closed:
                raise ModelStopped("the model is closed")
            task = self._asking[key] = asyncio.create_task(self._ask(self._endpoint, request))
            task.add_done_callback(lambda done: self._done(key, done))
        return _answer(await asyncio.shield(task))

    async def close(self) -> None:
        """Send nothing more, wait for what is under way, and write it."""
        self._closed = True
        try:
            if self._endpoint is not None:
                self._endpoint.stop(ModelStopped("the run has ended"))
                await asyncio.gather(*self._asking.values(), return_exceptions=True)
                await self._endpoint.close()
        finally:
            if self._journal is not None:
                self._journal.close()

    def _known(self, request: Request, key: str) -> Outcome | None:
        if self._journal is None:
            return None
        found = self._journal.find(key, passing=self._endpoint is None)
        if found is not None:
            self.accounts.of(request.stage).replayed += 1
        return found

    async def _ask(self, endpoint: EndpointModel | BatchModel, request: Request) -> Outcome:
        """What came of a request, once it is written. Raises ModelStopped."""
        from .journal import Failed

        outcome: Outcome
        try:
            outcome = await endpoint.ask(request)
        except ModelFailure as failure:
            self.accounts.of(request.stage).failures[failure.kind] += 1
            outcome = Failed(failure.kind, str(failure))
        if self._journal is not None:
            try:
                await self._journal.keep(request, outcome)
            except EnvCraftError as error:
                stopped = ModelStopped(str(error))
                endpoint.stop(stopped)
                raise stopped from None
        return outcome

    def _done(self, key: str, task: asyncio.Task[Outcome]) -> None:
        del self._asking[key]
        if not task.cancelled():
            # Those who asked may be gone, and nobody else would look at it.
            task.exception()

    def _missing(self, request: Request) -> str:
        where = f"{self._journal.path} has no answer" if self._journal else "there is no journal"
        return (
            f"{where} for the stage {request.stage or '(none)'} of {request.concept or '(no concept)'}, attempt "
            f"{request.attempt}, by {request.model}: the run that wrote it did not come so far, or asked something "
            "else; with --base-url an endpoint is asked"
        )


def open_model(chosen: ModelChoice, journal: Path | None, offline: bool = False) -> OpenedModel:
    """The model that `chosen` describes. It may be opened outside of an event loop, and is used in one.

    Args:
        chosen: what `model_options` gives.
        journal: the file that keeps what was answered, or the folder (a corpus) in which it is ``journal.sqlite``; made
            where it does not exist. None keeps nothing.
        offline: ask nobody: what is not in the journal raises ModelStopped.

    Raises UsageError where no endpoint is named, the ``llm`` extra is not installed, or there is no journal to answer
    from; EnvCraftError where the journal cannot be used.
    """
    from .accounts import Accounts
    from .client import EndpointModel
    from .journal import Journal
    from .pace import Pace

    accounts, pace = Accounts(chosen), Pace(chosen.min_concurrency, chosen.max_concurrency)
    if offline:
        if journal is None:
            raise UsageError("without an endpoint and without a journal there is nothing to answer from")
        return OpenedModel(accounts, pace, Journal(journal, write=False))
    if chosen.batch:
        from .batch import BatchModel

        if journal is None:
            raise UsageError("batches need a journal, which their answers are read into")
        kept = Journal(journal)
        return OpenedModel(accounts, pace, kept, BatchModel(chosen, accounts, kept, kept.path.parent / "batches"))
    endpoint = EndpointModel(chosen, pace, accounts)
    return OpenedModel(accounts, pace, Journal(journal) if journal else None, endpoint)


def _answer(outcome: Outcome) -> Answer:
    if isinstance(outcome, Answer):
        return outcome
    raise outcome.error()
