"""An endpoint with an OpenAI-compatible interface, by the `openai` client."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator, AsyncIterator
from typing import TYPE_CHECKING, Any

from envcraft_llm.model import Completion, Model, ModelUnavailable, Request, RequestFailed

from .concurrency import ConcurrencyLimiter
from .connection import Connection
from .errors import RetryableError, UnsupportedParameter, error_from_response
from .request_body import request_body
from .response import Chunk, CompletionBuilder, EventStreamDecoder, MalformedResponse, decode_chunk, excerpt
from .settings import ModelSettings
from .usage import UsageTracker, estimated_prompt_tokens

if TYPE_CHECKING:
    from openai import AsyncAPIResponse

#: Failed requests in a row, without a completion in between, after which the endpoint counts as broken.
_MAX_CONSECUTIVE_FAILURES = 20
#: Timeout of the list of models, which is requested once.
_MODELS_SECONDS = 20.0
#: Attempts of the first connection. Once connected, a request has as many attempts as any other.
_CONNECT_ATTEMPTS = 3
#: Timeout of the usage that follows the last chunk of a completion.
_TRAILER_SECONDS = 5.0
#: Names of errors if nothing listens at the address, and if the peer closed the connection.
_UNREACHABLE = frozenset({"ConnectError", "ConnectTimeout"})
_CLOSED_BY_PEER = frozenset({"ServerDisconnectedError", "ClientOSError", "ConnectionResetError", "BrokenPipeError"})
#: Resolution of timers, in seconds.
_RESOLUTION = 1e-3


class EndpointModel(Model):
    """Sends requests to an endpoint.

    Each attempt acquires a slot of the limiter. Retryable errors are retried with backoff. Once one request shows that
    none can succeed, no other is sent.

    Raises:
        UsageError: If the client is not installed, or no endpoint is configured.
    """

    def __init__(self, settings: ModelSettings, limiter: ConcurrencyLimiter, usage: UsageTracker) -> None:
        self._settings, self._limiter, self._usage = settings, limiter, usage
        self._connection = Connection(settings)
        self._check: asyncio.Task[None] | None = None
        self._model_names: list[str] = []
        self._unsupported: dict[str, set[str]] = {}
        self._consecutive_failures = 0
        self._unavailable: ModelUnavailable | None = None
        self._stopped = asyncio.Event()

    async def generate(self, request: Request) -> Completion:
        if self._check is None:
            self._check = asyncio.create_task(self._check_endpoint())
        await asyncio.shield(self._check)
        attempts = 0
        while True:
            try:
                completion = await self._attempt_in_slot(request, attempts)
            except RetryableError as error:
                attempts += 1
                if attempts > self._settings.retries:
                    raise self._out_of_retries(error, attempts) from None
                self._usage.of(request.stage).retries += 1
                await self._sleep(error.backoff(attempts - 1))
            except RequestFailed as failure:
                # The endpoint works; but one that rejects every request is useless.
                self._consecutive_failures = self._consecutive_failures + 1 if failure.kind == "server-error" else 0
                self._stop_if_broken(failure)
                raise
            except ModelUnavailable as unavailable:
                self.stop(unavailable)
                raise
            else:
                self._consecutive_failures = 0
                return completion

    def stop(self, reason: ModelUnavailable) -> None:
        """Send no more requests: those that wait raise `reason`, and those in flight complete."""
        if self._unavailable is None:
            self._unavailable = reason
            self._stopped.set()
            self._limiter.stop()

    async def close(self) -> None:
        if self._check is not None:
            self._check.cancel()
        await self._connection.client.close()

    async def _sleep(self, seconds: float) -> None:
        """Sleep until the time is over or `stop` is called."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._stopped.wait(), seconds)

    async def _attempt_in_slot(self, request: Request, number: int) -> Completion:
        """Acquire a slot and make one attempt. Raises RetryableError, RequestFailed, ModelUnavailable."""
        ticket = await self._limiter.acquire(retry=number > 0)
        try:
            if self._unavailable is not None:
                raise type(self._unavailable)(str(self._unavailable))
            reservation = self._usage.reserve(request)
            try:
                completion = await self._attempt_with_supported_parameters(request)
            finally:
                self._usage.release(request, reservation)
            self._limiter.on_success()
            return completion
        except RequestFailed:
            # The endpoint responded, so its load is no reason to slow down.
            self._limiter.on_success()
            raise
        except RetryableError as error:
            if error.rate_limited:
                self._limiter.on_rate_limit(ticket, error.retry_after)
            raise
        finally:
            self._limiter.release()

    async def _attempt_with_supported_parameters(self, request: Request) -> Completion:
        """Make one attempt, and repeat it at once without each unsupported parameter."""
        while True:
            try:
                return await self._attempt(request)
            except UnsupportedParameter as error:
                self._unsupported.setdefault(request.model, set()).add(error.name)

    async def _attempt(self, request: Request) -> Completion:
        loop, settings = asyncio.get_running_loop(), self._settings
        builder = CompletionBuilder(self._connection.redact_completion)
        start = loop.time()
        deadline = start + settings.total_seconds
        try:
            async with asyncio.timeout_at(min(deadline, start + settings.first_seconds)) as timeout:
                async with self._response(request) as response, contextlib.aclosing(_chunks(response)) as chunks:
                    async for chunk in chunks:
                        if chunk.error is not None:
                            raise self._stream_error(chunk.error, request)
                        builder.add(chunk)
                        silence = settings.silence_seconds if builder.finish is None else _TRAILER_SECONDS
                        timeout.reschedule(min(deadline, loop.time() + silence))
        except TimeoutError:
            if builder.finish is None:
                raise self._timeout_error(builder, loop.time() - start) from None
        except MalformedResponse as malformed:
            raise RetryableError("garbage", self._connection.redact(str(malformed))) from None
        finally:
            tokens = builder.tokens(estimated_prompt_tokens(request))
            if builder.chunks or builder.usage:
                self._usage.record(request, *tokens, loop.time() - start)
        return builder.build(tokens, loop.time() - start)

    @contextlib.asynccontextmanager
    async def _response(self, request: Request) -> AsyncIterator[AsyncAPIResponse[Any]]:
        """Raises RetryableError, UnsupportedParameter, RequestFailed, ModelUnavailable."""
        from openai import APIConnectionError, APIStatusError

        body = request_body(request, self._unsupported.get(request.model, set()))
        # As the extra body: the client's processing of each message in a typed body costs more than all the rest.
        streamed = self._connection.client.chat.completions.with_streaming_response.create(
            model=request.model, messages=[], stream=True, extra_body=body
        )
        try:
            response = await streamed.__aenter__()
        except APIConnectionError as error:
            raise self._connection_error(error) from None
        except APIStatusError as error:
            text = self._connection.redact(await _text(error.response))
            raise self._explained(
                error_from_response(error.status_code, text, error.response.headers, request, body)
            ) from None
        try:
            yield response
        finally:
            await streamed.__aexit__(None, None, None)

    def _connection_error(self, error: Exception) -> RetryableError:
        """Classify a connection error by the names of its causes.

        Which library lies below the client depends on the client's version, and so do the classes of its errors.
        """
        cause: BaseException | None = error
        names, message = set(), ""
        while cause is not None:
            names.add(type(cause).__name__)
            message, cause = str(cause) or type(cause).__name__, cause.__cause__
        unreachable = not names.isdisjoint(_UNREACHABLE) and names.isdisjoint(_CLOSED_BY_PEER)
        return RetryableError(
            "server-error" if unreachable else "disconnected", self._connection.redact(message), unreachable=unreachable
        )

    def _stream_error(self, error: Any, request: Request) -> Exception:
        """Classify an error that arrived in the stream, after a successful status."""
        details = error if isinstance(error, dict) else {"message": str(error)}
        code = details.get("code")
        status = code if isinstance(code, int) else 500
        return error_from_response(status, self._connection.redact(json.dumps(details)), {}, request, {})

    def _timeout_error(self, builder: CompletionBuilder, seconds: float) -> Exception:
        """Classify a timeout: an attempt that used the total time is not retried."""
        if seconds > self._settings.total_seconds - _RESOLUTION:
            return RequestFailed("timeout", f"the completion did not end within {self._settings.total_seconds:g} s")
        if builder.chunks:
            return RetryableError("timeout", f"no chunk within {self._settings.silence_seconds:g} s of the last one")
        return RetryableError("timeout", f"no first chunk within {self._settings.first_seconds:g} s")

    def _explained(self, error: Exception) -> Exception:
        """Add the address, and what the user can do, to a ModelUnavailable."""
        if isinstance(error, ModelUnavailable):
            message = str(error)
            if "rejects the key" in message:
                key = "the one in" if self._connection.has_key else "none is set in"
                message = f"{message}; {key} {self._connection.key_name}"
            elif "has no model" in message and self._model_names:
                message = f"{message}; it has {', '.join(self._model_names[:20])}"
            return ModelUnavailable(f"{self._connection.address}: {message}")
        return error

    def _out_of_retries(self, error: RetryableError, attempts: int) -> Exception:
        """The exception that a request raises whose attempts all failed."""
        if error.unreachable:
            unavailable = ModelUnavailable(
                f"nothing listens at {self._connection.address} any more ({error}; {attempts} attempts): all "
                "completions so far are stored; start the endpoint again, and run the same command again to continue"
            )
            self.stop(unavailable)
            return unavailable
        failure = RequestFailed(error.kind, f"{error} ({attempts} attempts)")
        self._consecutive_failures += 1
        self._stop_if_broken(failure)
        return failure

    def _stop_if_broken(self, failure: RequestFailed) -> None:
        if self._consecutive_failures >= _MAX_CONSECUTIVE_FAILURES:
            self.stop(
                ModelUnavailable(
                    f"{self._connection.address} failed {_MAX_CONSECUTIVE_FAILURES} requests in a row, the last with: "
                    f"{failure}"
                )
            )

    async def _check_endpoint(self) -> None:
        """Request the list of models.

        An endpoint without that list is accepted. Raises ModelUnavailable if nothing listens at the address, or the
        endpoint rejects the key.
        """
        from openai import APIConnectionError, APIError, APIStatusError

        for number in range(_CONNECT_ATTEMPTS):
            try:
                async with asyncio.timeout(_MODELS_SECONDS):
                    models = await self._connection.client.models.list()
                    self._model_names = [model.id async for model in models if isinstance(model.id, str)]
                return
            except APIConnectionError as error:
                retryable = self._connection_error(error)
                if not retryable.unreachable:
                    return
                if number + 1 < _CONNECT_ATTEMPTS:
                    await self._sleep(retryable.backoff(number))
                    if self._unavailable is not None:
                        raise type(self._unavailable)(str(self._unavailable)) from None
                    continue
                unavailable = ModelUnavailable(
                    f"nothing listens at {self._connection.address} ({retryable}): start the endpoint, or give another "
                    "--base-url"
                )
                self.stop(unavailable)
                raise unavailable from None
            except APIStatusError as error:
                if error.status_code == 401:
                    text = self._connection.redact(await _text(error.response))
                    rejected = self._explained(error_from_response(401, text, {}, Request("", ()), {}))
                    assert isinstance(rejected, ModelUnavailable)
                    self.stop(rejected)
                    raise rejected from None
                return
            except (APIError, ValueError, TypeError, AttributeError, TimeoutError):
                return


async def _chunks(response: AsyncAPIResponse[Any]) -> AsyncGenerator[Chunk, None]:
    """Yield the chunks of a response. Raises RetryableError if it breaks off, MalformedResponse."""
    decoder, finished = EventStreamDecoder(), False
    streamed = not response.headers.get("content-type", "").startswith("application/json")
    whole: list[bytes] = []
    parts = response.iter_bytes()
    while True:
        try:
            part = await anext(parts)
        except StopAsyncIteration:
            break
        except Exception as error:
            # Every exception: the classes are those of the library below the client's.
            if finished:
                return
            reason = excerpt(str(error)) or type(error).__name__
            raise RetryableError("disconnected", f"the connection broke: {reason}") from None
        if not streamed:
            whole.append(part)
            continue
        for event in decoder.feed(part):
            chunk = decode_chunk(event)
            finished = finished or bool(chunk.choices and chunk.choices[0].finish_reason)
            yield chunk
    for event in decoder.flush() if streamed else [b"".join(whole)]:
        chunk = decode_chunk(event)
        finished = finished or bool(chunk.choices and chunk.choices[0].finish_reason)
        yield chunk
    if not finished:
        raise RetryableError("disconnected", "the connection closed before the completion ended")


async def _text(response: Any) -> str:
    with contextlib.suppress(Exception):
        data: bytes = await response.aread()
        return data.decode("utf-8", "replace")[:2000]
    return ""
