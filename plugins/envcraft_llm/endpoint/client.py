"""An endpoint with an OpenAI-compatible interface, by the `openai` client."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator, AsyncIterator
from typing import TYPE_CHECKING, Any

from envcraft_llm.model import Answer, Model, ModelFailure, ModelStopped, Request

from .accounts import Accounts, estimate
from .connection import Connection
from .faults import Again, ParameterRefused, fault
from .pace import Pace
from .reading import Chunk, Events, Garbled, Reading, decode, shown
from .settings import ModelChoice
from .wording import body

if TYPE_CHECKING:
    from openai import AsyncAPIResponse

#: So many requests in a row that fail for good, with no answer between, are the endpoint's fault.
_HOPELESS = 20
#: For the list of models, which is asked for once.
_GREETING_SECONDS = 20.0
#: How often a connection is tried at first; one that stood before is tried as often as any request.
_FIRST_TRIES = 3
#: What follows the last piece of an answer, its usage, comes within so long or not at all.
_TAIL_SECONDS = 5.0
#: Names of errors where there is no endpoint, and where there was one.
_ABSENT = frozenset({"ConnectError", "ConnectTimeout"})
_HUNG_UP = frozenset({"ServerDisconnectedError", "ClientOSError", "ConnectionResetError", "BrokenPipeError"})
#: Of timers, in seconds.
_RESOLUTION = 1e-3


class EndpointModel(Model):
    """Asks an endpoint. Each attempt waits for its place in `pace`; those that another attempt may mend are repeated,
    with growing pauses. Once one request finds that none can be answered, no other is sent.

    Raises UsageError where the client is not installed, or no endpoint is named.
    """

    def __init__(self, choice: ModelChoice, pace: Pace, accounts: Accounts) -> None:
        self._choice, self._pace, self._accounts = choice, pace, accounts
        self._connection = Connection(choice)
        self._greeting: asyncio.Task[None] | None = None
        self._names: list[str] = []
        self._refused: dict[str, set[str]] = {}
        self._failed_in_a_row = 0
        self._stopped: ModelStopped | None = None
        self._stop = asyncio.Event()

    async def ask(self, request: Request) -> Answer:
        if self._greeting is None:
            self._greeting = asyncio.create_task(self._greet())
        await asyncio.shield(self._greeting)
        number = 0
        while True:
            try:
                answer = await self._turn(request, number)
            except Again as again:
                number += 1
                if number > self._choice.retries:
                    raise self._given_up(again, number) from None
                self._accounts.of(request.stage).retries += 1
                await self._rest(again.pause(number - 1))
            except ModelFailure as failure:
                # The endpoint works; but one that finds fault with every request is of no use.
                self._failed_in_a_row = self._failed_in_a_row + 1 if failure.kind == "server-error" else 0
                self._hopeless(failure)
                raise
            except ModelStopped as stopped:
                self.stop(stopped)
                raise
            else:
                self._failed_in_a_row = 0
                return answer

    def stop(self, reason: ModelStopped) -> None:
        """Send no more requests: those that wait raise `reason`, and those that are under way come to their end."""
        if self._stopped is None:
            self._stopped = reason
            self._stop.set()
            self._pace.end()

    async def close(self) -> None:
        if self._greeting is not None:
            self._greeting.cancel()
        await self._connection.client.close()

    async def _rest(self, seconds: float) -> None:
        """Wait for so long, or until nothing is sent any more."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._stop.wait(), seconds)

    async def _turn(self, request: Request, number: int) -> Answer:
        """One attempt in its place. Raises Again, ModelFailure or ModelStopped."""
        entry = await self._pace.enter(again=number > 0)
        try:
            if self._stopped is not None:
                raise type(self._stopped)(str(self._stopped))
            reserved = self._accounts.reserve(request)
            try:
                answer = await self._attempts(request)
            finally:
                self._accounts.settle(request, reserved)
            self._pace.succeeded()
            return answer
        except ModelFailure:
            # Answered all the same.
            self._pace.succeeded()
            raise
        except Again as again:
            if again.limited:
                self._pace.turned_away(entry, again.after)
            raise
        finally:
            self._pace.leave()

    async def _attempts(self, request: Request) -> Answer:
        """One attempt, repeated at once without each parameter that the endpoint does not take."""
        while True:
            try:
                return await self._attempt(request)
            except ParameterRefused as refused:
                self._refused.setdefault(request.model, set()).add(refused.name)

    async def _attempt(self, request: Request) -> Answer:
        loop, choice, reading = asyncio.get_running_loop(), self._choice, Reading(self._connection.answered)
        began = loop.time()
        ends = began + choice.total_seconds
        try:
            async with asyncio.timeout_at(min(ends, began + choice.first_seconds)) as clock:
                async with self._response(request) as response, contextlib.aclosing(_chunks(response)) as chunks:
                    async for chunk in chunks:
                        if chunk.error is not None:
                            raise self._told(chunk.error, request)
                        reading.take(chunk)
                        silence = choice.silence_seconds if reading.finish is None else _TAIL_SECONDS
                        clock.reschedule(min(ends, loop.time() + silence))
        except TimeoutError:
            if reading.finish is None:
                raise self._late(reading, loop.time() - began) from None
        except Garbled as garbled:
            raise Again("garbage", self._connection.plain(str(garbled))) from None
        finally:
            tokens = reading.tokens(estimate(request))
            if reading.pieces or reading.usage:
                self._accounts.use(request, *tokens, loop.time() - began)
        return reading.answer(tokens, loop.time() - began)

    @contextlib.asynccontextmanager
    async def _response(self, request: Request) -> AsyncIterator[AsyncAPIResponse[Any]]:
        """Raises Again, ParameterRefused, ModelFailure and ModelStopped."""
        from openai import APIConnectionError, APIStatusError

        sent = body(request, self._refused.get(request.model, set()))
        # As the extra body: what the client does to each message of a body costs more than all else here together.
        streamed = self._connection.client.chat.completions.with_streaming_response.create(
            model=request.model, messages=[], stream=True, extra_body=sent
        )
        try:
            response = await streamed.__aenter__()
        except APIConnectionError as error:
            raise self._unconnected(error) from None
        except APIStatusError as error:
            said = self._connection.plain(await _text(error.response))
            raise self._named(fault(error.status_code, said, error.response.headers, request, sent)) from None
        try:
            yield response
        finally:
            await streamed.__aexit__(None, None, None)

    def _unconnected(self, error: Exception) -> Again:
        """Whether nobody was there, or one who hung up, only the names of the causes tell: which library lies below the
        client depends on its version, and what it makes of an error of that library may be another one.
        """
        cause: BaseException | None = error
        names, words = set(), ""
        while cause is not None:
            names.add(type(cause).__name__)
            words, cause = str(cause) or type(cause).__name__, cause.__cause__
        down = not names.isdisjoint(_ABSENT) and names.isdisjoint(_HUNG_UP)
        return Again("server-error" if down else "disconnected", self._connection.plain(words), down=down)

    def _told(self, error: Any, request: Request) -> Exception:
        """An error that came in the stream, after the status."""
        told = error if isinstance(error, dict) else {"message": str(error)}
        code = told.get("code")
        return fault(code if isinstance(code, int) else 500, self._connection.plain(json.dumps(told)), {}, request, {})

    def _late(self, reading: Reading, seconds: float) -> Exception:
        """What has come to nothing within its time is not waited for again, if it used all of it."""
        if seconds > self._choice.total_seconds - _RESOLUTION:
            return ModelFailure("timeout", f"no end of the answer within {self._choice.total_seconds:g} s")
        if reading.pieces:
            return Again("timeout", f"nothing more for {self._choice.silence_seconds:g} s, in the midst of the answer")
        return Again("timeout", f"no beginning of an answer within {self._choice.first_seconds:g} s")

    def _named(self, found: Exception) -> Exception:
        """A fault, with what helps against it."""
        if isinstance(found, ModelStopped):
            said = str(found)
            if "refuses the key" in said:
                had = "the one in" if self._connection.has_key else "none is set in"
                return ModelStopped(f"{self._connection.where}: {said}; {had} {self._connection.key_name}")
            if "has no model" in said and self._names:
                return ModelStopped(f"{self._connection.where}: {said}; it has {', '.join(self._names[:20])}")
            return ModelStopped(f"{self._connection.where}: {said}")
        return found

    def _given_up(self, again: Again, number: int) -> Exception:
        """What a request ends with whose attempts all failed."""
        if again.down:
            stopped = ModelStopped(
                f"nothing answers at {self._connection.where} any more ({again}; {number} attempts): what was answered "
                "is kept; start the endpoint again, and the same command goes on"
            )
            self.stop(stopped)
            return stopped
        failure = ModelFailure(again.kind, f"{again} ({number} attempts)")
        self._failed_in_a_row += 1
        self._hopeless(failure)
        return failure

    def _hopeless(self, failure: ModelFailure) -> None:
        if self._failed_in_a_row >= _HOPELESS:
            self.stop(
                ModelStopped(f"{self._connection.where} failed {_HOPELESS} requests in a row, the last with: {failure}")
            )

    async def _greet(self) -> None:
        """Ask for the names of models. An endpoint that does not tell them is taken as it is; one that is not there, or
        refuses the key, raises ModelStopped.
        """
        from openai import APIConnectionError, APIError, APIStatusError

        for number in range(_FIRST_TRIES):
            try:
                async with asyncio.timeout(_GREETING_SECONDS):
                    listed = await self._connection.client.models.list()
                    self._names = [model.id async for model in listed if isinstance(model.id, str)]
                return
            except APIConnectionError as error:
                again = self._unconnected(error)
                if not again.down:
                    return
                if number + 1 < _FIRST_TRIES:
                    await self._rest(again.pause(number))
                    if self._stopped is not None:
                        raise type(self._stopped)(str(self._stopped)) from None
                    continue
                stopped = ModelStopped(
                    f"nothing answers at {self._connection.where} ({again}): start the endpoint there, or give another "
                    "--base-url"
                )
                self.stop(stopped)
                raise stopped from None
            except APIStatusError as error:
                if error.status_code == 401:
                    said = self._connection.plain(await _text(error.response))
                    refused = self._named(fault(401, said, {}, Request("", ()), {}))
                    assert isinstance(refused, ModelStopped)
                    self.stop(refused)
                    raise refused from None
                return
            except (APIError, ValueError, TypeError, AttributeError, TimeoutError):
                return


async def _chunks(response: AsyncAPIResponse[Any]) -> AsyncGenerator[Chunk, None]:
    """The pieces of an answer. Raises Again where they break off, Garbled where they are none."""
    events, finished = Events(), False
    streamed = not response.headers.get("content-type", "").startswith("application/json")
    whole: list[bytes] = []
    pieces = response.iter_bytes()
    while True:
        try:
            piece = await anext(pieces)
        except StopAsyncIteration:
            break
        except Exception as error:
            # Whatever the transport raises: its classes are those of the library below the client's.
            if finished:
                return
            raise Again("disconnected", f"the connection broke: {shown(str(error)) or type(error).__name__}") from None
        if not streamed:
            whole.append(piece)
            continue
        for data in events.feed(piece):
            chunk = decode(data)
            finished = finished or bool(chunk.choices and chunk.choices[0].finish_reason)
            yield chunk
    for data in events.end() if streamed else [b"".join(whole)]:
        chunk = decode(data)
        finished = finished or bool(chunk.choices and chunk.choices[0].finish_reason)
        yield chunk
    if not finished:
        raise Again("disconnected", "the connection ended before the answer did")


async def _text(response: Any) -> str:
    with contextlib.suppress(Exception):
        data: bytes = await response.aread()
        return data.decode("utf-8", "replace")[:2000]
    return ""
