"""The Batch interface: requests become batches, and their results arrive in this run or a later one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

import pytest
from envcraft_llm.endpoint import JournaledModel, ModelSettings, batch, batch_files, open_model
from envcraft_llm.model import Completion, Message, ModelUnavailable, Request, RequestFailed

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
    """An endpoint with the Batch interface: `answering` answers each line, after `polls` polls."""

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


async def outcomes(model: JournaledModel, requests: list[Request]) -> list[str]:
    async def one(asking: Request) -> str:
        try:
            return (await model.generate(asking)).text
        except RequestFailed as failure:
            return failure.kind

    return await asyncio.gather(*map(one, requests))


def run(server: Loopback, corpus: Path, *requests: Request, **more: Any) -> list[str]:
    async def using() -> list[str]:
        async with server:
            model = open_model(ModelSettings(base_url=server.url, batch=True, retries=1, **more), corpus)
            try:
                return await outcomes(model, list(requests))
            finally:
                await model.close()

    return asyncio.run(using())


def test_requests_are_collected_into_one_batch(tmp_path: Path) -> None:
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


def test_output_lines_are_results(tmp_path: Path) -> None:
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


def test_requests_without_a_result_are_sent_again_a_few_times(tmp_path: Path) -> None:
    server = Batches(lambda line: well(line) if line["body"]["messages"][-1]["content"] != "never" else None)
    assert run(server, tmp_path, request("ok"), request("never")) == ["to ok", "server-error"]
    assert [len(lines) for lines in server.files] == [2, 1, 1]


@pytest.mark.parametrize("others", [0, 120])
def test_a_later_run_continues_a_batch(tmp_path: Path, others: int) -> None:
    server = Batches(polls=1000)

    async def ended() -> None:
        async with server:
            model = open_model(ModelSettings(base_url=server.url, batch=True), tmp_path)
            asking = asyncio.create_task(model.generate(request("q")))
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


def test_an_endpoint_without_the_interface_leaves_the_input_file(tmp_path: Path) -> None:
    server = Loopback(says("never asked"))
    with pytest.raises(ModelUnavailable, match=r"has no Batch interface: have .*\.input\.jsonl processed elsewhere"):
        run(server, tmp_path, request("q"))
    (name,) = batch_files.outstanding(tmp_path / "batches")
    lines = [json.loads(line) for line in (tmp_path / "batches" / f"{name}.input.jsonl").read_text().splitlines()]
    told = "".join(json.dumps(well(line)) + "\n" for line in [*lines, {**lines[0], "custom_id": "of another"}])
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text(told)
    assert run(server, tmp_path, request("q")) == ["to q"]

    async def replayed() -> Completion:
        model = open_model(ModelSettings(), tmp_path, offline=True)
        return await model.generate(request("q"))

    assert asyncio.run(replayed()).text == "to q"


def test_a_failed_batch_and_an_invalid_output_file_stop_the_run(tmp_path: Path) -> None:
    server = Batches(lambda _: None, ends="failed")
    with pytest.raises(ModelUnavailable, match="ended as failed"):
        run(server, tmp_path, request("q"))
    (name,) = batch_files.outstanding(tmp_path / "batches")
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text("{}\n")
    with pytest.raises(ModelUnavailable, match=r"output\.jsonl, line 1"):
        run(server, tmp_path, request("q"))


@pytest.mark.parametrize(
    ("code", "message"), [(401, "no such key: sk-batch-0123456789"), (402, "pay"), (429, "insufficient_quota")]
)
def test_a_line_that_stops_the_run_loses_no_other_result(
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
    with pytest.raises(ModelUnavailable, match="the next run sends the remaining requests again") as stopped:
        run(Batches(answering), tmp_path, *asked)
    assert "sk-batch" not in str(stopped.value)
    assert not [path for path in (tmp_path / "batches").iterdir() if b"sk-batch" in path.read_bytes()]
    server = Batches()
    assert run(server, tmp_path, *asked) == ["to first", "to bad", "to last"]
    assert [len(lines) for lines in server.files] == [1]


def test_completions_keep_a_placeholder_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "EMPTY")
    assert run(Batches(), tmp_path, request("EMPTY = 0")) == ["to EMPTY = 0"]


def test_a_malformed_line_loses_no_other_result(tmp_path: Path) -> None:
    asked = [request(text) for text in ("whole", "torn")]
    with pytest.raises(ModelUnavailable, match="has no Batch interface"):
        run(Loopback(says("never asked")), tmp_path, *asked)
    (name,) = batch_files.outstanding(tmp_path / "batches")
    lines = [json.loads(line) for line in (tmp_path / "batches" / f"{name}.input.jsonl").read_text().splitlines()]
    told = [json.dumps(well(line)) for line in lines]
    (tmp_path / "batches" / f"{name}.output.jsonl").write_text(f"{told[0]}\n{told[1][:40]}")
    server = Batches()
    assert run(server, tmp_path, *asked) == ["to whole", "to torn"]
    assert [line["custom_id"] for lines in server.files for line in lines] == [asked[1].key()]


def test_any_exception_wakes_the_callers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def odd(*_: object) -> None:
        raise LookupError("not foreseen")

    monkeypatch.setattr(batch_files, "read_output", odd)

    async def using() -> None:
        async with Batches() as server:
            model = open_model(ModelSettings(base_url=server.url, batch=True), tmp_path)
            try:
                await asyncio.wait_for(model.generate(request("q")), 60)
            finally:
                await model.close()

    with pytest.raises(ModelUnavailable, match="LookupError: not foreseen"):
        asyncio.run(using())


def test_a_batch_with_a_lost_response_is_created_once(tmp_path: Path) -> None:
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


def test_input_files_respect_the_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_files, "MAX_REQUESTS", 4)
    requests = [request(f"{number}", sample=number) for number in range(10)]
    names = batch_files.write_batches(requests, tmp_path)
    assert sorted(len(batch_files.load_requests(tmp_path, name)) for name in names) == [2, 4, 4]
    monkeypatch.setattr(batch_files, "MAX_BYTES", 400)
    assert len(batch_files.write_batches(requests, tmp_path / "small")) == 5
    (tmp_path / "file").touch()
    with pytest.raises(EnvCraftError, match="batches cannot be written to"):
        batch_files.write_batches(requests, tmp_path / "file")
