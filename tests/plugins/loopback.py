"""A local HTTP server with scripted replies, which stands in for an endpoint."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

#: Writes what it will to the connection of a request, whose body it is given.
Reply = Callable[[asyncio.StreamWriter, dict[str, Any]], Awaitable[None]]


def status(code: int, body: Any = "", **headers: str) -> Reply:
    """Return a reply with a status, and a JSON body unless the body is text."""

    async def reply(writer: asyncio.StreamWriter, _: dict[str, Any]) -> None:
        kind = "text/html" if isinstance(body, str) else "application/json"
        told = (body if isinstance(body, str) else json.dumps(body)).encode()
        lines = [f"HTTP/1.1 {code} Told", f"Content-Type: {kind}", f"Content-Length: {len(told)}"]
        lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
        writer.write("\r\n".join(lines).encode() + b"\r\n\r\n" + told)
        await writer.drain()

    return reply


def error(code: int, message: str, name: str = "", **headers: str) -> Reply:
    """Return an error in the format of OpenAI's interface."""
    return status(
        code, {"error": {"message": message, "code": name or None, "type": "invalid_request_error"}}, **headers
    )


def piece(finish: str | None = None, **delta: Any) -> str:
    """Return an event of a stream."""
    return "data: " + json.dumps({"model": "loop", "choices": [{"index": 0, "delta": delta, "finish_reason": finish}]})


def stream(*events: str, pause: float = 0.0, cut: bool = False, stay: float = 0.0) -> Reply:
    """Return a stream of events; `stay` seconds after the last one it ends, or with `cut` the connection drops."""

    async def reply(writer: asyncio.StreamWriter, _: dict[str, Any]) -> None:
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n")
        for event in events:
            data = f"{event}\n\n".encode()
            writer.write(b"%x\r\n%s\r\n" % (len(data), data))
            await writer.drain()
            await asyncio.sleep(pause)
        await asyncio.sleep(stay)
        if cut:
            writer.transport.abort()
        else:
            writer.write(b"0\r\n\r\n")

    return reply


def says(text: str, finish: str = "stop", prompt: int = 7, **more: Any) -> Reply:
    """Return a streamed completion with usage."""
    words = [piece(content=part) for part in text.splitlines(keepends=True)]
    usage = {"prompt_tokens": prompt, "completion_tokens": len(text.split())}
    told = "data: " + json.dumps({"choices": [], "usage": usage})
    return stream(piece(role="assistant"), *words, piece(finish), told, "data: [DONE]", **more)


async def hang(writer: asyncio.StreamWriter, _: dict[str, Any]) -> None:
    """Never reply."""
    await asyncio.sleep(3600)


class Loopback:
    """The server, as a context manager: it sends the replies in order, and the last one repeatedly.

    `paths` are replies to other paths than that of completions.

    Attributes:
        requests, times: the bodies of the requests for completions, and when they came.
        headers: of the last request.
        max_in_flight: the most requests in flight at once.
    """

    def __init__(
        self, *replies: Reply, models: Iterable[str] | None = None, greeting: Reply | None = None, **paths: Reply
    ) -> None:
        self._replies, self._paths = list(replies), paths
        if greeting is not None:
            self._paths["models"] = greeting
        elif models is not None:
            self._paths["models"] = status(200, {"object": "list", "data": [{"id": name} for name in models]})
        self.requests: list[dict[str, Any]] = []
        self.times: list[float] = []
        self.headers: dict[str, str] = {}
        self.max_in_flight = self.in_flight = 0
        self.port = 0
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/v1"

    async def __aenter__(self) -> Loopback:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            while not writer.is_closing():
                await self._answer(reader, writer)
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._tasks.discard(task)
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head, *lines = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        self.headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
        data = await reader.readexactly(int(self.headers.get("content-length", 0)))
        path = head.split()[1].removeprefix("/v1/")
        if path != "chat/completions":
            named = self._paths.get(path.partition("/")[0].partition("?")[0])
            await (named or status(404, "nothing here"))(
                writer, {"path": path, "data": data, "method": head.split()[0]}
            )
            return
        self.in_flight += 1
        self.max_in_flight = max(self.max_in_flight, self.in_flight)
        try:
            body = json.loads(data)
            self.requests.append(body)
            self.times.append(asyncio.get_running_loop().time())
            reply = self._replies.pop(0) if len(self._replies) > 1 else self._replies[0]
            await reply(writer, body)
        finally:
            self.in_flight -= 1
