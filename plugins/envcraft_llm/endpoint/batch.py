"""Requests through the Batch interface of OpenAI [1]_: at a lower price, completed within a day.

.. [1] https://platform.openai.com/docs/guides/batch
"""

from __future__ import annotations

import asyncio
import functools
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

from envcraft.errors import EnvCraftError
from envcraft.files import atomic_write
from envcraft_llm.model import Completion, Model, ModelUnavailable, Request

from . import batch_files
from .connection import Connection
from .errors import RetryableError, error_from_response
from .journal import Failure, Journal, Result
from .response import excerpt
from .settings import ModelSettings
from .usage import Reservation, UsageTracker

#: Seconds without a new request after which a batch is sent, and between polls of its status.
QUIET, POLL = 5.0, 30.0
#: Batches that may end without a result for a request before the request fails.
_MAX_MISSES = 2
_ENDED = frozenset({"completed", "failed", "expired", "cancelled"})
_T = TypeVar("_T")


class BatchModel(Model):
    """Collects requests, sends them as batches, and writes the results to the journal.

    A batch outlives the run that sent it: the next run on the same journal waits for it and sends nothing twice. If the
    endpoint has no Batch interface, the input files remain, and ModelUnavailable says what to do with them.

    Args:
        folder: Folder of the batch files.
    """

    def __init__(self, settings: ModelSettings, usage: UsageTracker, journal: Journal, folder: Path) -> None:
        self._settings, self._usage, self._journal, self._folder = settings, usage, journal, folder
        self._connection = Connection(settings)
        self._waiting: dict[str, tuple[Request, Reservation, asyncio.Future[Result]]] = {}
        self._unsent: dict[str, Request] = {}
        self._sent: set[str] = set()
        self._misses: Counter[str] = Counter()
        self._unsupported: dict[str, set[str]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._unavailable: ModelUnavailable | None = None
        self._resumed = False

    async def generate(self, request: Request) -> Completion:
        self._resume()
        if self._unavailable is not None:
            raise type(self._unavailable)(str(self._unavailable))
        key = request.key()
        # A batch of an earlier run may have ended in the meantime.
        result = self._journal.get(key)
        if result is None:
            future: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
            self._waiting[key] = (request, self._usage.reserve(request), future)
            if key not in self._sent:
                self._collect(request)
            result = await future
        if isinstance(result, Failure):
            raise result.error()
        return result

    def stop(self, reason: ModelUnavailable) -> None:
        """Send no more batches: requests that wait raise `reason`. Batches that were sent stay with the endpoint."""
        if self._unavailable is None:
            self._unavailable = reason
        if self._timer is not None:
            self._timer.cancel()
        self._unsent.clear()
        for key in list(self._waiting):
            request, reservation, future = self._waiting.pop(key)
            self._usage.release(request, reservation)
            if not future.done():
                future.set_exception(type(reason)(str(reason)))

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._connection.client.close()

    def _resume(self) -> None:
        """Continue the batches of earlier runs."""
        if self._resumed:
            return
        self._resumed = True
        for name in batch_files.outstanding(self._folder):
            try:
                self._sent.update(batch_files.load_requests(self._folder, name))
            except EnvCraftError as error:
                # Otherwise the requests of the unreadable file would be sent twice.
                self.stop(self._as_unavailable(error))
                return
            self._start(name, earlier=True)

    def _collect(self, request: Request) -> None:
        self._unsent[request.key()] = request
        if self._timer is not None:
            self._timer.cancel()
        self._timer = asyncio.get_running_loop().call_later(QUIET, self._send)

    def _send(self) -> None:
        try:
            names = batch_files.write_batches(self._unsent.values(), self._folder, self._unsupported)
        except Exception as error:
            self.stop(self._as_unavailable(error))
            return
        self._sent.update(self._unsent)
        self._unsent.clear()
        for name in names:
            self._start(name)

    def _start(self, name: str, earlier: bool = False) -> None:
        task = asyncio.create_task(self._process(name, earlier))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _process(self, name: str, earlier: bool) -> None:
        """Send a batch, wait for its output and store the results."""
        try:
            output = self._folder / f"{name}{batch_files.OUTPUT}"
            if not output.exists():
                await self._download_output(name, output, earlier)
            self._store_output(name, output)
        except Exception as error:
            # Every exception: nothing else would wake the requests that wait.
            self.stop(self._as_unavailable(error))

    def _as_unavailable(self, error: Exception) -> ModelUnavailable:
        if isinstance(error, ModelUnavailable):
            return error
        message = str(error) if isinstance(error, OSError | EnvCraftError) else f"{type(error).__name__}: {error}"
        return ModelUnavailable(self._connection.redact(message))

    async def _download_output(self, name: str, output: Path, earlier: bool) -> None:
        """Send a batch unless an earlier run did, wait for its end and write its output.

        Raises ModelUnavailable, OSError.
        """
        client = self._connection.client
        batch: Any = await self._find(name) if earlier else None
        if batch is None:
            uploaded = await self._call(
                name, lambda: client.files.create(file=self._folder / f"{name}{batch_files.INPUT}", purpose="batch")
            )
            batch = await self._create(name, uploaded.id)
        while batch.status not in _ENDED:
            await asyncio.sleep(POLL)
            batch = await self._call(name, functools.partial(client.batches.retrieve, batch.id))
        text = ""
        for file in filter(None, (batch.output_file_id, batch.error_file_id)):
            content = await self._call(name, functools.partial(client.files.content, file))
            text += self._connection.redact_completion(content.content.decode("utf-8", "replace")).strip() + "\n"
        if not text.strip() and batch.status in ("failed", "cancelled"):
            reason = excerpt(self._connection.redact(str(batch.errors)))
            raise ModelUnavailable(f"the batch {batch.id} ended as {batch.status}: {reason}")
        with atomic_write(output) as stream:
            stream.write(text.encode())

    async def _create(self, name: str, file: str) -> Any:
        """Create the batch of an input file once, even if the response to the first attempt was lost.

        Raises ModelUnavailable.
        """
        retry = False

        async def create() -> Any:
            nonlocal retry
            if retry and (existing := await self._find(name)) is not None:
                return existing
            retry = True
            return await self._connection.client.batches.create(
                input_file_id=file,
                endpoint="/v1/chat/completions",
                completion_window="24h",
                metadata={"envcraft": name},
            )

        return await self._call(name, create)

    async def _find(self, name: str) -> Any:
        """Return the batch of this name at the endpoint, unless it failed; None if there is none.

        Raises ModelUnavailable.
        """
        list_batches = self._connection.client.batches.list
        page: dict[str, Any] = {"limit": 100}
        seen: set[str] = set()
        while True:
            listed: Any = await self._call(name, functools.partial(list_batches, **page))
            for batch in listed.data:
                if (batch.metadata or {}).get("envcraft") == name and batch.status not in ("failed", "cancelled"):
                    return batch
            # An endpoint without pagination returns the same page again.
            last = listed.data[-1].id if listed.data else None
            if last is None or last in seen or not getattr(listed, "has_more", False):
                return None
            seen.add(last)
            page["after"] = last

    async def _call(self, name: str, call: Callable[[], Awaitable[_T]]) -> _T:
        """Call the interface with retries. Raises ModelUnavailable."""
        from openai import APIConnectionError, APIStatusError

        for number in range(self._settings.retries + 1):
            try:
                return await call()
            except APIConnectionError as error:
                retryable = RetryableError("disconnected", str(error.__cause__ or error))
            except APIStatusError as error:
                if error.status_code in (404, 405, 501):
                    raise ModelUnavailable(self._manual_steps(name)) from None
                classified = error_from_response(
                    error.status_code,
                    self._connection.redact(error.message),
                    error.response.headers,
                    Request("", ()),
                    {},
                )
                if not isinstance(classified, RetryableError):
                    raise ModelUnavailable(f"{self._connection.address}: {classified}") from None
                retryable = classified
            await asyncio.sleep(retryable.backoff(number))
        reason = self._connection.redact(str(retryable))
        raise ModelUnavailable(
            f"{self._connection.address}: {reason} ({number + 1} attempts); run the same command again to continue"
        )

    def _manual_steps(self, name: str) -> str:
        path = self._folder / name
        return (
            f"{self._connection.address} has no Batch interface: have {path}{batch_files.INPUT} processed elsewhere, "
            f"put the output beside it as {name}{batch_files.OUTPUT}, and run the same command again to continue"
        )

    def _store_output(self, name: str, output: Path) -> None:
        """Write the results of a batch to the journal and wake the requests that wait.

        Requests without a result are collected again; if the output says that no request can succeed, a later run sends
        them. Raises ModelUnavailable in that case, and EnvCraftError.
        """
        requests = batch_files.load_requests(self._folder, name)
        parsed = batch_files.read_output(output, requests, self._unsupported, self._connection.redact_completion)
        results: list[tuple[Request, Result]] = []
        for request, result, tokens in parsed.results:
            self._usage.record(request, *tokens, 0.0)
            results.append((request, result))
        self._journal.put_all(results)
        (self._folder / f"{name}{batch_files.REQUESTS}").unlink()
        self._sent.difference_update(requests)
        for request, result in results:
            requests.pop(request.key(), None)
            self._resolve(request.key(), result)
        if parsed.unavailable is not None:
            raise ModelUnavailable(
                f"{self._connection.address}: {parsed.unavailable}; the next run sends the remaining requests again"
            )
        for key, request in requests.items():
            self._misses[key] += 1
            if self._misses[key] > _MAX_MISSES:
                self._resolve(key, Failure("server-error", f"{_MAX_MISSES + 1} batches ended without a result"))
            elif key in self._waiting:
                self._collect(request)

    def _resolve(self, key: str, result: Result) -> None:
        if key in self._waiting:
            request, reservation, future = self._waiting.pop(key)
            self._usage.release(request, reservation)
            if not future.done():
                future.set_result(result)
