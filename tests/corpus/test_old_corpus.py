"""A corpus that an earlier version wrote opens, verifies, reports, exports and reverifies.

``fixtures/corpus-schema-8.tar.xz`` holds three environments, an audit, keys, a preview, a recording, the history of a
concept, and records with a hash chain.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from envcraft.corpus.merge import merge
from envcraft.corpus.records import read
from envcraft.corpus.store import Store, demonstrations, environments, generation
from envcraft.corpus.trust import last_verdicts

from .conftest import Invoke

ARCHIVE = Path(__file__).parent / "fixtures" / "corpus-schema-8.tar.xz"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    shutil.unpack_archive(ARCHIVE, tmp_path)
    return (tmp_path / "corpus0").rename(tmp_path / "old")


def test_its_rows_are_read(old: Path) -> None:
    with Store(old) as store:
        assert [(row.environment.name, row.verdict) for row in environments.listed(store)] == [
            ("broken_miner_edge_crash.py", "fail"),
            ("broken_vault_missing_key.py", None),
            ("crossing.py", "pass"),
        ]
        row = environments.get(store, "crossing.py")
        assert row is not None
        assert row.origin["licence"] == "mit"
        assert last_verdicts(store, row.environment.source, "")["arcade"].doubt == ""
        assert [player for player, _ in demonstrations.outcomes(store)] in ([], ["random"])
        [(name, recording)] = demonstrations.named(store)
        assert (name, recording.player, recording.steps) == ("crossing.py", "random", 40)
        assert generation.brief(store, "c0ffee") == ("A chicken crosses a road.", {"model": "m"})


def test_it_verifies_merges_and_lists(old: Path, tmp_path: Path, invoke: Invoke) -> None:
    assert invoke("corpus", "verify", old).stdout == "3 environments: no damage\n"
    with Store.create(tmp_path / "new") as store, Store(old) as other:
        merged = merge(store, other)
    assert (merged.added, merged.verdicts, merged.concepts) == (3, 2, 1)
    shown = json.loads(invoke("corpus", "show", old, "crossing", "--format", "json").stdout)
    assert [policy["wins"] for policy in shown["history"]["policies"]] == [3]
    assert shown["verdicts"][0]["report"]["verdict"] == "pass"


def test_it_reports_and_exports(old: Path, tmp_path: Path, invoke: Invoke) -> None:
    for needed in ("jinja2", "matplotlib", "rensa"):
        pytest.importorskip(needed)
    result = invoke("corpus", "report", old, "--output", tmp_path / "report", "--no-previews")
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "report" / "report.json").read_text())["verdicts"] == {
        "fail": 1,
        "none": 1,
        "pass": 1,
    }
    result = invoke("export", old, "--to", "package", "--output", tmp_path / "package", "--name", "games")
    assert result.exit_code == 0, result.output
    entries = json.loads((tmp_path / "package" / "games" / "environments.json").read_text())["environments"]
    assert [entry["name"] for entry in entries] == ["crossing.py"]


@pytest.mark.slow
def test_it_is_reverified(old: Path, invoke: Invoke) -> None:
    records = old.parent / "records.jsonl"
    assert [record.path for record in read(str(records))] == ["broken_miner_edge_crash.py", "crossing.py"]
    # Only the environment that fails at once, which takes few steps.
    first = records.read_text().splitlines()[0]
    shutil.copyfile(records, records.with_name("all.jsonl"))
    records.write_text(f"{first}\n")
    result = invoke("reverify", records, "--corpus", old, "--sandbox", "process")
    # Later rules play other episodes, which is a drift of evidence and traces, and reach the same verdict.
    assert "broken_miner_edge_crash.py: api with other evidence, other traces" in result.output
    assert "1 of 1 record judged again: 0 as recorded, 1 drifted, 0 could not be judged" in result.output
