"""``envcraft export --to sft`` on a corpus with scripted completions and verdicts."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import importlib
import importlib.util
import json
import random
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from click.testing import CliRunner, Result
from envcraft_llm import extraction
from envcraft_llm.model import Message, Request
from envcraft_llm.pipeline.context import CorpusContext
from envcraft_llm.pipeline.judging import JudgeExecutor
from envcraft_llm.pipeline.runner import PipelineRunner
from envcraft_llm.recorded import RecordedModel
from envcraft_llm.sft.rows import KINDS, answer, columns
from envcraft_llm.stages import STAGES

from envcraft.cli.group import cli
from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.store import Environment, Store, decode
from envcraft.generation.history import History
from envcraft.generation.stages import Attempt, ConceptState
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport, Verdict

from .content import POLICY, brief, verdict
from .scripted import PROFILE, finding, report

SETTINGS = Settings("arcade", contract_digest(ARCADE), "0.1.0+rules", 0, "quick", "process", "python 3")
#: Six concepts of their own, and twelve with a near-duplicate each, twelve numbers on.
COUNT, ALONE, APART = 30, 6, 12
#: What becomes of a concept, by its number modulo 6.
FATES = ("validated", "repaired", "gutted first", "unfixable", "instawin", "too hard")
#: One is never judged, and one judged no further than its repair.
CODED, REPAIRED = COUNT, COUNT + 1

# A corpus


def original(number: int) -> int:
    """Return the number of the concept whose game this one copies, or its own."""
    return number - APART if ALONE + APART <= number < COUNT else number


def game(number: int, *marks: str) -> str:
    """Return a game unlike all others, except for a copy, which differs by one word in two lines."""
    rng = random.Random(original(number))
    words = ["".join(rng.choices("abcdefghijklmnop", k=6)) for _ in range(60)]
    lines = [
        f"        self.{word} = self.{rng.choice(words)} {rng.choice('+-*')} {rng.randrange(1000)}" for word in words
    ]
    if original(number) != number:
        lines[7:9] = ["        self.copied = 1", "        self.again = self.copied * 3"]
    head = ["import gymnasium as gym", "", *(f"{mark} = 1" for mark in marks), "", "class GameEnv(gym.Env):"]
    return "\n".join([*head, "    def step(self, action):", *lines, "        return self.state", ""])


def tiny(number: int) -> str:
    """Return a degenerate file."""
    return (
        f"import gymnasium as gym\n\n\nclass GameEnv(gym.Env):\n    def step(self, action):\n        return {number}\n"
    )


def answers(number: int) -> dict[str, str]:
    """Return the files of a concept by attempt."""
    fate = FATES[number % len(FATES)] if number < COUNT else "validated"
    good, bad = game(number), game(number, "BAD")
    return {
        "validated": {"attempt_0": good},
        "repaired": {"attempt_0": bad, "attempt_1": good},
        "gutted first": {"attempt_0": bad, "attempt_1": tiny(number), "attempt_2": good},
        "unfixable": {"attempt_0": bad},
        "instawin": {"attempt_0": game(number, "EASY")},
        "too hard": {"attempt_0": game(number, "HARD")},
    }[fate]


class Scripted(JudgeExecutor):
    """Judges by markers in the source."""

    def __init__(self) -> None:
        """Do nothing."""

    async def judge(self, target: Target) -> tuple[SubjectReport, dict[str, Any]]:
        source = target.text
        found = [finding("EC107", "step() raises IndexError", 12, traceback="line 12")] if "BAD" in source else []
        found += [finding("EC601", "random play wins")] if "EASY" in source else []
        return report(source, *found, difficulty=Verdict.SKIP if "HARD" in source else Verdict.PASS), dict(PROFILE)

    async def play(self, target: Target, policy: str) -> tuple[SubjectReport, tuple[int, int]]:
        return report(target.text), (0 if "HARD" in target.text else 6, 6)


def built(root: Path, numbers: Sequence[int]) -> Path:
    """Build a corpus of the concepts with these numbers, one after the other."""
    states = [ConceptState(f"{number:016x}", f"Game {number}", "Fetch the key.") for number in numbers]
    for number, state in zip(numbers, states, strict=True):
        place = root.parent / f"{root.name}-answers" / f"{number:02}_{state.concept}"
        place.mkdir(parents=True)
        (place / "brief.md").write_text(brief(state.title), "utf-8")
        (place / "viability.json").write_text(verdict(), "utf-8")
        for name, text in {**answers(number), "policy_0": POLICY}.items():
            (place / f"{name}.py").write_text(text, "utf-8")
    last = {CODED: "code", REPAIRED: "repair"}
    with Store.create(root) as store:
        history = History(store, SETTINGS)
        history.keep_concepts(states)
        context = CorpusContext(
            history, RecordedModel(root.parent / f"{root.name}-answers"), Scripted(), lambda stage: "demo"
        )
        for number, state in zip(numbers, states, strict=True):
            run = PipelineRunner(history, [stage() for stage in STAGES], last=last.get(number, ""))
            asyncio.run(run.run([state.concept], context, 1))
    return root


def export(corpus: Path, output: Path, *more: str) -> Result:
    return CliRunner().invoke(cli, ["export", str(corpus), "--to", "sft", "--output", str(output), *more])


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("generated") / "games", range(COUNT + 2))


@pytest.fixture(scope="module")
def made(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("exported") / "made"
    result = export(corpus, output, "--name", "Small | games", "--licence", "cc-by-4.0")
    assert result.exit_code == 0, result.output
    assert "code 15, repair 10, preference 15, unpaired 60" in result.output
    return output


def lines(folder: Path, kind: str) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of a kind by split."""
    return {
        place.stem: [json.loads(line) for line in place.read_text("utf-8").splitlines()]
        for place in sorted((folder / "jsonl" / kind).iterdir())
    }


def rows(folder: Path, kind: str) -> list[dict[str, Any]]:
    return [row for part in lines(folder, kind).values() for row in part]


# What is in it


def test_rows_of_each_kind(made: Path) -> None:
    fates = {kind: Counter(FATES[int(row["concept"], 16) % 6] for row in rows(made, kind)) for kind in KINDS}
    assert fates == {
        "code": {"validated": 5, "repaired": 5, "gutted first": 5},
        "repair": {"repaired": 5, "gutted first": 5},
        "preference": {"repaired": 5, "gutted first": 10},
        "unpaired": {"validated": 5, "repaired": 10, "gutted first": 15, "unfixable": 20, "instawin": 5, "too hard": 5},
    }
    said = Counter(row["reason"].partition(" ")[0] for row in rows(made, "unpaired"))
    assert said == {"": 15, "EC107": 30, "gutted:": 5, "instawin:": 5, "too": 5}
    assert all(row["label"] == (row["reason"] == "") for row in rows(made, "unpaired"))


def test_only_passed_files_are_answers(made: Path) -> None:
    for kind in ("code", "repair", "preference"):
        for row in rows(made, kind):
            said = row["chosen" if kind == "preference" else "messages"][-1]["content"]
            file = extraction.environment(said)
            assert file is not None
            assert file.source == game(int(row["concept"], 16))
            assert hashlib.sha256(file.source.encode()).hexdigest() == row["code_sha256"]
            assert row["codes"] == []
    for row in rows(made, "preference"):
        number = int(row["concept"], 16)
        refused = extraction.environment(row["rejected"][0]["content"])
        assert refused is not None
        assert hashlib.sha256(refused.source.encode()).hexdigest() == row["rejected_sha256"] != row["code_sha256"]
        assert refused.source in (game(number, "BAD"), tiny(number))


def test_repair_rows_have_the_broken_file_and_its_findings(made: Path) -> None:
    for row in rows(made, "repair"):
        number = int(row["concept"], 16)
        user = row["messages"][1]["content"]
        assert (row["broken"], row["mended"]) == (game(number, "BAD"), game(number))
        assert row["findings"] in user
        assert row["broken"].strip() in user
        assert "EC107 (step-raises)" in row["findings"]
        assert "step() raises IndexError" in row["findings"]
        assert (row["parent"], row["parent_codes"]) == (0, ["EC107"])
        assert row["attempt"] == (2 if FATES[number % 6] == "gutted first" else 1)
        # The refused one in between is told of, and is nobody's parent.
        assert ("takes the game apart" in user) == (row["attempt"] == 2)


def test_prompts_of_rows_are_those_of_the_pipeline(made: Path) -> None:
    """The digest of the request shows that they are identical."""
    found = rows(made, "unpaired")
    assert found
    for row in found:
        asked = Request(row["model"], tuple(Message(one["role"], one["content"]) for one in row["prompt"]))
        assert asked.key() == row["request_sha256"]


def test_rows_have_provenance(corpus: Path, made: Path) -> None:
    with Store(corpus) as store:
        attempts = {
            (concept, number): (source, json.loads(told))
            for concept, number, source, told in store.db.execute(
                "SELECT concept, number, source, provenance FROM attempts"
            )
        }
        briefs = dict(store.db.execute("SELECT concept, provenance FROM briefs"))
        names = dict(store.db.execute("SELECT json_extract(origin, '$.concept'), name FROM environments"))
    for kind in KINDS:
        for row in rows(made, kind):
            source, told = attempts[row["concept"], row["attempt"]]
            assert row["code_sha256"] == source
            assert (row["model"], row["request_sha256"]) == (told["model"], told["request"])
            assert row["prompt_sha256"] == told["prompt"]
            assert row["brief_request_sha256"] == json.loads(briefs[row["concept"]])["request"]
            assert row["brief_sha256"] == hashlib.sha256(brief(row["title"]).encode()).hexdigest()
            assert (row["licence"], row["rules"], row["sandbox"]) == ("cc-by-4.0", SETTINGS.rules, "process")
            assert (row["contract_sha256"], row["budget"], row["seed"]) == (SETTINGS.contract_sha256, "quick", 0)
            assert row["environment"] == (names[row["concept"]] if row.get("label", True) else None)
            if row["parent"] is None:
                assert row["attempt"] == 0
            else:
                assert row["parent_sha256"] == attempts[row["concept"], row["parent"]][0]


# Formats

#: The columns that TRL's trainers look at, of each kind; all others are passed over.
TYPES = {
    "code": {"messages"},
    "repair": {"messages"},
    "preference": {"prompt", "chosen", "rejected"},
    "unpaired": {"prompt", "completion", "label"},
}
LOOKED_AT = {"prompt", "chosen", "rejected", "completion", "messages", "label"}
OTHERS = {"text", "conversations", "tools", "images", "input_ids", "completions", "labels", "chat_template_kwargs"}


def conversational(example: dict[str, Any]) -> bool:
    """TRL's own function decides if installed; otherwise its rule: lists of messages with role and content."""
    if importlib.util.find_spec("trl") is not None:
        return bool(importlib.import_module("trl.data_utils").is_conversational(example))
    known = [example[name] for name in LOOKED_AT - {"label"} if name in example]
    return bool(known) and all(
        isinstance(value, list) and value and all({"role", "content"} <= set(message) for message in value)
        for value in known
    )


@pytest.mark.parametrize("kind", KINDS)
def test_loads_with_datasets_in_a_format_of_trl(
    made: Path, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (
        ("HF_HUB_OFFLINE", "1"),
        ("HF_HOME", str(tmp_path)),
        ("HF_DATASETS_DISABLE_PROGRESS_BARS", "1"),
    ):
        monkeypatch.setenv(name, value)
    from datasets import load_dataset

    loaded = load_dataset(str(made), kind, cache_dir=str(tmp_path / "cache"))
    told = lines(made, kind)
    assert sorted(loaded) == sorted(told)
    for split, wanted in told.items():
        assert loaded[split].to_list() == wanted
    for row in loaded["train"]:
        assert {name for name in row if name in LOOKED_AT} == TYPES[kind]
        assert not OTHERS & set(row)
        assert conversational(row)
        asked = row["messages"][:-1] if "messages" in row else row["prompt"]
        assert [message["role"] for message in asked] == ["system", "user"]
        for name in TYPES[kind] - {"prompt", "label"}:
            assert row[name][-1]["role"] == "assistant"
            assert all(isinstance(message["content"], str) and message["content"] for message in row[name])
        assert isinstance(row.get("label", True), bool)


def test_json_lines_can_be_loaded_as_they_are(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    from datasets import load_dataset

    files = {split: str(made / "jsonl" / "unpaired" / f"{split}.jsonl") for split in ("train", "test")}
    loaded = load_dataset("json", data_files=files, cache_dir=str(tmp_path / "cache"))
    assert loaded["train"].to_list() == lines(made, "unpaired")["train"]
    assert conversational(loaded["test"][0])


# Splits


def test_no_copy_is_in_another_split(made: Path) -> None:
    """There are 12 pairs of near-duplicates, broken files included."""
    split: dict[int, set[str]] = {}
    cluster: dict[int, set[int]] = {}
    for kind in KINDS:
        for name, part in lines(made, kind).items():
            for row in part:
                split.setdefault(original(int(row["concept"], 16)), set()).add(name)
                cluster.setdefault(original(int(row["concept"], 16)), set()).add(row["cluster"])
    assert len(split) == ALONE + APART
    assert all(len(names) == 1 for names in split.values())
    assert all(len(numbers) == 1 for numbers in cluster.values())
    assert len({number for numbers in cluster.values() for number in numbers}) == ALONE + APART
    for kind in ("code", "unpaired"):
        assert set(lines(made, kind)) == {"train", "validation", "test"}


def test_the_same_corpus_gives_the_same_files(made: Path, tmp_path: Path) -> None:
    """The order of the concepts does not matter."""
    again = built(tmp_path / "games", range(COUNT + 1, -1, -1))
    assert export(again, tmp_path / "made", "--name", "Small | games", "--licence", "cc-by-4.0").exit_code == 0
    found = [
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (made, tmp_path / "made")
    ]
    assert found[0] == found[1]


# The card, and what is refused


def test_the_card(made: Path) -> None:
    text = (made / "README.md").read_text("utf-8")
    front = yaml.safe_load(text.split("---\n")[1])
    assert (front["pretty_name"], front["license"]) == ("Small | games", "cc-by-4.0")
    assert [config["config_name"] for config in front["configs"]] == list(KINDS)
    for config in front["configs"]:
        for part in config["data_files"]:
            assert list(made.glob(part["path"])), part
    assert "# Small \\| games" in text
    assert "100 rows" in text
    assert "15 passed and 45 did not. Attempts without one, which have no row:\n2." in text
    assert "licensed under cc-by-4.0" in text
    assert f"| {SETTINGS.rules} | arcade |" in text
    assert "| code | 32 | 32 | 0 | 0 |" in text
    assert re.search(r"^- repair 2: 5 of 10 ", text, re.MULTILINE)
    assert "@" not in text
    for kind in KINDS:
        for name, *_ in columns(kind):
            assert f"| `{name}` |" in text


@contextlib.contextmanager
def changed(corpus: Path, folder: Path) -> Iterator[Store]:
    """Yield a copy of a corpus, open for writing."""
    shutil.copytree(corpus, folder)
    with Store(folder, write=True) as store:
        yield store


def test_a_file_that_a_later_audit_fails_is_no_answer(corpus: Path, tmp_path: Path) -> None:
    with changed(corpus, tmp_path / "games") as store:
        name, source, picked, told = store.db.execute(
            "SELECT name, e.source, e.class, report FROM environments e JOIN verdicts v ON v.id = e.verdict "
            "WHERE json_extract(origin, '$.concept') = ?",
            (f"{1:016x}",),
        ).fetchone()
        settings = store.settings(msgspec.structs.replace(SETTINGS, budget="deep"))
        failed = report(game(1), finding("EC203", "it differs"))
        assert failed.source_sha256 == decode(told).source_sha256
        store.record(Environment(name, source, picked), settings, failed)
    assert export(tmp_path / "games", tmp_path / "made").exit_code == 0
    assert len(rows(tmp_path / "made", "code")) == 14
    of = {row["attempt"]: row for row in rows(tmp_path / "made", "unpaired") if int(row["concept"], 16) == 1}
    assert (of[1]["label"], of[1]["reason"], of[1]["budget"]) == (False, "judged again: it fails", "deep")
    assert (of[0]["budget"], of[1]["environment"]) == ("quick", None)


def test_licences_are_stated_or_unknown(corpus: Path, tmp_path: Path) -> None:
    assert export(corpus, tmp_path / "made").exit_code == 0
    assert {row["licence"] for row in rows(tmp_path / "made", "code")} == {"unknown"}
    assert "\nlicense: unknown\n" in (tmp_path / "made" / "README.md").read_text("utf-8")
    with changed(corpus, tmp_path / "games") as store:
        store.db.execute("UPDATE environments SET origin = json_set(origin, '$.licence', 'mit')")
    result = export(tmp_path / "games", tmp_path / "other", "--licence", "cc0-1.0")
    assert result.exit_code == 2
    assert "the corpus states mit" in result.output
    assert not (tmp_path / "other").exists()


def test_nothing_is_overwritten(corpus: Path, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "mine.txt").write_text("mine")
    result = export(corpus, tmp_path / "made")
    assert result.exit_code == 2
    assert "is not empty" in result.output
    assert [path.name for path in tmp_path.rglob("*")] == ["made", "mine.txt"]


def test_a_corpus_without_labelled_attempts_is_a_usage_error(corpus: Path, tmp_path: Path) -> None:
    with Store.create(tmp_path / "plain") as store:
        store.add("game.py", game(0).encode())
    result = export(tmp_path / "plain", tmp_path / "made")
    assert result.exit_code == 2
    assert "has no generated environments" in result.output
    assert not (tmp_path / "made").exists()
    result = export(corpus, tmp_path / "made", "--all")
    assert result.exit_code == 2
    assert "--all cannot be used with --to sft" in result.output


def test_the_fence_is_longer_than_any_in_the_file() -> None:
    source = f'"""A game.\n\n```python\nplay()\n```\n"""\n{game(0)}'
    file = extraction.environment(answer(Attempt(0, source))["content"])
    assert file is not None
    assert file.source == source
