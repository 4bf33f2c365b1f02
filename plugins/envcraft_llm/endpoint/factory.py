"""The factory of models: an endpoint with its journal, its concurrency limiter and its usage tracker."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.errors import EnvCraftError, UsageError
from envcraft_llm.model import Completion, Model, ModelUnavailable, Request, RequestFailed

from .settings import ModelSettings

if TYPE_CHECKING:
    from .batch import BatchModel
    from .client import EndpointModel
    from .concurrency import ConcurrencyLimiter
    from .journal import Journal, Result
    from .usage import UsageTracker


class JournaledModel(Model):
    """An endpoint behind a journal.

    A request whose result is in the journal is not sent, and equal requests in flight share one result. A request in
    flight completes, and its result is written, even if its caller is cancelled: `close` waits for it.

    Attributes:
        usage: Usage by stage.
    """

    def __init__(
        self,
        usage: UsageTracker,
        limiter: ConcurrencyLimiter,
        journal: Journal | None = None,
        endpoint: EndpointModel | BatchModel | None = None,
    ) -> None:
        self.usage = usage
        self._limiter, self._journal, self._endpoint = limiter, journal, endpoint
        self._tasks: dict[str, asyncio.Task[Result]] = {}
        self._closed = False

    @property
    def limit(self) -> int:
        """The current limit of requests in flight; 0 without an endpoint."""
        return self._limiter.limit if self._endpoint else 0

    @property
    def in_flight(self) -> int:
        """How many requests are in flight."""
        return self._limiter.in_flight

    async def generate(self, request: Request) -> Completion:
        key = request.key()
        task = self._tasks.get(key)
        if task is None:
            if (result := self._journaled(request, key)) is not None:
                return _completion(result)
            if self._endpoint is None:
                raise ModelUnavailable(self._missing(request))
            if self._closed:
                raise ModelUnavailable("the model is closed")
            task = self._tasks[key] = asyncio.create_task(self._send(self._endpoint, request))
            task.add_done_callback(lambda done: self._remove(key, done))
        return _completion(await asyncio.shield(task))

    async def close(self) -> None:
        """Send no more requests, wait for those in flight, and write their results."""
        self._closed = True
        try:
            if self._endpoint is not None:
                self._endpoint.stop(ModelUnavailable("the run has ended"))
                await asyncio.gather(*self._tasks.values(), return_exceptions=True)
                await self._endpoint.close()
        finally:
            if self._journal is not None:
                self._journal.close()

    def _journaled(self, request: Request, key: str) -> Result | None:
        if self._journal is None:
            return None
        result = self._journal.get(key, transient=self._endpoint is None)
        if result is not None:
            self.usage.of(request.stage).replayed += 1
        return result

    async def _send(self, endpoint: EndpointModel | BatchModel, request: Request) -> Result:
        """Return the result of a request once it is written. Raises ModelUnavailable."""
        from .journal import Failure

        result: Result
        try:
            result = await endpoint.generate(request)
        except RequestFailed as failure:
            self.usage.of(request.stage).failures[failure.kind] += 1
            result = Failure(failure.kind, str(failure))
        if self._journal is not None:
            try:
                await self._journal.put(request, result)
            except EnvCraftError as error:
                unavailable = ModelUnavailable(str(error))
                endpoint.stop(unavailable)
                raise unavailable from None
        return result

    def _remove(self, key: str, task: asyncio.Task[Result]) -> None:
        del self._tasks[key]
        if not task.cancelled():
            # Marks the exception as retrieved, since every caller may be cancelled.
            task.exception()

    def _missing(self, request: Request) -> str:
        where = f"{self._journal.path} has no result" if self._journal else "there is no journal"
        return (
            f"{where} for the stage {request.stage or '(none)'} of {request.concept or '(no concept)'}, attempt "
            f"{request.attempt}, by {request.model}: the run that wrote it ended earlier or sent another request; "
            "give --base-url to send the request to an endpoint"
        )


def open_model(settings: ModelSettings, journal: Path | None, offline: bool = False) -> JournaledModel:
    """Create the model that `settings` describe. Works outside an event loop; the model is used in one.

    Args:
        settings: Settings, such as a command gets from `model_options`.
        journal: File that stores results, or the folder (a corpus) that holds it as ``journal.sqlite``; created if it
            does not exist. None stores nothing.
        offline: Whether to use the journal only: a request without a result raises ModelUnavailable.

    Raises:
        UsageError: If no endpoint is configured, the ``llm`` extra is not installed, or `offline` has no journal.
        EnvCraftError: If the journal cannot be used.
    """
    from .client import EndpointModel
    from .concurrency import ConcurrencyLimiter
    from .journal import Journal
    from .usage import UsageTracker

    usage, limiter = UsageTracker(settings), ConcurrencyLimiter(settings.min_concurrency, settings.max_concurrency)
    if offline:
        if journal is None:
            raise UsageError("without an endpoint, completions come from a journal, and no journal is given")
        return JournaledModel(usage, limiter, Journal(journal, write=False))
    if settings.batch:
        from .batch import BatchModel

        if journal is None:
            raise UsageError("--batch needs a journal, which stores the results of batches")
        store = Journal(journal)
        return JournaledModel(usage, limiter, store, BatchModel(settings, usage, store, store.path.parent / "batches"))
    endpoint = EndpointModel(settings, limiter, usage)
    return JournaledModel(usage, limiter, Journal(journal) if journal else None, endpoint)


def _completion(result: Result) -> Completion:
    if isinstance(result, Completion):
        return result
    raise result.error()
