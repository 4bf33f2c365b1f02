"""The demo that ships: the checker gives each recorded concept its expected outcome."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from envcraft_llm.recorded import ARCHIVE, RecordedConcept, load, pack, recorded_concepts, unpack

from envcraft.cli.group import cli
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
from envcraft.generation.history import History
from envcraft.generation.stages import StageOutcome

#: Numbers of the cheapest concepts for four outcomes; ENVCRAFT_DEMO=all selects all concepts.
SOME = (3, 7, 10, 35)
EXPECTED = re.compile(
    r"validated( after repair [123])?|unviable|unfixable|gutted|instawin|instadeath|too hard|too easy"
)


def ended(outcomes: dict[str, StageOutcome]) -> str:
    """The outcome of a concept, as ``expected.txt`` names it."""
    if (validated := outcomes.get("validated")) is not None:
        attempt = validated.facts["attempt"]
        return f"validated after repair {attempt}" if attempt else "validated"
    stage, outcome = next((stage, found) for stage, found in outcomes.items() if found.result != "passed")
    return "unviable" if stage == "viability" else outcome.reason.partition(":")[0]


def expected(recorded: RecordedConcept) -> str:
    return recorded.files["expected.txt"].strip()


def test_the_demo_is_complete() -> None:
    assert recorded_concepts(), "no recorded answers"
    for recorded in load(ARCHIVE):
        assert EXPECTED.fullmatch(expected(recorded)), recorded.folder
        assert json.loads(recorded.files["viability.json"])["viable"] == (expected(recorded) != "unviable")
        assert "brief.md" in recorded.files


def test_the_archive_survives_unpacking_and_packing(tmp_path: Path) -> None:
    unpack(ARCHIVE, tmp_path / "answers")
    assert load(tmp_path / "answers") == load(ARCHIVE)
    for name in ("one", "two"):
        pack(tmp_path / "answers", tmp_path / f"{name}.jsonl.gz")
    assert load(tmp_path / "one.jsonl.gz") == load(ARCHIVE)
    assert (tmp_path / "one.jsonl.gz").read_bytes() == (tmp_path / "two.jsonl.gz").read_bytes()


def test_an_archive_that_is_cut_off_is_a_usage_error(tmp_path: Path) -> None:
    (tmp_path / "cut.jsonl.gz").write_bytes(ARCHIVE.read_bytes()[:1000])
    with pytest.raises(UsageError, match="cannot be read as recorded answers"):
        load(tmp_path / "cut.jsonl.gz")


@pytest.mark.bubblewrap
def test_each_concept_has_its_expected_outcome(tmp_path: Path) -> None:
    every = os.environ.get("ENVCRAFT_DEMO") == "all"
    chosen = {recorded.concept: recorded for recorded in load(ARCHIVE) if every or recorded.number in SOME}
    unpack(ARCHIVE, tmp_path / "demo")
    for recorded in load(ARCHIVE):
        if recorded.concept not in chosen:
            shutil.rmtree(tmp_path / "demo" / recorded.folder)
    given = ["--model", f"demo:{tmp_path / 'demo'}", "--corpus", str(tmp_path / "corpus"), "--sandbox", "bubblewrap"]
    result = CliRunner().invoke(cli, ["generate", *given])
    assert result.exit_code in (0, 1), result.output
    # It says where the environments are, and what is next.
    corpus = tmp_path / "corpus"
    assert f"The environments are in the corpus {corpus}. Next: envcraft corpus list {corpus}" in result.stdout
    with Store(tmp_path / "corpus") as store:
        history = History(store)
        outcomes = {concept: history.outcomes(concept) for concept in history.concepts()}
    assert outcomes.keys() == chosen.keys()
    wrong = {
        concept: f"{ended(found)}, expected {expected(chosen[concept])}: "
        + "; ".join(f"{stage} {outcome.reason}" for stage, outcome in found.items() if outcome.reason)
        for concept, found in outcomes.items()
        if ended(found) != expected(chosen[concept])
    }
    assert not wrong
