"""The whole pipeline on a small demo: killed, interrupted, resumed, in parts, and with useless models."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result
from envcraft_llm.endpoint import ModelSettings
from envcraft_llm.findings import finding_lines, findings
from envcraft_llm.model import Completion, Message, Model, ModelUnavailable, Request, RequestFailed
from envcraft_llm.pipeline import options

from envcraft.cli.group import cli
from envcraft.corpus.merge import merge
from envcraft.corpus.store import Store, decode
from envcraft.corpus.verify import verify
from envcraft.errors import EnvCraftError
from envcraft.generation.history import History
from envcraft.judging.selection import driver_named
from envcraft.judging.settings import Settings
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport, plain
from tests.killing import TIMES, Killed

from .content import CONCEPTS, GAME, IDLE, POLICY, UNSEEDED, elaboration, small, verdict, write

Generate = Callable[..., Result]
#: What a corpus holds that is not the clock's.
TABLES = {
    "concepts": "SELECT * FROM concepts ORDER BY id",
    "briefs": "SELECT * FROM briefs ORDER BY concept",
    "attempts": "SELECT concept, number, source, class, diff, result, gutted, codes, profile, provenance FROM attempts "
    "ORDER BY concept, number",
    "policies": "SELECT * FROM policies ORDER BY concept, number",
    "outcomes": "SELECT * FROM outcomes ORDER BY concept, stage",
    "environments": "SELECT name, source, class, origin FROM environments ORDER BY name",
    "verdicts": "SELECT source, class, verdict, steps FROM verdicts ORDER BY source, class",
}


def command(folder: Path, corpus: Path, *more: str) -> list[str]:
    given = ["--model", f"demo:{folder}", "--corpus", str(corpus), "--sandbox", "process", "--workers", "2", *more]
    return ["generate", *given]


@pytest.fixture
def generate(tmp_path: Path) -> Generate:
    folder = small(tmp_path / "content")

    def run(*more: str, corpus: str = "corpus", content: Path = folder) -> Result:
        return CliRunner().invoke(cli, command(content, tmp_path / corpus, *more))

    return run


def contents(corpus: Path) -> dict[str, list[Any]]:
    with sqlite3.connect(corpus / "corpus.sqlite") as db:
        return {name: db.execute(query).fetchall() for name, query in TABLES.items()}


def requests(corpus: Path) -> set[str]:
    """Return the keys of all requests in the provenance of the corpus."""
    found = set()
    for table in ("briefs", "attempts", "policies"):
        with sqlite3.connect(corpus / "corpus.sqlite") as db:
            found |= {json.loads(text).get("request") for (text,) in db.execute(f"SELECT provenance FROM {table}")}
    return found


def outcomes(corpus: Path) -> dict[tuple[str, str], tuple[str, str]]:
    return {(concept, stage): (result, reason) for concept, stage, result, reason, _ in contents(corpus)["outcomes"]}


@dataclass(frozen=True)
class Finished:
    """Recorded answers, the corpus of one uninterrupted run, its result and its duration."""

    content: Path
    corpus: Path
    result: Result
    seconds: float


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("finished")
    content = small(folder / "content")
    began = time.monotonic()
    result = CliRunner().invoke(cli, command(content, folder / "corpus"))
    return Finished(content, folder / "corpus", result, time.monotonic() - began)


def test_concepts_become_environments(finished: Finished) -> None:
    corpus, result = finished.corpus, finished.result
    assert result.exit_code == 0, result.output
    second, third = (concept.id for concept in CONCEPTS[1:3])
    said = outcomes(corpus)
    assert said[second, "validated"] == ("passed", "")
    assert said[third, "viability"] == ("rejected", "impossible-physics: An errand.")
    assert (third, "code") not in said
    kept = contents(corpus)
    assert [(row[0], row[1], row[5]) for row in kept["attempts"] if row[0] == second] == [
        (second, 0, "faulty"),
        (second, 1, "sound"),
    ]
    assert "EC204" in next(row[7] for row in kept["attempts"] if row[:2] == (second, 0))
    assert [row[3] > 0 for row in kept["policies"] if row[0] == second] == [False, True]
    assert len(kept["environments"]) == 1


def test_the_table_counts_the_outcomes(finished: Finished) -> None:
    lines = finished.result.stdout.splitlines()
    assert "| briefs | 3 | 3 | 0 | 0 | 100.0% (43.9% to 100.0%) |  |" in lines
    assert "| viability | 3 | 2 | 1 | 0 | 66.7% (20.8% to 93.9%) | impossible-physics 1 |" in lines
    assert "| repair | 2 | 1 | 1 | 0 | 50.0% (9.5% to 90.5%) | unfixable 1 |" in lines
    assert "| all | 3 | 1 | | | 33.3% (6.1% to 79.2%) | |" in lines
    assert "  first: 0 of 2 (0.0%) without a finding" in lines
    assert "  repair 1: 1 of 2 (50.0%) without a finding" in lines


def test_corpus_show_prints_the_history(finished: Finished) -> None:
    corpus = finished.corpus
    name = next(row[0] for row in contents(corpus)["environments"] if CONCEPTS[1].id[:8] in row[0])
    told = CliRunner().invoke(cli, ["corpus", "show", str(corpus), name]).output
    assert f"concept {CONCEPTS[1].id}: {CONCEPTS[1].title}" in told
    assert "attempt 0  fail" in told
    assert "EC204" in told
    assert "attempt 1  pass" in told
    shown = json.loads(CliRunner().invoke(cli, ["corpus", "show", str(corpus), name, "--format", "json"]).output)
    assert shown["history"]["attempts"][1]["diff"].startswith("--- attempt 0")
    assert set(shown["history"]["attempts"][1]["provenance"]) == {"model", "request", "prompt"}
    assert shown["verdict"] == "pass"


def test_a_history_is_merged_and_verified(finished: Finished, tmp_path: Path) -> None:
    corpus = finished.corpus
    with Store.create(tmp_path / "other") as other, Store(corpus) as source:
        taken = merge(other, source)
        assert (taken.added, taken.concepts) == (1, 3)
        again = merge(other, source)
        assert (again.added, again.verdicts, again.concepts) == (0, 0, 0)
        assert [*verify(other)] == []
        query = "SELECT source FROM attempts WHERE result = 'faulty' AND concept = ?"
        attempt = other.db.execute(query, (CONCEPTS[1].id,)).fetchone()[0]
        other.place(attempt).unlink()
        assert [damage.what for damage in verify(other)] == [
            f"the source of attempt 0 at the concept {CONCEPTS[1].id} is missing"
        ]
        assert all(damage.done for damage in verify(other, repair=True))
        assert [*verify(other)] == []
    # But for the attempt that was damaged.
    assert contents(tmp_path / "other")["outcomes"] == contents(corpus)["outcomes"]


def test_a_verdict_under_other_settings_is_ignored(finished: Finished, tmp_path: Path) -> None:
    with Store.create(tmp_path / "copy") as store, Store(finished.corpus) as source:
        merge(store, source)
        row = store.db.execute(
            "SELECT contract, contract_sha256, rules, seed, budget, driver, image, checks, offered FROM settings"
        ).fetchone()
        same = Settings(*row)
        state = History(store, same).state(CONCEPTS[1].id)
        assert state is not None
        assert [attempt.report is None for attempt in state.attempts] == [False, False]
        stricter = History(store, msgspec.structs.replace(same, seed=same.seed + 1))
        again = stricter.state(CONCEPTS[1].id)
        assert again is not None
        assert [(attempt.report, attempt.profile) for attempt in again.attempts] == [(None, {}), (None, {})]
        assert stricter.judged(again.attempts[1], again) is None
        # Who only reads is told of all.
        read = History(store).state(CONCEPTS[1].id)
        assert read is not None
        assert all(attempt.report for attempt in read.attempts)


def test_a_restarted_repair_drops_later_attempts(finished: Finished, tmp_path: Path) -> None:
    with Store.create(tmp_path / "copy") as store, Store(finished.corpus) as source:
        merge(store, source)
        history = History(store)
        state = history.state(CONCEPTS[1].id)
        assert state is not None
        history.drop_attempts(state, 1)
        left = history.state(CONCEPTS[1].id)
        assert left is not None
        assert [attempt.number for attempt in left.attempts] == [0]


def test_a_second_run_does_nothing(finished: Finished) -> None:
    content, corpus, first = finished.content, finished.corpus, finished.result
    before = contents(corpus)
    again = CliRunner().invoke(cli, command(content, corpus))
    assert again.stdout == first.stdout
    assert contents(corpus) == before


def test_a_run_killed_at_any_moment_resumes_to_the_same_corpus(finished: Finished, tmp_path: Path) -> None:
    content, whole = finished.content, finished.corpus
    corpus, kept = tmp_path / "corpus", list[int]()
    program = [sys.executable, "-m", "envcraft", *command(content, corpus)]
    killed = Killed(
        lambda: subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True),
        lambda pid: (corpus / "lock").is_file() and (corpus / "lock").read_text() == str(pid),
        finished.seconds / 4,
        lambda: kept.append(_kept(corpus)),
    )
    killed.run()
    print("kept after each kill:", *kept, killed.moments)
    # What was kept stays kept.
    assert kept == sorted(kept)
    assert killed.moments.total() == TIMES
    last = subprocess.run(program, capture_output=True, text=True, timeout=900)
    assert last.returncode == 0, last.stderr
    # The last line names the corpus.
    assert last.stdout.replace(str(corpus), str(whole)) == finished.result.stdout
    assert contents(corpus) == contents(whole)
    assert requests(corpus) == requests(whole)


def _kept(corpus: Path) -> int:
    """Count briefs, policies and outcomes of a corpus that may not exist yet."""
    try:
        return sum(len(contents(corpus)[table]) for table in ("briefs", "policies", "outcomes"))
    except sqlite3.Error:
        return 0


def test_an_interrupted_run_ends_cleanly_and_resumes(finished: Finished, tmp_path: Path) -> None:
    content, whole = finished.content, finished.corpus
    program = [sys.executable, "-m", "envcraft", *command(content, tmp_path / "corpus")]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        deadline = time.monotonic() + 240
        while time.monotonic() < deadline and not _has_verdicts(tmp_path / "corpus"):
            time.sleep(0.05)
        run.send_signal(signal.SIGINT)
        _, said = run.communicate(timeout=480)
    assert run.returncode == 130, said
    assert "run the same command again to continue" in said
    assert "Traceback" not in said
    assert CliRunner().invoke(cli, command(content, tmp_path / "corpus")).exit_code == 0
    assert contents(tmp_path / "corpus") == contents(whole)


def _has_verdicts(corpus: Path) -> bool:
    """Whether the corpus has a first verdict."""
    if not (corpus / "corpus.sqlite").exists():
        # Or looking would make one.
        return False
    try:
        return any(row[1] == "code" for row in contents(corpus)["outcomes"])
    except sqlite3.Error:
        return False


def test_from_and_until(generate: Generate, tmp_path: Path) -> None:
    first = generate("--until", "viability")
    assert first.exit_code == 0, first.output
    assert {stage for _, stage in outcomes(tmp_path / "corpus")} == {"concepts", "briefs", "viability"}
    assert generate("--from", "code", "--until", "code").exit_code == 0
    assert len(contents(tmp_path / "corpus")["attempts"]) == 2
    # What has not come so far is not taken further.
    assert generate("--from", "repair", "--until", "code", corpus="other").exit_code == 2
    assert generate("--from", "validated", corpus="other").exit_code == 1
    assert outcomes(tmp_path / "other") == {}


def test_an_optional_stage_runs_if_named(generate: Generate, tmp_path: Path) -> None:
    for number in (1, 2):
        made = next((tmp_path / "content").glob(f"{number:02}_*"))
        numbers = " ".join(re.findall(r"\d+(?:\.\d+)?", CONCEPTS[number].text))
        (made / "elaboration.md").write_text(elaboration(numbers) if number == 1 else "Nothing.")
    assert generate("--with", "elaboration", "--until", "viability").exit_code == 0
    said = outcomes(tmp_path / "corpus")
    first, second = (concept.id for concept in CONCEPTS[1:3])
    assert (said[first, "elaboration"][0], said[first, "viability"][0]) == ("passed", "passed")
    assert said[second, "elaboration"][1].startswith("no elaboration: There is no part")
    assert (second, "briefs") not in said
    plain = generate("--until", "viability", corpus="plain")
    assert "elaboration" not in plain.stdout
    # The same brief, asked for otherwise.
    assert len(requests(tmp_path / "corpus") - requests(tmp_path / "plain")) == 1
    with Store(tmp_path / "corpus") as store:
        assert "Objects: the guard walks" in History(store).outcomes(first)["elaboration"].facts["text"]
    # It comes too late where there is a brief, and is none of what has come to its end.
    late = generate("--until", "elaboration", corpus="plain")
    assert (late.exit_code, "| elaboration | 2 | 2 | 0 | 0 |" in late.stdout) == (0, True), late.output


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--until", "repare"], "did you mean repair?"),
        (["--with", "elaborating"], "there is no stage 'elaborating'; did you mean"),
        (["--seed", "3"], "concepts of seed 0 only"),
        (["--family", "tetris"], "--family cannot be used with --model"),
        (["--output", "files"], "--output cannot be used with --model"),
        (["--sandbox", "nothing"], "there is no sandbox"),
    ],
)
def test_usage_errors(generate: Generate, more: list[str], words: str) -> None:
    result = generate(*more)
    assert result.exit_code == 2
    assert words in result.output


def test_pipeline_options_do_not_go_with_a_family() -> None:
    result = CliRunner().invoke(cli, ["generate", "--family", "tetris", "--until", "code"])
    assert result.exit_code == 2
    assert "--until needs one of" in result.output


class _Model(Model):
    """Replies with the same answer to every request, or raises it."""

    def __init__(self, answer: str | Exception, accept: int = 10**9) -> None:
        self.answer, self.accept, self.requests = answer, accept, list[Request]()

    async def generate(self, request: Request) -> Completion:
        self.requests.append(request)
        if isinstance(self.answer, Exception) and len(self.requests) > self.accept:
            raise self.answer
        return Completion(verdict() if isinstance(self.answer, Exception) else self.answer, prompt_tokens=3)


def told(monkeypatch: pytest.MonkeyPatch, model: Model, corpus: Path, *more: str) -> Result:
    monkeypatch.setattr("envcraft_llm.pipeline.command.create_model", lambda *_: (model, None))
    given = ["--concepts", "20", "--corpus", str(corpus), "--sandbox", "process", "--base-url", "http://none", *more]
    return CliRunner().invoke(cli, ["generate", *given])


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ("", "no brief"),
        ("\x00\ufffd{}[]<|channel|>```" * 50, "no brief"),
        (GAME, "no brief"),
        (RequestFailed("refused", "I cannot help with that"), "refused"),
        (RequestFailed("context-overflow", "too long"), "context-overflow"),
        (ValueError("not foreseen"), "the stage broke"),
        (FileNotFoundError(2, "No such file", "a list of its own"), "the stage broke"),
        (EnvCraftError("a sentence of the stage"), "the stage broke"),
    ],
    ids=["nothing", "garbage", "a game for a brief", "refused", "overflow", "breaks", "a file", "a sentence"],
)
def test_a_useless_model_fails_every_concept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, answer: str | Exception, reason: str
) -> None:
    result = told(monkeypatch, _Model(answer, 0), tmp_path / "corpus")
    assert result.exit_code == 1, result.output
    said = [(stage, found, why.partition(":")[0]) for (_, stage), (found, why) in outcomes(tmp_path / "corpus").items()]
    assert [one for one in said if one[0] != "concepts"] == [("briefs", "failed", reason)] * 20
    assert f"| briefs | 20 | 0 | 0 | 20 | 0.0% (0.0% to 16.1%) | {reason} 20 |" in result.stdout


def test_an_unavailable_model_ends_the_run_without_failures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stopped = ModelUnavailable("the endpoint is down: start it")
    result = told(monkeypatch, _Model(stopped, 1), tmp_path / "corpus")
    assert result.exit_code == 3
    assert "the endpoint is down: start it" in result.output
    assert not [said for said in outcomes(tmp_path / "corpus").values() if said[0] == "failed"]


def test_a_corpus_that_cannot_be_written_ends_the_run(generate: Generate, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Store, "put", full)
    result = generate()
    assert result.exit_code == 3
    assert "the corpus cannot be written: No space left on device" in result.output


def test_transient_failures_are_retried_by_the_next_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    first, second = (_Model(RequestFailed("timeout", "too late"), 0), _Model("nothing"))
    assert told(monkeypatch, first, tmp_path / "corpus").exit_code == 1
    assert told(monkeypatch, second, tmp_path / "corpus").exit_code == 1
    assert len(first.requests) == 20
    assert len(second.requests) == 40
    third = _Model("nothing")
    assert told(monkeypatch, third, tmp_path / "corpus").exit_code == 1
    assert not third.requests


def test_generated_code_needs_a_sandbox(monkeypatch: pytest.MonkeyPatch) -> None:
    from envcraft.errors import SandboxUnavailable

    asked = []

    def none(name: str, least: str | None = None, runtime: str | None = None) -> None:
        asked.append((name, least))
        raise SandboxUnavailable("the strongest sandbox here is process")

    monkeypatch.setattr(options, "driver_named", none)
    with pytest.raises(SandboxUnavailable, match="--sandbox process runs it"):
        options.driver_for_generated("auto", None, None)
    assert asked == [("auto", "namespace")]


def test_a_repair_of_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "game.py"
    file.write_text(UNSEEDED)
    model = _Model(f"```python\n{GAME}```")
    monkeypatch.setattr("envcraft_llm.pipeline.single.create_model", lambda *_: (model, None))
    given = ["repair", str(file), "--base-url", "http://none", "--sandbox", "process", "--budget", "quick"]
    result = CliRunner().invoke(cli, given)
    assert result.exit_code == 0, result.output
    assert result.stdout == GAME
    assert re.search(r"attempt 0: 1 finding\n  EC204", result.stderr)
    assert "EC204" in model.requests[0].messages[1].content
    assert file.read_text() == UNSEEDED


def test_a_report_equals_its_stored_form_and_can_be_sent() -> None:
    async def judged() -> SubjectReport:
        with options.judge_executor(driver_named("process", None, None), "quick", 1)[0] as judges:
            report, _ = await judges.judge(Target("game.py", b'raise ValueError("half a letter: \\ud800")\n'))
        return report

    report = asyncio.run(judged())
    assert decode(msgspec.json.encode(plain(report)).decode()) == report
    words = "\n".join(finding_lines(findings(report)))
    assert "half a letter: \\ud800" in words
    assert Request("m", (Message("user", words),)).key()


def test_a_policy_for_one_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file, output = tmp_path / "game.py", tmp_path / "policy.py"
    file.write_text(GAME)
    model = _Model(f"```python\n{POLICY}```")
    monkeypatch.setattr("envcraft_llm.pipeline.single.create_model", lambda *_: (model, None))
    given = ["privileged", str(file), "--base-url", "http://none", "--sandbox", "process", "--budget", "quick"]
    result = CliRunner().invoke(cli, [*given, "--output", str(output)])
    assert result.exit_code == 0, result.output
    assert output.read_text() == POLICY
    assert "policy 0: wins 6 of 6" in result.stderr
    assert result.stdout == ""
    assert GAME.strip() in model.requests[0].messages[1].content


def test_no_policy_is_written_if_only_the_search_wins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file, output = tmp_path / "game.py", tmp_path / "policy.py"
    file.write_text(GAME)
    model = _Model(f"```python\n{IDLE}```")
    monkeypatch.setattr("envcraft_llm.pipeline.single.create_model", lambda *_: (model, None))
    given = ["privileged", str(file), "--base-url", "http://none", "--sandbox", "process", "--budget", "quick"]
    for rewrites, more in enumerate(((), ("--output", str(output)))):
        # test_repairs.py has all rewrites.
        monkeypatch.setattr("envcraft_llm.stages.privileged.REWRITES", rewrites)
        result = CliRunner().invoke(cli, [*given, *more])
        assert (result.exit_code, result.stdout) == (0, ""), result.output
        assert "passed  no policy wins, but the checker's own search does" in result.stderr
    assert not output.exists()


@pytest.mark.parametrize("command", ["repair", "privileged"])
def test_a_single_stage_checks_sandbox_and_output_before_any_request(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("game.py").write_text(GAME)
    model = _Model("nothing")
    monkeypatch.setattr("envcraft_llm.pipeline.single.create_model", lambda *_: (model, None))
    given = [command, "game.py", "--base-url", "http://none", "--sandbox", "process"]
    result = CliRunner().invoke(cli, [*given, "--output", "nowhere/out.py"])
    assert (result.exit_code, "nowhere does not exist" in result.output) == (2, True)
    for setting, words in (("sandbox = 'nothing'", "there is no sandbox"), ("require-isolation = 'odd'", "'odd'")):
        Path("pyproject.toml").write_text(f"[tool.envcraft]\n{setting}\n")
        result = CliRunner().invoke(cli, given[:4])
        assert (result.exit_code, words in result.output) == (2, True), result.output
    assert not model.requests


def test_without_a_model_nothing_is_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)
    given = ["generate", "--concepts", "2", "--corpus", "corpus", "--sandbox", "process"]
    for more, words in (([], "no endpoint is configured"), (["--offline"], "completions come from a journal")):
        result = CliRunner().invoke(cli, [*given, *more])
        assert (result.exit_code, words in result.output) == (2, True), result.output
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    ("model", "base_url", "demo"),
    [
        ("demo", "http://127.0.0.1:8000/v1", True),
        ("demo:7b", "http://127.0.0.1:8000/v1", False),
        ("demo:7b", "", True),
        ("demo:folder", "http://127.0.0.1:8000/v1", True),
        ("demonstration", "", False),
    ],
)
def test_a_model_named_like_the_demo(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, model: str, base_url: str, demo: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    assert options.is_demo(ModelSettings(model=model, base_url=base_url)) is demo


def test_the_demo_that_ships_needs_pygame(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pygame" else found(name))
    given = ["generate", "--model", "demo", "--corpus", str(tmp_path / "corpus"), "--sandbox", "process"]
    result = CliRunner().invoke(cli, given)
    assert (result.exit_code, "`pip install 'envcraft-rl[play]'`" in result.stderr) == (2, True)
    assert not [*tmp_path.iterdir()]


def test_answers_about_other_concepts_are_rejected(tmp_path: Path, generate: Generate) -> None:
    write(tmp_path / "odd", 0, attempt_0=GAME)
    place = next((tmp_path / "odd").iterdir())
    place.rename(place.with_name("00_0123456789abcdef"))
    result = generate(content=tmp_path / "odd")
    assert result.exit_code == 2
    assert "does not match seed 0" in result.output
