"""``python -m benchmarks.conversations``: 1,000 concurrent conversations through EnvCraft and through a bare client.

A local server in another process streams responses like an inference engine: at each tick it sends one piece of every
open response. Responses differ in length, and both clients get the same ones. Each conversation sends several requests,
and its prompt grows with the responses. The bare client is the HTTP library on which the `openai` client is built: it
sends the same bodies, reads the bytes of the stream and discards them. EnvCraft's model limits the concurrency, decodes
the stream, counts tokens and writes a journal, which it syncs after each response. The clients take turns in
alternating order, and a ratio is the median of the ratios within one round. The exit status is 1 if EnvCraft completes
less than 95% of the bare client's responses a second.

By default the server is as fast as an engine, not as fast as this machine's cores: ``--tick 0`` removes that bound and
shows the cost of EnvCraft when the cores are the limit.
"""

from __future__ import annotations

import argparse
import asyncio
import importlib
import json
import multiprocessing
import re
import resource
import statistics
import tempfile
import time
import zlib
from collections.abc import Awaitable, Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from envcraft_llm.endpoint import ModelSettings, open_model
from envcraft_llm.endpoint.request_body import request_body
from envcraft_llm.model import Message, Request
from rich.console import Console
from rich.table import Table

#: The least share of the bare client's responses a second.
LEAST = 0.95
OURS, BARE = "EnvCraft", "bare client"
PIECE = "    state[row, column] = 3  # moved\n"
_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
_END = b"data: [DONE]\n\n"
_NUMBER = re.compile(rb"Conversation (\d+)")


def chunk(data: bytes) -> bytes:
    """A chunk of an HTTP/1.1 chunked transfer."""
    return b"%x\r\n%s\r\n" % (len(data), data)


def event(choices: list[dict[str, Any]], **more: Any) -> bytes:
    """A server-sent event of the stream."""
    body = {
        "id": "chatcmpl-0",
        "object": "chat.completion.chunk",
        "created": 0,
        "model": "loop",
        "choices": choices,
        **more,
    }
    return b"data: " + json.dumps(body).encode() + b"\n\n"


class Engine:
    """Streams a response to each request: one piece per tick of `tick` seconds, or all pieces at once if it is 0.

    The prompt determines the length of the response, uniformly from half of `pieces` to one and a half times `pieces`.
    """

    def __init__(self, pieces: int, tick: float) -> None:
        self._pieces, self._tick = pieces, tick
        self._open: dict[asyncio.Transport, int] = {}
        self._piece = chunk(event([{"index": 0, "delta": {"content": PIECE}, "finish_reason": None}]))
        usage = {"prompt_tokens": 100, "completion_tokens": pieces, "total_tokens": 100 + pieces}
        last = event([{"index": 0, "delta": {}, "finish_reason": "stop"}]) + event([], usage=usage) + _END
        self._last = chunk(last) + b"0\r\n\r\n"

    def begin(self, transport: asyncio.Transport, request: bytes) -> None:
        """Respond to a request with this body on its connection."""
        least = self._pieces // 2
        # Not a digest of the body: white space and the order of keys differ between clients.
        drawn = zlib.crc32(b"%d %b" % (request.count(b"Complaint"), b"".join(_NUMBER.findall(request)[:1])))
        length = least + drawn % (2 * (self._pieces - least) + 1)
        if self._tick:
            transport.write(_HEAD)
            self._open[transport] = length
        else:
            transport.write(_HEAD + self._piece * length + self._last)

    async def run(self) -> None:
        """Send the pieces of the open responses."""
        loop = asyncio.get_running_loop()
        following = loop.time()
        while True:
            following += self._tick or 1.0
            await asyncio.sleep(following - loop.time())
            for transport, left in list(self._open.items()):
                if left:
                    transport.write(self._piece)
                    self._open[transport] = left - 1
                else:
                    transport.write(self._last)
                    del self._open[transport]


class Requests(asyncio.Protocol):
    """A connection: reads each request to its end."""

    def __init__(self, engine: Engine) -> None:
        self._engine, self._read = engine, b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._read += data
        head, found, rest = self._read.partition(b"\r\n\r\n")
        if not found:
            return
        length = 0
        for line in head.lower().split(b"\r\n"):
            if line.startswith(b"content-length:"):
                length = int(line[15:])
        if len(rest) < length:
            return
        self._read = rest[length:]
        if b"/chat/completions" in head:
            self._engine.begin(self._transport, rest[:length])
        else:
            self._transport.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")


def serve(connection: Connection, pieces: int, tick: float) -> None:
    """Run the server in this process; send its port through the connection."""

    async def run() -> None:
        engine = Engine(pieces, tick)
        server = await asyncio.get_running_loop().create_server(lambda: Requests(engine), "127.0.0.1", 0, backlog=4096)
        connection.send(server.sockets[0].getsockname()[1])
        await engine.run()

    allow_files()
    asyncio.run(run())


def allow_files() -> None:
    """Raise the limit on open files: each conversation needs two descriptors."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def request(number: int, turn: int) -> Request:
    """The request of a conversation at a turn: the earlier messages and a new one."""
    messages = [Message("system", "You write games."), Message("user", f"Conversation {number}: write a game.")]
    for earlier in range(turn):
        messages += [Message("assistant", PIECE * 8), Message("user", f"Complaint {earlier}: it cannot be won.")]
    return Request("loop", tuple(messages), effort="medium", max_tokens=4096, stage="code", concept=str(number))


async def talk(conversations: int, turns: int, ask: Callable[[Request], Awaitable[object]]) -> float:
    """Hold all conversations concurrently; return the responses a second."""

    async def one(number: int) -> None:
        for turn in range(turns):
            await ask(request(number, turn))

    started = time.perf_counter()
    async with asyncio.TaskGroup() as group:
        for number in range(conversations):
            group.create_task(one(number))
    return conversations * turns / (time.perf_counter() - started)


async def ours(url: str, conversations: int, turns: int) -> float:
    """Through EnvCraft, with a new journal."""
    choice = ModelSettings(base_url=url, min_concurrency=conversations, max_concurrency=conversations)
    with tempfile.TemporaryDirectory() as folder:
        model = open_model(choice, Path(folder))
        try:
            return await talk(conversations, turns, model.generate)
        finally:
            await model.close()


async def bare(url: str, conversations: int, turns: int) -> float:
    """Through the HTTP library of the `openai` client."""
    from openai import DEFAULT_CONNECTION_LIMITS

    library = importlib.import_module(type(DEFAULT_CONNECTION_LIMITS).__module__.partition(".")[0])
    limits = library.Limits(max_connections=conversations, max_keepalive_connections=conversations)
    async with library.AsyncClient(limits=limits, timeout=None) as client:

        async def generate(request: Request) -> None:
            async with client.stream("POST", f"{url}/chat/completions", json=request_body(request)) as response:
                async for _ in response.aiter_bytes():
                    pass

        return await talk(conversations, turns, generate)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.conversations", description=__doc__)
    parser.add_argument("--conversations", type=int, default=1000)
    parser.add_argument("--turns", type=int, default=2, help="requests per conversation")
    parser.add_argument("--pieces", type=int, default=16, help="mean number of pieces per response")
    parser.add_argument("--tick", type=float, default=0.5, help="seconds between the pieces of a response")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args(arguments)
    allow_files()
    spawned = multiprocessing.get_context("spawn")
    receiving, sending = spawned.Pipe(duplex=False)
    server = spawned.Process(target=serve, args=(sending, options.pieces, options.tick), daemon=True)
    server.start()
    clients = {OURS: ours, BARE: bare}
    rates: dict[str, list[float]] = {name: [] for name in clients}
    cpu: dict[str, list[float]] = {name: [] for name in clients}
    try:
        url = f"http://127.0.0.1:{receiving.recv()}/v1"
        for number in range(options.rounds):
            for name in sorted(clients, reverse=number % 2 == 1):
                # The first request imports modules, which is not part of the measurement.
                asyncio.run(clients[name](url, 1, 1))
                started = time.process_time()
                rates[name].append(asyncio.run(clients[name](url, options.conversations, options.turns)))
                cpu[name].append((time.process_time() - started) / (options.conversations * options.turns) * 1e3)
    finally:
        server.kill()
        server.join()
    ratio = statistics.median(mine / other for mine, other in zip(rates[OURS], rates[BARE], strict=True))
    table = Table(
        title=f"{options.conversations:,} conversations of {options.turns} requests, responses of {options.pieces} "
        f"pieces, one every {options.tick:g} s, {options.rounds} rounds"
    )
    for column in ("", "responses/s, median", "lowest", "highest", "CPU ms per response", "share of the bare client"):
        table.add_column(column, justify="left" if not column else "right")
    for name, found in rates.items():
        figures = (f"{value:,.1f}" for value in (statistics.median(found), min(found), max(found)))
        table.add_row(name, *figures, f"{statistics.median(cpu[name]):.2f}", f"{ratio:.1%}" if name == OURS else "")
    console = Console(width=120)
    console.print(table)
    if ratio < LEAST:
        console.print(f"limit broken: {ratio:.1%} of the bare client's responses a second; at least {LEAST:.0%}")
    return int(ratio < LEAST)


if __name__ == "__main__":
    raise SystemExit(main())
