"""A real server: llama.cpp's, with a model of random weights. What it answers is garbage, in the right form."""

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
from envcraft_llm.endpoint import ModelChoice, OpenedModel, open_model
from envcraft_llm.endpoint.journal import Failed, Journal
from envcraft_llm.model import Answer, Message, ModelFailure, ModelStopped, Request
from envcraft_llm.stages import briefs

from envcraft.cli import cli
from envcraft.corpus.history import History
from envcraft.corpus.store import Store
from tests.plugins import tiny_model
from tests.plugins.generation.content import GAME, write

pytest.importorskip("xllamacpp", reason="needs the wheel xllamacpp, which is not for every machine")

SCHEMA = {
    "type": "object",
    "properties": {"viable": {"type": "boolean"}, "kind": {"enum": ["a", "b"]}},
    "required": ["viable", "kind"],
}


class Served:
    """The server at its port."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "tiny.gguf"
        tiny_model.write(self._path)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/v1"
        self._log = (folder / "server.log").open("w")
        self.start()

    def start(self) -> None:
        """Start, and return once it listens."""
        command = [sys.executable, "-m", "tests.plugins.tiny_model", str(self._path), str(self.port)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self._log, text=True)
        assert self._process.stdout is not None
        assert str(self.port) in self._process.stdout.readline()

    def kill(self) -> None:
        """End at once, if it still runs."""
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


def using(served: Served, journal: Path, use: Callable[[OpenedModel], Awaitable[Any]], **more: Any) -> Any:
    async def run() -> Any:
        model = open_model(ModelChoice(base_url=served.url, **more), journal)
        try:
            return await use(model)
        finally:
            await model.close()

    return asyncio.run(run())


def test_answers_are_streamed_and_counted_many_at_once(served: Served, tmp_path: Path) -> None:
    async def use(model: OpenedModel) -> None:
        same = [model.ask(request("a game", sample=number % 6)) for number in range(12)]
        answers = await asyncio.gather(*same, return_exceptions=True)
        assert not [told for told in answers if isinstance(told, BaseException) and not isinstance(told, ModelFailure)]
        texts = {told.text for told in answers if not isinstance(told, BaseException)}
        assert len(texts) >= 4
        usage = model.accounts.of("code")
        assert usage.asked == 6
        assert usage.prompt_tokens > 6 * 10
        assert 0 < usage.completion_tokens <= 6 * 24
        long = await model.ask(request("a game", sample=99, max_tokens=8))
        assert long.finish == "length"

    using(served, tmp_path, use)


def test_a_schema_is_held_to(served: Served, tmp_path: Path) -> None:
    async def use(model: OpenedModel) -> None:
        answer = await model.ask(request("is it viable?", schema=SCHEMA, max_tokens=400))
        told = json.loads(answer.text)
        assert told.keys() == {"viable", "kind"}
        assert told["kind"] in "ab"

    using(served, tmp_path, use)


def test_a_prompt_that_is_too_long_overflows(served: Served, tmp_path: Path) -> None:
    async def use(model: OpenedModel) -> None:
        with pytest.raises(ModelFailure, match="HTTP 400") as failed:
            await model.ask(request("long " * 4000))
        assert failed.value.kind == "context-overflow"

    using(served, tmp_path, use)


def test_the_pipeline_counts_every_concept_that_such_a_model_fails(served: Served, tmp_path: Path) -> None:
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
    """Templates so short that all requests fit into the tiny model's context, and are answered; each is sent once."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft.llm]\nretries = 0\n")
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
        kept = [journal.find(key, passing=True) for (key,) in keys]
    # All of it was answered: it is the answers that are no good.
    assert len(kept) >= 3
    assert all(
        isinstance(one, Answer) or (isinstance(one, Failed) and one.kind in ("garbage", "empty")) for one in kept
    )


def test_a_server_that_is_killed_and_started_again_answers_the_rest(served: Served, tmp_path: Path) -> None:
    requests = [request(f"game {number}", max_tokens=200) for number in range(12)]

    async def outcomes(model: OpenedModel) -> list[str]:
        async def one(asking: Request) -> str:
            try:
                return (await model.ask(asking)).text
            except ModelFailure as failure:
                return failure.kind

        return await asyncio.gather(*map(one, requests))

    async def use(model: OpenedModel) -> list[str]:
        asking = asyncio.create_task(outcomes(model))
        while not model.accounts.of("code").completion_tokens:
            await asyncio.sleep(0.02)
        await asyncio.to_thread(served.kill)
        await asyncio.to_thread(served.start)
        told = await asking
        assert model.accounts.of("code").retries > 0
        return told

    first = using(served, tmp_path, use, retries=30)
    served.kill()

    async def replayed() -> list[str]:
        model = open_model(ModelChoice(), tmp_path, offline=True)
        told = await outcomes(model)
        with pytest.raises(ModelStopped):
            await model.ask(request("a game that was never asked for"))
        await model.close()
        return told

    assert asyncio.run(replayed()) == first
    assert len(set(first)) > 6
