"""Requests that are answered by the Batch interface, at a lower price and within a day."""

from __future__ import annotations

import asyncio
import functools
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

from envcraft.errors import EnvCraftError
from envcraft_llm.model import Answer, Model, ModelStopped, Request

from . import batch_files
from .accounts import Accounts, Reserved
from .connection import Connection
from .faults import Again, fault
from .journal import Failed, Journal, Outcome
from .reading import shown
from .settings import ModelChoice

#: A batch is sent once no request has come for so many seconds, and is looked after every so many.
QUIET, POLL = 5.0, 30.0
#: How many batches may end without an answer to a request before it has failed.
_MISSES = 2
_ENDED = frozenset({"completed", "failed", "expired", "cancelled"})
_T = TypeVar("_T")


class BatchModel(Model):
    """Collects requests until no more come, has them answered as batches, and reads the answers into the journal.
    Stages see nothing of it but that answers take long.

    What is sent outlives the run: one that ends is gone on with by the next on the same journal, which asks for nothing
    again. Where the endpoint has no such interface, the files remain, and ModelStopped tells what to do with them.

    Args:
        folder: where the files of the batches lie.
    """

    def __init__(self, choice: ModelChoice, accounts: Accounts, journal: Journal, folder: Path) -> None:
        self._choice, self._accounts, self._journal, self._folder = choice, accounts, journal, folder
        self._connection = Connection(choice)
        self._waiting: dict[str, tuple[Request, Reserved, asyncio.Future[Outcome]]] = {}
        self._unsent: dict[str, Request] = {}
        self._sent: set[str] = set()
        self._missed: Counter[str] = Counter()
        self._refused: dict[str, set[str]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._stopped: ModelStopped | None = None
        self._resumed = False

    async def ask(self, request: Request) -> Answer:
        self._resume()
        if self._stopped is not None:
            raise type(self._stopped)(str(self._stopped))
        key = request.key()
        # A batch of an earlier run may just have come in.
        outcome = self._journal.find(key)
        if outcome is None:
            waiting: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
            self._waiting[key] = (request, self._accounts.reserve(request), waiting)
            if key not in self._sent:
                self._collect(request)
            outcome = await waiting
        if isinstance(outcome, Failed):
            raise outcome.error()
        return outcome

    def stop(self, reason: ModelStopped) -> None:
        """Send no more batches; those who wait raise `reason`. What is sent stays with the endpoint."""
        if self._stopped is None:
            self._stopped = reason
        if self._timer is not None:
            self._timer.cancel()
        self._unsent.clear()
        for key in list(self._waiting):
            request, reserved, waiting = self._waiting.pop(key)
            self._accounts.settle(request, reserved)
            if not waiting.done():
                waiting.set_exception(type(reason)(str(reason)))

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._connection.client.close()

    def _resume(self) -> None:
        """Go on with the batches of earlier runs."""
        if self._resumed:
            return
        self._resumed = True
        for name in batch_files.outstanding(self._folder):
            try:
                self._sent.update(batch_files.known(self._folder, name))
            except EnvCraftError as error:
                # None is asked twice because one file of another run cannot be read.
                self.stop(self._broken(error))
                return
            self._begin(name, earlier=True)

    def _collect(self, request: Request) -> None:
        self._unsent[request.key()] = request
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(QUIET, self._send)

    def _send(self) -> None:
        try:
            names = batch_files.write_batches(self._unsent.values(), self._folder, self._refused)
        except Exception as error:
            self.stop(self._broken(error))
            return
        self._sent.update(self._unsent)
        self._unsent.clear()
        for name in names:
            self._begin(name)

    def _begin(self, name: str, earlier: bool = False) -> None:
        task = asyncio.create_task(self._carry(name, earlier))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _carry(self, name: str, earlier: bool) -> None:
        """Have a batch answered, and its answers written."""
        try:
            output = self._folder / f"{name}{batch_files.OUTPUT}"
            if not output.exists():
                await self._answered(name, output, earlier)
            self._take(name, output)
        except Exception as error:
            # Whatever it is: nobody else would wake those who wait.
            self.stop(self._broken(error))

    def _broken(self, error: Exception) -> ModelStopped:
        """An error as what ends the run."""
        if isinstance(error, ModelStopped):
            return error
        said = str(error) if isinstance(error, OSError | EnvCraftError) else f"{type(error).__name__}: {error}"
        return ModelStopped(self._connection.plain(said))

    async def _answered(self, name: str, output: Path, earlier: bool) -> None:
        """Send a batch, unless it is, and fetch what comes of it. Raises ModelStopped and OSError."""
        calls = self._connection.client
        batch: Any = await self._find(name) if earlier else None
        if batch is None:
            sent = await self._call(
                name, lambda: calls.files.create(file=self._folder / f"{name}{batch_files.INPUT}", purpose="batch")
            )
            batch = await self._create(name, sent.id)
        while batch.status not in _ENDED:
            await asyncio.sleep(POLL)
            batch = await self._call(name, functools.partial(calls.batches.retrieve, batch.id))
        # The key is in nothing that lies about.
        written = ""
        for file in filter(None, (batch.output_file_id, batch.error_file_id)):
            content = await self._call(name, functools.partial(calls.files.content, file))
            written += self._connection.answered(content.content.decode("utf-8", "replace")).strip() + "\n"
        if not written.strip() and batch.status in ("failed", "cancelled"):
            said = shown(self._connection.plain(str(batch.errors)))
            raise ModelStopped(f"the batch {batch.id} ended as {batch.status}: {said}")
        unfinished = output.with_name(f"{output.name}.part")
        unfinished.write_text(written, "utf-8", newline="\n")
        unfinished.replace(output)

    async def _create(self, name: str, file: str) -> Any:
        """Make the batch of an input file, once: one whose making was not confirmed may be there all the same. Raises
        ModelStopped.
        """
        tried = False

        async def make() -> Any:
            nonlocal tried
            if tried and (found := await self._find(name)) is not None:
                return found
            tried = True
            return await self._connection.client.batches.create(
                input_file_id=file,
                endpoint="/v1/chat/completions",
                completion_window="24h",
                metadata={"envcraft": name},
            )

        return await self._call(name, make)

    async def _find(self, name: str) -> Any:
        """The batch of this name at the endpoint, if it is there and did not end in vain. Raises ModelStopped."""
        listing = self._connection.client.batches.list
        page: dict[str, Any] = {"limit": 100}
        seen: set[str] = set()
        while True:
            listed: Any = await self._call(name, functools.partial(listing, **page))
            for batch in listed.data:
                if (batch.metadata or {}).get("envcraft") == name and batch.status not in ("failed", "cancelled"):
                    return batch
            # An endpoint that knows no pages gives the same one again.
            last = listed.data[-1].id if listed.data else None
            if last is None or last in seen or not getattr(listed, "has_more", False):
                return None
            seen.add(last)
            page["after"] = last

    async def _call(self, name: str, make: Callable[[], Awaitable[_T]]) -> _T:
        """A call of the interface, repeated where another may do. Raises ModelStopped."""
        from openai import APIConnectionError, APIStatusError

        for number in range(self._choice.retries + 1):
            try:
                return await make()
            except APIConnectionError as error:
                again = Again("disconnected", str(error.__cause__ or error))
            except APIStatusError as error:
                if error.status_code in (404, 405, 501):
                    raise ModelStopped(self._by_hand(name)) from None
                found = fault(
                    error.status_code,
                    self._connection.plain(error.message),
                    error.response.headers,
                    Request("", ()),
                    {},
                )
                if not isinstance(found, Again):
                    raise ModelStopped(f"{self._connection.where}: {found}") from None
                again = found
            await asyncio.sleep(again.pause(number))
        said = self._connection.plain(str(again))
        raise ModelStopped(f"{self._connection.where}: {said} ({number + 1} attempts); the next run goes on")

    def _by_hand(self, name: str) -> str:
        place = self._folder / name
        return (
            f"{self._connection.where} takes no batches: have {place}{batch_files.INPUT} answered elsewhere, put the "
            f"answers there as {name}{batch_files.OUTPUT}, and the same command goes on"
        )

    def _take(self, name: str, output: Path) -> None:
        """Write what came of a batch, and hand it to those who wait; what did not come of it is asked again: by a later
        run, where the endpoint told that none can be answered. Raises ModelStopped there, and EnvCraftError.
        """
        requests = batch_files.known(self._folder, name)
        outcomes: list[tuple[Request, Outcome]] = []
        came = batch_files.read_output(output, requests, self._refused, self._connection.answered)
        for request, outcome, tokens in came.outcomes:
            self._accounts.use(request, *tokens, 0.0)
            outcomes.append((request, outcome))
        self._journal.keep_now(outcomes)
        (self._folder / f"{name}{batch_files.KNOWN}").unlink()
        self._sent.difference_update(requests)
        for request, outcome in outcomes:
            requests.pop(request.key(), None)
            self._hand(request.key(), outcome)
        if came.stopped is not None:
            raise ModelStopped(f"{self._connection.where}: {came.stopped}; the next run asks again")
        for key, request in requests.items():
            self._missed[key] += 1
            if self._missed[key] > _MISSES:
                self._hand(key, Failed("server-error", f"{_MISSES + 1} batches ended without an answer"))
            elif key in self._waiting:
                self._collect(request)

    def _hand(self, key: str, outcome: Outcome) -> None:
        if key in self._waiting:
            request, reserved, waiting = self._waiting.pop(key)
            self._accounts.settle(request, reserved)
            if not waiting.done():
                waiting.set_result(outcome)
