"""The journal: nothing is asked twice, a run is repeated from it without an endpoint, and it outlives kill -9."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from envcraft_llm.endpoint import ModelChoice, OpenedModel, faults, open_model
from envcraft_llm.endpoint.journal import JOURNAL, Failed, Journal
from envcraft_llm.model import Answer, Message, ModelFailure, ModelStopped, Request

from envcraft.cli import cli
from envcraft.corpus.store import Store
from envcraft.errors import EnvCraftError, UsageError
from tests.plugins.loopback import Loopback, error, piece, says, stream

_FAILED = (Failed("server-error", "HTTP 500"),)


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "_LONGEST", 0.01)
    monkeypatch.setenv("OPENAI_API_KEY", "unused")


def request(text: str, **more: Any) -> Request:
    told: dict[str, Any] = {"model": "m", "stage": "briefs", "concept": "c1", **more}
    return Request(messages=(Message("user", text),), **told)


def online(server: Loopback, journal: Path, use: Callable[[OpenedModel], Awaitable[Any]]) -> Any:
    async def run() -> Any:
        async with server:
            model = open_model(ModelChoice(base_url=server.url, retries=1), journal)
            try:
                return await use(model)
            finally:
                await model.close()

    return asyncio.run(run())


def offline(journal: Path, use: Callable[[OpenedModel], Awaitable[Any]]) -> Any:
    async def run() -> Any:
        model = open_model(ModelChoice(), journal, offline=True)
        try:
            return await use(model)
        finally:
            await model.close()

    return asyncio.run(run())


async def outcomes(model: OpenedModel, requests: list[Request]) -> list[Answer | tuple[str, str]]:
    found: list[Answer | tuple[str, str]] = []
    for asking in requests:
        try:
            found.append(await model.ask(asking))
        except ModelFailure as failure:
            found.append((failure.kind, str(failure)))
    return found


def test_a_run_is_repeated_from_its_journal_with_the_server_gone(tmp_path: Path) -> None:
    rng = random.Random(0)

    async def at_random(writer: asyncio.StreamWriter, body: dict[str, Any]) -> None:
        good = says(
            f"answer {rng.random()}\nto {body['messages'][0]['content']}", finish=rng.choice(["stop", "length"])
        )
        thoughtful = stream(piece(reasoning=f"hm {rng.random()}"), piece(content="ok \u2713"), piece("stop"))
        bad = error(500, "oh"), stream(piece(content="co")), stream(piece("stop")), error(400, "context length")
        await rng.choice([good, good, thoughtful, *bad])(writer, body)

    requests = [request(f"q{number % 25}", sample=number % 2, attempt=number % 3) for number in range(60)]
    server = Loopback(at_random)
    first = online(server, tmp_path, lambda model: outcomes(model, requests))
    assert {kind for kind, _ in (told for told in first if isinstance(told, tuple))} >= {"empty", "context-overflow"}
    assert sum(isinstance(told, Answer) for told in first) > 10
    # In another order, too; failures of the network are repeated as they were.
    last = {asked.key(): told for asked, told in zip(requests, first, strict=True)}
    rng.shuffle(requests)
    again = offline(tmp_path, lambda model: outcomes(model, requests))
    assert again == [last[asked.key()] for asked in requests]
    assert (tmp_path / JOURNAL).is_file()


def test_what_the_journal_lacks_stops_a_run_that_asks_nobody(tmp_path: Path) -> None:
    online(Loopback(says("code")), tmp_path, lambda model: model.ask(request("known")))
    words = f"{tmp_path / JOURNAL} has no answer for the stage repair of maze-7, attempt 2, by m"
    with pytest.raises(ModelStopped, match=words):
        offline(tmp_path, lambda model: model.ask(request("unknown", stage="repair", concept="maze-7", attempt=2)))
    with pytest.raises(UsageError, match=r"nowhere.sqlite does not exist"):
        open_model(ModelChoice(), tmp_path / "nowhere.sqlite", offline=True)
    with pytest.raises(UsageError, match="nothing to answer from"):
        open_model(ModelChoice(), None, offline=True)


def test_only_failures_of_the_network_are_asked_again_and_answers_stay(tmp_path: Path) -> None:
    empty, lost = request("empty"), request("lost")
    server = Loopback(stream(piece("stop")), error(500, "oh"), error(500, "oh"), says("code"))
    (first, second) = online(server, tmp_path, lambda model: outcomes(model, [empty, lost]))
    assert (first[0], second[0]) == ("empty", "server-error")
    (third, fourth) = online(server, tmp_path, lambda model: outcomes(model, [empty, lost]))
    assert third == first
    assert fourth.text == "code"
    assert offline(tmp_path, lambda model: outcomes(model, [empty, lost])) == [first, fourth]


def test_the_journals_of_corpora_are_merged_and_each_request_is_kept_once(tmp_path: Path) -> None:
    asked = [request(f"q{number}") for number in range(6)]
    mine, other = tmp_path / "mine", tmp_path / "other"
    known: dict[Path, list[Answer | Failed]] = {
        mine: [Answer("a0"), Answer("a1"), Failed("timeout", "late"), Failed("refused", "no")],
        other: [Answer("b0"), Failed("empty", "-"), Answer("b2"), Failed("timeout", "late"), Answer("b4"), *_FAILED],
    }
    for place, told in known.items():
        Store.create(place).close()
        with contextlib.closing(Journal(place)) as journal:
            journal.keep_now(list(zip(asked, told, strict=False)))
    with sqlite3.connect(other / JOURNAL) as db:
        before = db.execute("SELECT * FROM answers ORDER BY key").fetchall()
    for words in ("3 answers", None):
        result = CliRunner().invoke(cli, ["corpus", "merge", str(mine), str(other)])
        ended = f"0 environments, 0 verdicts and {words} added" if words else "0 environments and 0 verdicts added"
        assert (result.exit_code, result.output) == (0, f"{ended}\n")
    with contextlib.closing(Journal(mine, write=False)) as journal:
        found = [journal.find(one.key(), passing=True) for one in asked]
        assert found == [Answer("a0"), Answer("a1"), Answer("b2"), Failed("refused", "no"), Answer("b4"), *_FAILED]
    with sqlite3.connect(other / JOURNAL) as db:
        assert db.execute("SELECT * FROM answers ORDER BY key").fetchall() == before


def test_a_journal_that_cannot_be_merged_is_told_of(tmp_path: Path) -> None:
    for name in ("mine", "other"):
        Store.create(tmp_path / name).close()
    (tmp_path / "other" / JOURNAL).write_text("no database, but long enough to be looked at as one" * 20)
    result = CliRunner().invoke(cli, ["corpus", "merge", str(tmp_path / "mine"), str(tmp_path / "other")])
    assert result.exit_code == 3
    assert f"{tmp_path / 'other' / JOURNAL} cannot be used as a journal" in result.output
    assert not (tmp_path / "mine" / JOURNAL).exists()


def test_requests_under_way_are_asked_once_and_samples_apart(tmp_path: Path) -> None:
    server = Loopback(says("code", pause=0.01))

    async def use(model: OpenedModel) -> None:
        same = [model.ask(request("q", stage=stage, attempt=number)) for number, stage in enumerate(("code", "repair"))]
        other = [model.ask(request("q", sample=1)), model.ask(request("q", temperature=0.5))]
        answers = await asyncio.gather(*same, *other)
        assert answers[0] is answers[1]

    online(server, tmp_path, use)
    assert len(server.asked) == 3


def test_who_asks_may_be_cancelled_and_the_answer_is_kept(tmp_path: Path) -> None:
    server = Loopback(says("code", stay=0.2))

    async def use(model: OpenedModel) -> None:
        asking = asyncio.create_task(model.ask(request("q")))
        await asyncio.sleep(0.1)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking

    online(server, tmp_path, use)
    assert offline(tmp_path, lambda model: model.ask(request("q"))).text == "code"


def test_a_journal_that_cannot_be_written_stops_the_run(tmp_path: Path) -> None:
    async def use(model: OpenedModel) -> None:
        assert await model.ask(request("one"))
        with sqlite3.connect(tmp_path / JOURNAL) as db:
            db.execute("DROP TABLE answers")
            db.commit()
        assert model._journal is not None
        with pytest.raises((ModelStopped, sqlite3.Error)):
            await model.ask(request("two"))

    online(Loopback(says("code")), tmp_path, use)


@pytest.mark.parametrize("text", [b"no database " * 100, b""])
def test_what_is_no_journal_is_told(tmp_path: Path, text: bytes) -> None:
    (tmp_path / JOURNAL).write_bytes(text)
    with pytest.raises(EnvCraftError, match=JOURNAL):
        Journal(tmp_path, write=False)
    (tmp_path / "other.sqlite").touch()
    with sqlite3.connect(tmp_path / "other.sqlite") as db:
        db.execute("PRAGMA user_version = 7")
    with pytest.raises(EnvCraftError, match="of version 7"):
        Journal(tmp_path / "other.sqlite")


def test_a_journal_is_read_where_nothing_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    online(Loopback(says("code")), tmp_path, lambda model: model.ask(request("q")))
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert offline(tmp_path, lambda model: model.ask(request("q"))).text == "code"
    assert [path.name for path in tmp_path.iterdir()] == [JOURNAL]


_WRITER = """
import asyncio, sys
from pathlib import Path
from envcraft_llm.endpoint.journal import Journal
from envcraft_llm.model import Answer, Message, Request

async def main():
    journal = Journal(Path(sys.argv[1]))
    begin = int(sys.argv[2])
    async def write(lane):
        for number in range(begin + lane, begin + 100000, 8):
            request = Request("m", (Message("user", f"q{number}"),))
            await journal.keep(request, Answer(text=f"a{number} " * 200))
            print(number, flush=True)
    await asyncio.gather(*(write(lane) for lane in range(8)))

asyncio.run(main())
"""


def test_what_was_kept_outlives_kill_and_what_is_torn_is_dropped(tmp_path: Path) -> None:
    rng, told = random.Random(1), set[int]()
    for turn in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(tmp_path), str(turn * 100_000)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        told.add(int(process.stdout.readline()))
        time.sleep(rng.uniform(0, 0.1))
        os.kill(process.pid, signal.SIGKILL)
        told.update(int(line) for line in process.stdout.read().splitlines(keepends=True) if line.endswith("\n"))
        process.wait()
    journal = Journal(tmp_path)
    for number in told:
        kept = journal.find(request(f"q{number}").key())
        assert isinstance(kept, Answer)
        assert kept.text == f"a{number} " * 200
    assert len(told) > 20
    journal.close()


def test_a_torn_log_costs_only_what_was_not_whole(tmp_path: Path) -> None:
    async def write() -> None:
        journal = Journal(tmp_path)
        for number in range(50):
            await journal.keep(request(f"q{number}"), Failed("empty", f"a{number} " * 100))
        for path in tmp_path.iterdir():
            (tmp_path / "copy").mkdir(exist_ok=True)
            if not path.is_dir():
                (tmp_path / "copy" / path.name).write_bytes(path.read_bytes())
        journal.close()

    asyncio.run(write())
    log = tmp_path / "copy" / f"{JOURNAL}-wal"
    os.truncate(log, log.stat().st_size - 500)
    (tmp_path / "copy" / f"{JOURNAL}-shm").unlink()
    journal = Journal(tmp_path / "copy")
    found = [journal.find(request(f"q{number}").key()) is not None for number in range(50)]
    assert found == [True] * 49 + [False]
    journal.close()
