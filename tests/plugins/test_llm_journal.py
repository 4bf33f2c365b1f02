"""The journal: no request is sent twice, a run is replayed without an endpoint, and results survive kill -9."""

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
import zlib
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from envcraft_llm.endpoint import JournaledModel, ModelSettings, batch_files, errors, open_model
from envcraft_llm.endpoint.journal import JOURNAL, Failure, Journal
from envcraft_llm.model import Completion, Message, ModelUnavailable, Request, RequestFailed

from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.errors import EnvCraftError, UsageError
from tests.plugins.loopback import Loopback, error, piece, says, stream

_FAILED = (Failure("server-error", "HTTP 500"),)


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(errors, "_MAX_BACKOFF", 0.01)
    monkeypatch.setenv("OPENAI_API_KEY", "unused")


def request(text: str, **more: Any) -> Request:
    told: dict[str, Any] = {"model": "m", "stage": "briefs", "concept": "c1", **more}
    return Request(messages=(Message("user", text),), **told)


def online(server: Loopback, journal: Path, use: Callable[[JournaledModel], Awaitable[Any]]) -> Any:
    async def run() -> Any:
        async with server:
            model = open_model(ModelSettings(base_url=server.url, retries=1), journal)
            try:
                return await use(model)
            finally:
                await model.close()

    return asyncio.run(run())


def offline(journal: Path, use: Callable[[JournaledModel], Awaitable[Any]]) -> Any:
    async def run() -> Any:
        model = open_model(ModelSettings(), journal, offline=True)
        try:
            return await use(model)
        finally:
            await model.close()

    return asyncio.run(run())


async def outcomes(model: JournaledModel, requests: list[Request]) -> list[Completion | tuple[str, str]]:
    found: list[Completion | tuple[str, str]] = []
    for asking in requests:
        try:
            found.append(await model.generate(asking))
        except RequestFailed as failure:
            found.append((failure.kind, str(failure)))
    return found


def test_a_run_is_replayed_without_the_server(tmp_path: Path) -> None:
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
    assert sum(isinstance(told, Completion) for told in first) > 10
    # In another order, too; failures of the network are repeated as they were.
    last = {asked.key(): told for asked, told in zip(requests, first, strict=True)}
    rng.shuffle(requests)
    again = offline(tmp_path, lambda model: outcomes(model, requests))
    assert again == [last[asked.key()] for asked in requests]
    assert (tmp_path / JOURNAL).is_file()


def test_a_missing_result_stops_an_offline_run(tmp_path: Path) -> None:
    online(Loopback(says("code")), tmp_path, lambda model: model.generate(request("known")))
    words = f"{tmp_path / JOURNAL} has no result for the stage repair of maze-7, attempt 2, by m"
    with pytest.raises(ModelUnavailable, match=words):
        offline(tmp_path, lambda model: model.generate(request("unknown", stage="repair", concept="maze-7", attempt=2)))
    with pytest.raises(UsageError, match=r"nowhere.sqlite does not exist"):
        open_model(ModelSettings(), tmp_path / "nowhere.sqlite", offline=True)
    with pytest.raises(UsageError, match="no journal is given"):
        open_model(ModelSettings(), None, offline=True)


def test_only_transient_failures_are_sent_again(tmp_path: Path) -> None:
    empty, lost = request("empty"), request("lost")
    server = Loopback(stream(piece("stop")), error(500, "oh"), error(500, "oh"), says("code"))
    (first, second) = online(server, tmp_path, lambda model: outcomes(model, [empty, lost]))
    assert (first[0], second[0]) == ("empty", "server-error")
    (third, fourth) = online(server, tmp_path, lambda model: outcomes(model, [empty, lost]))
    assert third == first
    assert fourth.text == "code"
    assert offline(tmp_path, lambda model: outcomes(model, [empty, lost])) == [first, fourth]


def test_corpus_merge_merges_the_journals(tmp_path: Path) -> None:
    asked = [request(f"q{number}") for number in range(6)]
    mine, other = tmp_path / "mine", tmp_path / "other"
    known: dict[Path, list[Completion | Failure]] = {
        mine: [Completion("a0"), Completion("a1"), Failure("timeout", "late"), Failure("refused", "no")],
        other: [
            Completion("b0"),
            Failure("empty", "-"),
            Completion("b2"),
            Failure("timeout", "late"),
            Completion("b4"),
            *_FAILED,
        ],
    }
    for place, told in known.items():
        Store.create(place).close()
        with contextlib.closing(Journal(place)) as journal:
            journal.put_all(list(zip(asked, told, strict=False)))
    with sqlite3.connect(other / JOURNAL) as db:
        before = db.execute("SELECT * FROM answers ORDER BY key").fetchall()
    for words in ("3 answers", None):
        result = CliRunner().invoke(cli, ["corpus", "merge", str(mine), str(other)])
        ended = f"0 environments, 0 verdicts and {words} added" if words else "0 environments and 0 verdicts added"
        assert (result.exit_code, result.output) == (0, f"{ended}\n")
    with contextlib.closing(Journal(mine, write=False)) as journal:
        found = [journal.get(one.key(), transient=True) for one in asked]
        assert found == [
            Completion("a0"),
            Completion("a1"),
            Completion("b2"),
            Failure("refused", "no"),
            Completion("b4"),
            *_FAILED,
        ]
    with sqlite3.connect(other / JOURNAL) as db:
        assert db.execute("SELECT * FROM answers ORDER BY key").fetchall() == before


def test_a_journal_that_cannot_be_merged_is_an_error(tmp_path: Path) -> None:
    for name in ("mine", "other"):
        Store.create(tmp_path / name).close()
    (tmp_path / "other" / JOURNAL).write_text("no database, but long enough to be looked at as one" * 20)
    result = CliRunner().invoke(cli, ["corpus", "merge", str(tmp_path / "mine"), str(tmp_path / "other")])
    assert result.exit_code == 3
    assert f"{tmp_path / 'other' / JOURNAL} cannot be used as a journal" in result.output
    assert not (tmp_path / "mine" / JOURNAL).exists()


def test_equal_requests_in_flight_are_sent_once(tmp_path: Path) -> None:
    server = Loopback(says("code", pause=0.01))

    async def use(model: JournaledModel) -> None:
        same = [
            model.generate(request("q", stage=stage, attempt=number)) for number, stage in enumerate(("code", "repair"))
        ]
        other = [model.generate(request("q", sample=1)), model.generate(request("q", temperature=0.5))]
        answers = await asyncio.gather(*same, *other)
        assert answers[0] is answers[1]

    online(server, tmp_path, use)
    assert len(server.requests) == 3


def test_the_completion_of_a_cancelled_caller_is_stored(tmp_path: Path) -> None:
    server = Loopback(says("code", stay=0.2))

    async def use(model: JournaledModel) -> None:
        asking = asyncio.create_task(model.generate(request("q")))
        while not server.requests:
            await asyncio.sleep(0.01)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking

    online(server, tmp_path, use)
    assert offline(tmp_path, lambda model: model.generate(request("q"))).text == "code"


def test_a_journal_that_cannot_be_written_stops_the_run(tmp_path: Path) -> None:
    async def use(model: JournaledModel) -> None:
        assert await model.generate(request("one"))
        with sqlite3.connect(tmp_path / JOURNAL) as db:
            db.execute("DROP TABLE answers")
            db.commit()
        assert model._journal is not None
        with pytest.raises((ModelUnavailable, sqlite3.Error)):
            await model.generate(request("two"))

    online(Loopback(says("code")), tmp_path, use)


_EARLIER_REQUEST = (
    b'{"model":"m","messages":[{"role":"system","content":"s"},{"role":"user","content":"%d"}],"effort":"low",'
    b'"max_tokens":0,"temperature":null,"schema":{"a":1},"sample":0,"stage":"code","concept":"c","attempt":0}'
)
_EARLIER_ROWS = (
    ("87fe1a7338efb8f88a5132cf2bcfc390153a05421a95ec091222267105634f57", "answer", b'{"text":"t","reasoning":"r"}'),
    ("f6f23eff6c5b2a4e196b935227e4053300dcf4bb7c320d415267d0921371ee4b", "empty", b'"nothing"'),
)


def test_a_journal_and_a_batch_of_an_earlier_version_are_read(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / JOURNAL)) as db:
        db.executescript(
            "CREATE TABLE answers (key TEXT PRIMARY KEY, stage TEXT NOT NULL, concept TEXT NOT NULL, attempt INTEGER "
            "NOT NULL, model TEXT NOT NULL, outcome TEXT NOT NULL, request BLOB NOT NULL, result BLOB NOT NULL, "
            "written REAL NOT NULL); PRAGMA user_version = 1;"
        )
        for number, (key, outcome, result) in enumerate(_EARLIER_ROWS, 1):
            packed = (zlib.compress(part) for part in (_EARLIER_REQUEST % number, result))
            db.execute("INSERT INTO answers VALUES (?, 'code', 'c', 0, 'm', ?, ?, ?, 0)", (key, outcome, *packed))
        db.commit()
    (tmp_path / "batches").mkdir()
    (tmp_path / "batches" / "b.requests.jsonl").write_bytes(_EARLIER_REQUEST % 1 + b"\n")
    messages = [(Message("system", "s"), Message("user", str(number))) for number in (1, 2)]
    requests = [Request("m", one, effort="low", schema={"a": 1}) for one in messages]
    with contextlib.closing(Journal(tmp_path, write=False)) as journal:
        found = [journal.get(one.key()) for one in requests]
    assert found == [Completion("t", reasoning="r"), Failure("empty", "nothing")]
    assert batch_files.load_requests(tmp_path / "batches", "b").keys() == {requests[0].key()}


@pytest.mark.parametrize("text", [b"no database " * 100, b""])
def test_an_invalid_journal_is_an_error(tmp_path: Path, text: bytes) -> None:
    (tmp_path / JOURNAL).write_bytes(text)
    with pytest.raises(EnvCraftError, match=JOURNAL):
        Journal(tmp_path, write=False)
    (tmp_path / "other.sqlite").touch()
    with sqlite3.connect(tmp_path / "other.sqlite") as db:
        db.execute("PRAGMA user_version = 7")
    with pytest.raises(EnvCraftError, match="has version 7"):
        Journal(tmp_path / "other.sqlite")


def test_a_journal_in_a_read_only_folder_is_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    online(Loopback(says("code")), tmp_path, lambda model: model.generate(request("q")))
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert offline(tmp_path, lambda model: model.generate(request("q"))).text == "code"
    assert [path.name for path in tmp_path.iterdir()] == [JOURNAL]


_WRITER = """
import asyncio, sys
from pathlib import Path
from envcraft_llm.endpoint.journal import Journal
from envcraft_llm.model import Completion, Message, Request

async def main():
    journal = Journal(Path(sys.argv[1]))
    begin = int(sys.argv[2])
    async def write(lane):
        for number in range(begin + lane, begin + 100000, 8):
            request = Request("m", (Message("user", f"q{number}"),))
            await journal.put(request, Completion(text=f"a{number} " * 200))
            print(number, flush=True)
    await asyncio.gather(*(write(lane) for lane in range(8)))

asyncio.run(main())
"""


def test_written_results_survive_kill(tmp_path: Path) -> None:
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
        kept = journal.get(request(f"q{number}").key())
        assert isinstance(kept, Completion)
        assert kept.text == f"a{number} " * 200
    assert len(told) > 20
    journal.close()


def test_a_torn_log_loses_only_the_last_result(tmp_path: Path) -> None:
    async def write() -> None:
        journal = Journal(tmp_path)
        for number in range(50):
            await journal.put(request(f"q{number}"), Failure("empty", f"a{number} " * 100))
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
    found = [journal.get(request(f"q{number}").key()) is not None for number in range(50)]
    assert found == [True] * 49 + [False]
    journal.close()
