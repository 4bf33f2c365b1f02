"""``python -m benchmarks.conversations``: 1,000 conversations at once, through EnvCraft and by a bare client.

An endpoint on this machine, in a process of its own, streams answers as an engine does: at each tick every open
answer gets a piece, and answers are of different lengths, the same ones for both clients. Each conversation asks a few
times, and its prompt grows with what it was answered. The bare client is the HTTP library on which the `openai` client
is built: it sends the same bodies, reads the bytes of the stream, and does nothing with them. EnvCraft's model paces,
decodes, accounts, and writes its journal, to which every answer is synced. They take turns, in an order that changes,
and a ratio is the median of those within one round. Less than 95% of the bare client's answers a second gives exit
status 1.

The rate of the server is what an engine would have, not what this machine's cores can send: ``--tick 0`` takes the
bound away, and shows what EnvCraft costs where the cores are the limit.
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

from envcraft_llm.endpoint import ModelChoice, open_model
from envcraft_llm.endpoint.wording import body
from envcraft_llm.model import Message, Request
from rich.console import Console
from rich.table import Table

#: The least share of the bare client's answers a second.
LEAST = 0.95
OURS, BARE = "EnvCraft", "bare client"
PIECE = "    state[row, column] = 3  # moved\n"
_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
_END = b"data: [DONE]\n\n"
_NUMBER = re.compile(rb"Conversation (\d+)")


def chunk(data: bytes) -> bytes:
    """As chunked transfer has it."""
    return b"%x\r\n%s\r\n" % (len(data), data)


def event(choices: list[dict[str, Any]], **more: Any) -> bytes:
    """An event of the stream."""
    told = {
        "id": "chatcmpl-0",
        "object": "chat.completion.chunk",
        "created": 0,
        "model": "loop",
        "choices": choices,
        **more,
    }
    return b"data: " + json.dumps(told).encode() + b"\n\n"


class Engine:
    """Streams an answer to each connection that asked, a piece at each tick of so many seconds; at once where it is 0.
    The length of each is drawn by its prompt, evenly from half of `pieces` to one and a half.
    """

    def __init__(self, pieces: int, tick: float) -> None:
        self._pieces, self._tick = pieces, tick
        self._open: dict[asyncio.Transport, int] = {}
        self._piece = chunk(event([{"index": 0, "delta": {"content": PIECE}, "finish_reason": None}]))
        usage = {"prompt_tokens": 100, "completion_tokens": pieces, "total_tokens": 100 + pieces}
        last = event([{"index": 0, "delta": {}, "finish_reason": "stop"}]) + event([], usage=usage) + _END
        self._last = chunk(last) + b"0\r\n\r\n"

    def begin(self, transport: asyncio.Transport, asked: bytes) -> None:
        """Answer a request with this body on its connection."""
        least = self._pieces // 2
        # Bodies differ between clients by blanks and the order of keys; what is asked does not.
        drawn = zlib.crc32(b"%d %b" % (asked.count(b"Complaint"), b"".join(_NUMBER.findall(asked)[:1])))
        length = least + drawn % (2 * (self._pieces - least) + 1)
        if self._tick:
            transport.write(_HEAD)
            self._open[transport] = length
        else:
            transport.write(_HEAD + self._piece * length + self._last)

    async def run(self) -> None:
        """Tick."""
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


class Asked(asyncio.Protocol):
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


def serve(told: Connection, pieces: int, tick: float) -> None:
    """The process of the server: tells its port, and ends with the benchmark."""

    async def run() -> None:
        engine = Engine(pieces, tick)
        server = await asyncio.get_running_loop().create_server(lambda: Asked(engine), "127.0.0.1", 0, backlog=4096)
        told.send(server.sockets[0].getsockname()[1])
        await engine.run()

    allow_files()
    asyncio.run(run())


def allow_files() -> None:
    """Two descriptors a conversation may be more than a shell allows."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def request(number: int, turn: int) -> Request:
    """What a conversation asks at its turn: all that was said before, and one thing more."""
    messages = [Message("system", "You write games."), Message("user", f"Conversation {number}: write a game.")]
    for earlier in range(turn):
        messages += [Message("assistant", PIECE * 8), Message("user", f"Complaint {earlier}: it cannot be won.")]
    return Request("loop", tuple(messages), effort="medium", max_tokens=4096, stage="code", concept=str(number))


async def talk(conversations: int, turns: int, ask: Callable[[Request], Awaitable[object]]) -> float:
    """All conversations, at once; answers a second."""

    async def one(number: int) -> None:
        for turn in range(turns):
            await ask(request(number, turn))

    began = time.perf_counter()
    async with asyncio.TaskGroup() as group:
        for number in range(conversations):
            group.create_task(one(number))
    return conversations * turns / (time.perf_counter() - began)


async def ours(url: str, conversations: int, turns: int) -> float:
    """By EnvCraft, with a journal that is new."""
    choice = ModelChoice(base_url=url, min_concurrency=conversations, max_concurrency=conversations)
    with tempfile.TemporaryDirectory() as folder:
        model = open_model(choice, Path(folder))
        try:
            return await talk(conversations, turns, model.ask)
        finally:
            await model.close()


async def bare(url: str, conversations: int, turns: int) -> float:
    """By the library below the `openai` client."""
    from openai import DEFAULT_CONNECTION_LIMITS

    library = importlib.import_module(type(DEFAULT_CONNECTION_LIMITS).__module__.partition(".")[0])
    limits = library.Limits(max_connections=conversations, max_keepalive_connections=conversations)
    async with library.AsyncClient(limits=limits, timeout=None) as client:

        async def ask(asked: Request) -> None:
            async with client.stream("POST", f"{url}/chat/completions", json=body(asked)) as response:
                async for _ in response.aiter_bytes():
                    pass

        return await talk(conversations, turns, ask)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; give 1 where the limit does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.conversations", description=__doc__)
    parser.add_argument("--conversations", type=int, default=1000)
    parser.add_argument("--turns", type=int, default=2, help="questions of each")
    parser.add_argument("--pieces", type=int, default=16, help="of an answer")
    parser.add_argument("--tick", type=float, default=0.5, help="seconds between the pieces of an answer")
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
                # What is imported at the first question is no part of it.
                asyncio.run(clients[name](url, 1, 1))
                began = time.process_time()
                rates[name].append(asyncio.run(clients[name](url, options.conversations, options.turns)))
                cpu[name].append((time.process_time() - began) / (options.conversations * options.turns) * 1e3)
    finally:
        server.kill()
        server.join()
    ratio = statistics.median(mine / other for mine, other in zip(rates[OURS], rates[BARE], strict=True))
    table = Table(
        title=f"{options.conversations:,} conversations of {options.turns} questions, answers of {options.pieces} "
        f"pieces, one every {options.tick:g} s, {options.rounds} rounds"
    )
    for column in ("", "answers/s, median", "least", "most", "CPU ms an answer", "share of the bare client's"):
        table.add_column(column, justify="left" if not column else "right")
    for name, found in rates.items():
        figures = (f"{value:,.1f}" for value in (statistics.median(found), min(found), max(found)))
        table.add_row(name, *figures, f"{statistics.median(cpu[name]):.2f}", f"{ratio:.1%}" if name == OURS else "")
    console = Console(width=120)
    console.print(table)
    if ratio < LEAST:
        console.print(f"limit broken: {ratio:.1%} of the bare client's answers; at least {LEAST:.0%}")
    return int(ratio < LEAST)


if __name__ == "__main__":
    raise SystemExit(main())
