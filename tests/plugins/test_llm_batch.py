"""Batches: stages ask as ever, and the answers come from files, in this run or a later one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest
from envcraft_llm.endpoint import ModelChoice, OpenedModel, batch, batch_files, open_model
from envcraft_llm.model import Answer, Message, ModelFailure, ModelStopped, Request

from envcraft.errors import EnvCraftError
from tests.plugins.loopback import Loopback, says, status

SCHEMA = {"type": "object"}


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "unused")
    monkeypatch.setattr(batch, "QUIET", 0.05)
    monkeypatch.setattr(batch, "POLL", 0.02)


def request(text: str, **more: Any) -> Request:
    told: dict[str, Any] = {"model": "m", "stage": "code", "concept": text, **more}
    return Request(messages=(Message("user", text),), **told)


def completion(text: str) -> dict[str, Any]:
    choice = {"message": {"content": text}, "finish_reason": "stop"}
    return {"model": "m", "choices": [choice], "usage": {"prompt_tokens": 5, "completion_tokens": 2}}


Answering = Callable[[dict[str, Any]], dict[str, Any] | None]


def well(line: dict[str, Any]) -> dict[str, Any] | None:
    told = completion(f"to {line['body']['messages'][-1]['content']}")
    return {"custom_id": line["custom_id"], "response": {"status_code": 200, "body": told}, "error": None}


class Batches(Loopback):
    """An endpoint that has the Batch interface: each line is answered by `answering`, after so many `polls`."""

    def __init__(self, answering: Answering = well, polls: int = 2, ends: str = "completed") -> None:
        super().__init__(says("never asked"), files=self._files, batches=self._batches)
        self._answering, self._polls, self._ends = answering, polls, ends
        self.files: list[list[dict[str, Any]]] = []
        self.batches: list[dict[str, Any]] = []

    async def _files(self, writer: asyncio.StreamWriter, call: dict[str, Any]) -> None:
        if call["method"] == "POST":
            lines = [json.loads(line) for line in call["data"].splitlines() if line.startswith(b'{"custom_id"')]
            self.files.append(lines)
            told: Any = {"id": f"file-{len(self.files) - 1}", "object": "file"}
            await status(200, told)(writer, call)
            return
        found = filter(None, map(self._answering, self.files[int(call["path"].split("/")[1].split("-")[1])]))
        await status(200, "\n".join(json.dumps(line) for line in found))(writer, call)

    async def _batches(self, writer: asyncio.StreamWriter, call: dict[str, Any]) -> None:
        if call["method"] == "POST":
            told = json.loads(call["data"])
            self.batches.append({"id": str(len(self.batches)), "polls": 0, "status": "validating", **told})
            await status(200, self.batches[-1])(writer, call)
        elif call["path"].startswith("batches?"):
            # The newest first, in pages.
            query = parse_qs(call["path"].partition("?")[2])
            listed = self.batches[::-1]
            begin = 1 + [one["id"] for one in listed].index(query["after"][0]) if "after" in query else 0
            end = begin + int(query["limit"][0])
            page = {"object": "list", "data": listed[begin:end], "has_more": end < len(listed)}
            await status(200, page)(writer, call)
        else:
            found = self.batches[int(call["path"].split("/")[1])]
            found["polls"] += 1
            if found["polls"] > self._polls:
                found.update(status=self._ends, output_file_id=found["input_file_id"])
            await status(200, found)(writer, call)


async def outcomes(model: OpenedModel, requests: list[Request]) -> list[str]:
    async def one(asking: Request) -> str:
        try:
            return (await model.ask(asking)).text
        except ModelFailure as failure:
            return failure.kind

    return await asyncio.gather(*map(one, requests))


def run(server: Loopback, corpus: Path, *requests: Request, **more: Any) -> list[str]:
    async def using() -> list[str]:
        async with server:
            model = open_model(ModelChoice(base_url=server.url, batch=True, retries=1, **more), corpus)
            try:
                return await outcomes(model, list(requests))
            finally:
                await model.close()

    return asyncio.run(using())


def test_requests_are_collected_and_answered_together(tmp_path: Path) -> None:
    server = Batches()
    asked = [request(str(number), schema=SCHEMA if number else None) for number in range(5)]
    asked.append(request("other", model="small"))
    assert run(server, tmp_path, *asked) == ["to 0", "to 1", "to 2", "to 3", "to 4", "to other"]
    # One a model.
    assert sorted(len(lines) for lines in server.files) == [1, 5]
    line = next(lines for lines in server.files if len(lines) == 5)[1]
    assert line["custom_id"] == asked[1].key()
    assert (line["method"], line["url"]) == ("POST", "/v1/chat/completions")
    assert line["body"]["response_format"]["json_schema"]["schema"] == SCHEMA
    assert "stream" not in line["body"]
    assert not batch_files.outstanding(tmp_path / "batches")
    # Nothing is sent twice.
    assert run(server, tmp_path, *asked)[0] == "to 0"
    assert len(server.files) == 2


def test_what_a_line_tells_is_the_outcome_of_its_request(tmp_path: Path) -> None:
    def answering(line: dict[str, Any]) -> dict[str, Any] | None:
        text = line["body"]["messages"][-1]["content"]
        told: dict[str, Any] = {"custom_id": line["custom_id"], "error": None}
        if text == "long":
            return told | {"response": {"status_code": 400, "body": {"error": {"message": "maximum context length"}}}}
        if text == "empty":
            return told | {"response": {"status_code": 200, "body": completion("")}}
        if text == "lost":
            return told | {"response": None, "error": {"code": "batch_expired"}}
        if text == "odd":
            return told | {"response": {"status_code": 200, "body": "what?"}}
        if text == "hot" and "temperature" in line["body"]:
            return told | {"response": {"status_code": 400, "body": {"error": {"message": "temperature: unsupported"}}}}
        return well(line)

    requests = [request(text, temperature=0.5) for text in ("long", "empty", "lost", "odd", "hot", "good")]
    server = Batches(answering)
    found = run(server, tmp_path, *requests)
    assert found == ["context-overflow", "empty", "server-error", "garbage", "to hot", "to good"]
    assert [len(lines) for lines in server.files] == [6, 1]


def test_what_a_batch_leaves_out_is_asked_again_and_not_for_ever(tmp_path: Path) -> None:
    server = Batches(lambda line: well(line) if line["body"]["messages"][-1]["content"] != "never" else None)
    assert run(server, tmp_path, request("ok"), request("never")) == ["to ok", "server-error"]
    assert [len(lines) for lines in server.files] == [2, 1, 1]


@pytest.mark.parametrize("others", [0, 120])
def test_a_later_run_goes_on_with_a_batch_that_is_sent(tmp_path: Path, others: int) -> None:
    server = Batches(polls=1000)

    async def ended() -> None:
        async with server:
            model = open_model(ModelChoice(base_url=server.url, batch=True), tmp_path)
            asking = asyncio.create_task(model.ask(request("q")))
            while not server.batches or not server.batches[0]["polls"]:
                await asyncio.sleep(0.01)
            asking.cancel()
            await asyncio.wait_for(model.close(), 60)

    asyncio.run(ended())
    assert len(batch_files.outstanding(tmp_path / "batches")) == 1
    server._polls = 0
    for number in range(1, others + 1):
        server.batches.append({"id": str(number), "polls": 0, "status": "completed", "metadata": {}})
    assert run(server, tmp_path, request("q"), request("another")) == ["to q", "to another"]
    assert [len(lines) for lines in server.files] == [1, 1]
    assert len(server.batches) == 2 + others


def test_without_the_interface_the_files_are_answered_by_hand(tmp_path: Path) -> None:
    server = Loopback(says("never asked"))
    with pytest.raises(ModelStopped, match=r"takes no batches: have .*\.input\.jsonl answered elsewhere"):
        run(server, tmp_path, request("q"))
    (name,) = batch_files.outstanding(tmp_path / "batches")
    lines = [json.loads(line) for line in (tmp_path / "batches" / f"{name}.input.jsonl").read_text().splitlines()]
    told = "".join(json.dumps(well(line)) + "\n" for line in [*lines, {**lines[0], "custom_id": "of another"}])
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text(told)
    assert run(server, tmp_path, request("q")) == ["to q"]

    async def replayed() -> Answer:
        model = open_model(ModelChoice(), tmp_path, offline=True)
        return await model.ask(request("q"))

    assert asyncio.run(replayed()).text == "to q"


def test_a_batch_that_failed_and_a_file_that_is_none_stop_the_run(tmp_path: Path) -> None:
    server = Batches(lambda _: None, ends="failed")
    with pytest.raises(ModelStopped, match="ended as failed"):
        run(server, tmp_path, request("q"))
    (name,) = batch_files.outstanding(tmp_path / "batches")
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text("{}\n")
    with pytest.raises(ModelStopped, match=r"output\.jsonl, line 1"):
        run(server, tmp_path, request("q"))


@pytest.mark.parametrize(
    ("code", "message"), [(401, "no such key: sk-batch-0123456789"), (402, "pay"), (429, "insufficient_quota")]
)
def test_one_line_that_stops_the_run_loses_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, message: str
) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "sk-batch-0123456789")

    def answering(line: dict[str, Any]) -> dict[str, Any] | None:
        if line["body"]["messages"][-1]["content"] != "bad":
            return well(line)
        return {
            "custom_id": line["custom_id"],
            "response": {"status_code": code, "body": {"error": {"message": message}}},
        }

    asked = [request(text) for text in ("first", "bad", "last")]
    with pytest.raises(ModelStopped, match="the next run asks again") as stopped:
        run(Batches(answering), tmp_path, *asked)
    assert "sk-batch" not in str(stopped.value)
    assert not [path for path in (tmp_path / "batches").iterdir() if b"sk-batch" in path.read_bytes()]
    server = Batches()
    assert run(server, tmp_path, *asked) == ["to first", "to bad", "to last"]
    assert [len(lines) for lines in server.files] == [1]


def test_an_answer_keeps_the_word_that_stands_for_a_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "EMPTY")
    assert run(Batches(), tmp_path, request("EMPTY = 0")) == ["to EMPTY = 0"]


def test_a_line_that_is_none_loses_no_other(tmp_path: Path) -> None:
    asked = [request(text) for text in ("whole", "torn")]
    with pytest.raises(ModelStopped, match="takes no batches"):
        run(Loopback(says("never asked")), tmp_path, *asked)
    (name,) = batch_files.outstanding(tmp_path / "batches")
    lines = [json.loads(line) for line in (tmp_path / "batches" / f"{name}.input.jsonl").read_text().splitlines()]
    told = [json.dumps(well(line)) for line in lines]
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text(f"{told[0]}\n{told[1][:40]}")
    server = Batches()
    assert run(server, tmp_path, *asked) == ["to whole", "to torn"]
    assert [line["custom_id"] for lines in server.files for line in lines] == [asked[1].key()]


def test_whatever_goes_wrong_wakes_those_who_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def odd(*_: object) -> None:
        raise LookupError("not foreseen")

    monkeypatch.setattr(batch_files, "read_output", odd)

    async def using() -> None:
        async with Batches() as server:
            model = open_model(ModelChoice(base_url=server.url, batch=True), tmp_path)
            try:
                await asyncio.wait_for(model.ask(request("q")), 60)
            finally:
                await model.close()

    with pytest.raises(ModelStopped, match="LookupError: not foreseen"):
        asyncio.run(using())


def test_a_batch_whose_making_was_not_confirmed_is_not_made_twice(tmp_path: Path) -> None:
    class Dropping(Batches):
        async def _batches(self, writer: asyncio.StreamWriter, call: dict[str, Any]) -> None:
            if call["method"] == "POST" and not self.batches:
                told = json.loads(call["data"])
                self.batches.append({"id": "0", "polls": 0, "status": "validating", **told})
                writer.transport.abort()
                return
            await super()._batches(writer, call)

    server = Dropping()
    assert run(server, tmp_path, request("q")) == ["to q"]
    assert len(server.batches) == 1


def test_files_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_files, "REQUESTS", 4)
    requests = [request(f"{number}", sample=number) for number in range(10)]
    names = batch_files.write_batches(requests, tmp_path)
    assert sorted(len(batch_files.known(tmp_path, name)) for name in names) == [2, 4, 4]
    monkeypatch.setattr(batch_files, "BYTES", 400)
    assert len(batch_files.write_batches(requests, tmp_path / "small")) == 5
    (tmp_path / "file").touch()
    with pytest.raises(EnvCraftError, match="batches cannot be written to"):
        batch_files.write_batches(requests, tmp_path / "file")
