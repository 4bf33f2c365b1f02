"""A real server: llama.cpp with a model of random weights, whose completions are well-formed garbage."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from envcraft_llm import templates
from envcraft_llm.endpoint import JournaledModel, ModelSettings, open_model
from envcraft_llm.endpoint.journal import Failure, Journal
from envcraft_llm.model import Completion, Message, ModelUnavailable, Request, RequestFailed
from envcraft_llm.stages import briefs

from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.generation.history import History
from tests.plugins import tiny_model
from tests.plugins.generation.content import GAME, write

pytest.importorskip("xllamacpp", reason="needs the wheel xllamacpp, which is not for every machine")

SCHEMA = {
    "type": "object",
    "properties": {"viable": {"type": "boolean"}, "kind": {"enum": ["a", "b"]}},
    "required": ["viable", "kind"],
}


class Served:
    """The server process."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "tiny.gguf"
        tiny_model.write(self._path)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/v1"
        self._log = (folder / "server.log").open("w")
        self.start()

    def start(self) -> None:
        """Start the server, and return once it listens."""
        command = [sys.executable, "-m", "tests.plugins.tiny_model", str(self._path), str(self.port)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self._log, text=True)
        assert self._process.stdout is not None
        assert str(self.port) in self._process.stdout.readline()

    def kill(self) -> None:
        """Kill the server."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    server = Served(tmp_path_factory.mktemp("tiny"))
    yield server
    server.kill()


def request(text: str, **more: Any) -> Request:
    told: dict[str, Any] = {"max_tokens": 24, "temperature": 1.0, "stage": "code", **more}
    return Request("tiny", (Message("system", "Write."), Message("user", text)), **told)


def using(served: Served, journal: Path, use: Callable[[JournaledModel], Awaitable[Any]], **more: Any) -> Any:
    async def run() -> Any:
        model = open_model(ModelSettings(base_url=served.url, **more), journal)
        try:
            return await use(model)
        finally:
            await model.close()

    return asyncio.run(run())


def test_concurrent_completions_are_counted(served: Served, tmp_path: Path) -> None:
    async def use(model: JournaledModel) -> None:
        same = [model.generate(request("a game", sample=number % 6)) for number in range(12)]
        answers = await asyncio.gather(*same, return_exceptions=True)
        assert not [told for told in answers if isinstance(told, BaseException) and not isinstance(told, RequestFailed)]
        texts = {told.text for told in answers if not isinstance(told, BaseException)}
        assert len(texts) >= 4
        usage = model.usage.of("code")
        assert usage.attempts == 6
        assert usage.prompt_tokens > 6 * 10
        assert 0 < usage.completion_tokens <= 6 * 24
        long = await model.generate(request("a game", sample=99, max_tokens=8))
        assert long.finish == "length"

    using(served, tmp_path, use)


def test_completions_follow_the_schema(served: Served, tmp_path: Path) -> None:
    async def use(model: JournaledModel) -> None:
        answer = await model.generate(request("is it viable?", schema=SCHEMA, max_tokens=400))
        told = json.loads(answer.text)
        assert told.keys() == {"viable", "kind"}
        assert told["kind"] in "ab"

    using(served, tmp_path, use)


def test_a_long_prompt_overflows_the_context(served: Served, tmp_path: Path) -> None:
    async def use(model: JournaledModel) -> None:
        with pytest.raises(RequestFailed, match="HTTP 400") as failed:
            await model.generate(request("long " * 4000))
        assert failed.value.kind == "context-overflow"

    using(served, tmp_path, use)


def test_the_pipeline_counts_failed_concepts(served: Served, tmp_path: Path) -> None:
    given = ["generate", "--concepts", "2", "--until", "code", "--corpus", str(tmp_path / "corpus")]
    result = CliRunner().invoke(cli, [*given, "--base-url", served.url, "--model", "tiny", "--sandbox", "process"])
    assert result.exit_code == 1, result.output
    with sqlite3.connect(tmp_path / "corpus" / "corpus.sqlite") as db:
        said = db.execute("SELECT stage, result, reason FROM outcomes WHERE stage != 'concepts'").fetchall()
    assert [one[:2] for one in said] == [("briefs", "failed")] * 2
    assert all(reason.startswith("context-overflow: ") for _, _, reason in said)
    assert "| briefs | 2 | 0 | 0 | 2 |" in result.stdout


@pytest.fixture
def short_prompts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Shorten the prompts to fit the tiny model's context, and retry once: a busy server may drop a connection."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft.llm]\nretries = 1\n")
    folder = tmp_path / "prompts"
    folder.mkdir()
    for stage in ("briefs", "viability", "code"):
        parts = {"System": f"Write {stage}.", "User": "{{%s}}" % ("title" if stage == "briefs" else "brief")}
        parts |= {"Again": "Again.", "Continue": "Go on."}
        (folder / f"{stage}.md").write_text("\n".join(f"# {name}\n\n{text}\n" for name, text in parts.items()))
    monkeypatch.setattr(templates, "FOLDER", folder)
    templates.prompt.cache_clear()
    yield
    templates.prompt.cache_clear()


@pytest.mark.usefixtures("short_prompts")
@pytest.mark.parametrize(
    ("first", "reasons"),
    [
        ("briefs", r"no brief: .+"),
        # What the grammar does not keep the model from: a server finds fault with what its limit cuts off.
        ("viability", r"garbage: HTTP 500: .+|no verdict: .+|[a-z]+-[a-z-]+: .+|no code: .+"),
        ("code", r"no code: nothing in the answer looks like an environment; it begins ['\"].+"),
    ],
)
def test_garbage_ends_every_concept_with_its_reason(served: Served, tmp_path: Path, first: str, reasons: str) -> None:
    content, corpus = tmp_path / "content", tmp_path / "corpus"
    for number in range(3):
        write(content, number, brief=f"Short brief {number}.", attempt_0=GAME)
    given = ["generate", "--concepts", "3", "--corpus", str(corpus), "--sandbox", "process", "--until"]
    if first != "briefs":
        before = "briefs" if first == "viability" else "viability"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(briefs, "complaints", lambda text: [])
            ended = CliRunner().invoke(cli, [*given, before, "--model", f"demo:{content}"])
        assert ended.exit_code == 0, ended.output
    # Concepts come before briefs, and are nobody's answers.
    begun = ["--from", first if first != "briefs" else "concepts"]
    result = CliRunner().invoke(cli, [*given, "code", *begun, "--base-url", served.url, "--model", "tiny"])
    assert result.exit_code == 1, result.output
    with Store(corpus) as store:
        history = History(store)
        said = [list(history.outcomes(concept).values()) for concept in history.concepts()]
    last = [next(one for one in outcomes if one.result != "passed") for outcomes in said]
    assert len(last) == 3
    # One answer in some hundred is none: its first character is the last.
    reasons += r"|empty: .+"
    assert [one.reason for one in last if not re.fullmatch(reasons, one.reason, re.DOTALL)] == []
    with contextlib.closing(Journal(corpus, write=False)) as journal:
        keys = sqlite3.connect(journal.path).execute("SELECT key FROM answers")
        kept = [journal.get(key, transient=True) for (key,) in keys]
    # All of it was answered: it is the answers that are no good.
    assert len(kept) >= 3
    assert all(
        isinstance(one, Completion) or (isinstance(one, Failure) and one.kind in ("garbage", "empty")) for one in kept
    )


def test_requests_survive_a_restart_of_the_server(served: Served, tmp_path: Path) -> None:
    requests = [request(f"game {number}", max_tokens=200) for number in range(12)]

    async def outcomes(model: JournaledModel) -> list[str]:
        async def one(asking: Request) -> str:
            try:
                return (await model.generate(asking)).text
            except RequestFailed as failure:
                return failure.kind

        return await asyncio.gather(*map(one, requests))

    async def use(model: JournaledModel) -> list[str]:
        asking = asyncio.create_task(outcomes(model))
        while not model.usage.of("code").completion_tokens:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(served.kill)
        await asyncio.to_thread(served.start)
        told = await asking
        assert model.usage.of("code").retries > 0
        return told

    first = using(served, tmp_path, use, retries=30)
    served.kill()

    async def replayed() -> list[str]:
        model = open_model(ModelSettings(), tmp_path, offline=True)
        told = await outcomes(model)
        with pytest.raises(ModelUnavailable):
            await model.generate(request("a game that was never asked for"))
        await model.close()
        return told

    assert asyncio.run(replayed()) == first
    assert len(set(first)) > 6
