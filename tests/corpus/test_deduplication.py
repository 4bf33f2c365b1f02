"""Duplicates in a corpus: clusters and their best, what is removed, how diverse the rest is, and splits."""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from envcraft.corpus import deduplication
from envcraft.corpus.deduplication import LAYERS, clusters, diversities, groups_of
from envcraft.corpus.splits import corpus_splits, families, family_splits, split
from envcraft.corpus.store import Environment, Store, schema
from envcraft.errors import UsageError
from envcraft.model.verdict import CheckReport, Finding, Severity, SubjectReport, Verdict
from envcraft.similarity import exact
from tests.similarity.games import RULES, game, reformatted, renamed

from .conftest import SETTINGS, Invoke

pytest.importorskip("rensa")

FEW = ("exact", "structural", "near")
CHANGED = game(0).replace(b">= 500", b">= 400")


def judge(store: Store, name: str, verdict: Verdict, warnings: int = 0, errors: int = 0, fingerprint: str = "") -> None:
    (source,) = store.db.execute("SELECT source FROM environments WHERE name = ?", (name,)).fetchone()
    kinds = [Severity.WARNING] * warnings + [Severity.ERROR] * errors
    checks = [CheckReport("api", verdict, 0.1, [Finding("EC107", kind, "words") for kind in kinds])]
    report = SubjectReport(name, None, source, verdict, "process", 0.1, 5, checks, fingerprint=fingerprint)
    store.record(Environment(name, source, ""), store.settings(SETTINGS), report)


@pytest.fixture
def corpus(tmp_path: Path) -> Iterator[Store]:
    """Eight games on one scaffold, and four that are the first one again."""
    with Store.create(tmp_path / "corpus") as made:
        for number in range(len(RULES)):
            made.add(f"game{number}.py", game(number))
        made.add("reformatted.py", reformatted(game(0)))
        made.add("renamed.py", renamed(game(0)))
        made.add("changed.py", CHANGED)
        yield made


def test_each_layer_finds_its_own_and_all_of_them_one_cluster(corpus: Store) -> None:
    found = clusters(corpus, FEW)
    names = {layer: [sorted(members) for members in told.clusters] for layer, told in found.layers.items()}
    assert names["exact"] == [["game0.py", "reformatted.py"]]
    assert names["structural"] == [["game0.py", "reformatted.py", "renamed.py"]]
    assert names["near"] == [["changed.py", "game0.py", "reformatted.py"]]
    assert [sorted(cluster.members) for cluster in found.clusters] == [
        ["changed.py", "game0.py", "reformatted.py", "renamed.py"]
    ]
    assert found.clusters[0].layers == list(FEW)
    assert [told.keyed for told in found.layers.values()] == [11, 11, 11]


def test_the_best_passes_has_fewest_findings_and_came_first(corpus: Store) -> None:
    def best() -> str:
        return clusters(corpus, FEW).clusters[0].members[0]

    corpus.db.execute("UPDATE environments SET added = '2001' WHERE name = 'renamed.py'")
    corpus.db.execute("UPDATE environments SET added = '2002' WHERE name = 'reformatted.py'")
    assert best() == "renamed.py"
    judge(corpus, "renamed.py", Verdict.FAIL, errors=1)
    judge(corpus, "reformatted.py", Verdict.PASS, warnings=2)
    assert best() == "reformatted.py"
    judge(corpus, "changed.py", Verdict.PASS, warnings=1)
    assert clusters(corpus, FEW).clusters[0].members == ["changed.py", "reformatted.py", "renamed.py", "game0.py"]
    # A verdict on what the source was before counts for nothing.
    corpus.add("changed.py", game(0).replace(b">= 500", b">= 401"))
    assert best() == "reformatted.py"


def test_keys_are_kept_and_made_anew_with_their_version(corpus: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    first = clusters(corpus, FEW)

    def refuse(source: bytes) -> bytes:
        raise AssertionError("made again")

    with monkeypatch.context() as patch:
        patch.setitem(deduplication._OF_SOURCES, "exact", (exact.VERSION, refuse))
        assert clusters(corpus, FEW) == first
        patch.setitem(deduplication._OF_SOURCES, "exact", (exact.VERSION + 1, refuse))
        with pytest.raises(AssertionError, match="made again"):
            clusters(corpus, FEW)
    patched = (exact.VERSION + 1, lambda source: b"one")
    monkeypatch.setitem(deduplication._OF_SOURCES, "exact", patched)
    assert len(clusters(corpus, ("exact",)).layers["exact"].clusters[0]) == 11
    count = corpus.db.execute("SELECT count(*) FROM keys").fetchone()
    assert count == (33,)


def test_keys_go_with_their_source(corpus: Store) -> None:
    clusters(corpus, FEW)
    corpus.remove("game3.py")
    sha256 = hashlib.sha256(game(3)).hexdigest()
    assert not corpus.db.execute("SELECT 1 FROM keys WHERE source = ?", (sha256,)).fetchone()
    assert corpus.db.execute("SELECT count(*) FROM keys").fetchone() == (30,)


def test_a_corpus_that_only_is_read(corpus: Store) -> None:
    with Store(corpus.root) as reader:
        assert clusters(reader, FEW).clusters
    assert corpus.db.execute("SELECT count(*) FROM keys").fetchone() == (0,)


def test_a_corpus_from_before_there_were_keys(corpus: Store) -> None:
    later = ("keys", "previews", "outcomes", "policies", "attempts", "briefs", "concepts", "episodes", "demonstrations")
    for table in later:
        corpus.db.execute(f"DROP TABLE {table}")
    for column in ("checks", "offered"):
        corpus.db.execute(f"ALTER TABLE settings DROP COLUMN {column}")
    corpus.db.execute("ALTER TABLE audits DROP COLUMN complete")
    corpus.db.execute("PRAGMA user_version = 1")
    corpus.close()
    with Store(corpus.root, write=True) as store:
        assert clusters(store, FEW).clusters
        assert schema.version(store.db, "") == len(schema.MIGRATIONS)


def test_sources_that_cannot_be_read(corpus: Store) -> None:
    for number in range(2):
        corpus.add(f"odd{number}.py", b"\xff\xfe def (" + b"(" * number)
    found = clusters(corpus, FEW)
    assert [told.keyed for told in found.layers.values()] == [13, 11, 11]
    assert len(found.clusters) == 1


def test_two_classes_of_one_source_are_two_environments(corpus: Store) -> None:
    for name in ("One", "Two"):
        corpus.add(f"{name}.py", b"class One: pass\nclass Two: pass\n", name)
    assert clusters(corpus, ("exact", "structural")).layers["exact"].clusters == [["game0.py", "reformatted.py"]]
    # Yet a split does not part them.
    assert {"One.py", "Two.py"} in [set(group) for group in groups_of(corpus, FEW)]


def test_behaviour_comes_from_reports(corpus: Store, fingerprints: dict[str, str]) -> None:
    judge(corpus, "game1.py", Verdict.PASS, fingerprint=fingerprints["a"])
    judge(corpus, "game2.py", Verdict.PASS, fingerprint=fingerprints["a"])
    judge(corpus, "game3.py", Verdict.PASS, fingerprint=fingerprints["b"])
    judge(corpus, "game4.py", Verdict.PASS, fingerprint="nonsense")
    found = clusters(corpus, LAYERS)
    assert found.layers["behavioural"].clusters == [["game1.py", "game2.py"]]
    assert found.layers["behavioural"].keyed == 3
    assert len(found.clusters) == 2
    measured = {told.layer: told for told in diversities(corpus)}
    assert measured["behavioural"].environments == 3
    assert 1.5 < measured["behavioural"].score < 2.1


@pytest.fixture
def fingerprints() -> dict[str, str]:
    import base64

    import numpy as np

    from envcraft.similarity.behavioural import _HEAD

    made = {}
    for number, name in enumerate("ab"):
        rng = np.random.default_rng(number)
        head = _HEAD.pack(1, 0, 32, 9, b"script--")
        frames, rewards = rng.integers(1, 2**62, 9).astype("<u8"), rng.integers(0, 3, 8).astype("<f4")
        made[name] = base64.b64encode(head + frames.tobytes() + rewards.tobytes()).decode()
    return made


def test_diversity(corpus: Store) -> None:
    measured = {told.layer: told for told in diversities(corpus, FEW)}
    assert measured["exact"].score == pytest.approx(9.7, abs=0.05)
    assert measured["structural"].score < measured["exact"].score
    assert 7 < measured["near"].score < 10
    assert [told.least == told.most for told in measured.values()] == [True] * 3
    (sampled,) = diversities(corpus, ("near",), sample=6)
    assert (sampled.environments, sampled.sample) == (11, 6)
    assert 1 < sampled.least <= sampled.score <= sampled.most <= 6
    assert diversities(corpus, ("near",), sample=6) == [sampled]
    assert diversities(corpus, ("near",), sample=6, seed=1) != [sampled]


def test_dedup_removes_only_with_keep_best(corpus: Store, invoke: Invoke) -> None:
    corpus.close()
    chosen = [word for layer in FEW for word in ("--layer", layer)]
    result = invoke("corpus", "dedup", corpus.root, *chosen)
    assert result.exit_code == 0, result.output
    assert "11 environments: 1 cluster, 3 duplicates" in result.output
    told = json.loads(invoke("corpus", "dedup", corpus.root, *chosen, "--format", "json").stdout)
    assert told["removed"] == []
    assert told["layers"]["exact"] == {"keyed": 11, "clusters": [["game0.py", "reformatted.py"]]}
    (cluster,) = told["clusters"]
    result = invoke("corpus", "dedup", corpus.root, *chosen, "--keep-best", "--format", "json")
    assert json.loads(result.stdout)["removed"] == cluster["others"]
    left = [row["name"] for row in json.loads(invoke("corpus", "list", corpus.root, "--format", "json").stdout)]
    assert left == sorted([cluster["best"], *(f"game{number}.py" for number in range(1, len(RULES)))])
    assert invoke("corpus", "verify", corpus.root).exit_code == 0
    assert "8 environments: 0 clusters" in invoke("corpus", "dedup", corpus.root, "--keep-best").output


def test_a_folder_that_is_followed_loses_nothing(tmp_path: Path, invoke: Invoke) -> None:
    with Store.create(tmp_path / "kept", folder=True) as store:
        store.add("a.py", game(0))
        store.add("b.py", reformatted(game(0)))
    result = invoke("corpus", "dedup", tmp_path / "kept", "--keep-best", "--layer", "exact")
    assert result.exit_code == 2
    assert "follows a folder" in result.output
    assert "1 cluster" in invoke("corpus", "dedup", tmp_path / "kept", "--layer", "exact").output


def test_diversity_and_split_commands(corpus: Store, invoke: Invoke) -> None:
    corpus.close()
    told = json.loads(invoke("corpus", "diversity", corpus.root, "--format", "json").stdout)["diversity"]
    assert [measured["layer"] for measured in told] == list(LAYERS)
    assert (told[3]["environments"], told[3]["score"]) == (0, 0)
    assert "no environment has a key" in invoke("corpus", "diversity", corpus.root, "--layer", "behavioural").output
    lines = invoke("corpus", "diversity", corpus.root, "--layer", "exact").output
    assert lines.strip() == "exact        9.7 of 11 environments"
    written = json.loads(invoke("corpus", "split", corpus.root, "--fractions", "0.5,0.5").stdout)["splits"]
    assert sorted(name for part in written for name in part["environments"]) == sorted(
        [*(f"game{number}.py" for number in range(len(RULES))), "changed.py", "reformatted.py", "renamed.py"]
    )
    assert len(json.loads(invoke("corpus", "split", corpus.root, "--folds", "3").stdout)["splits"]) == 3
    many = invoke("corpus", "split", corpus.root, "--folds", "50")
    assert many.exit_code == 2
    assert re.search(r"--folds 50 leaves \d+ splits of \d+ environments empty; name fewer", many.stderr)
    for wrong in ((), ("--folds", "3", "--fractions", "1"), ("--fractions", "0.5,x"), ("--fractions", "0.5,0.4")):
        assert invoke("corpus", "split", corpus.root, *wrong).exit_code == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fractions", "0.5,0.6"), "the fractions 0.5,0.6 add up to 1.1, not to 1"),
        (("--by", "family", "--fractions", "0.5,0.6"), "the fractions 0.5,0.6 add up to 1.1, not to 1"),
        (("--folds", "50"), "--folds 50 leaves 39 splits of 11 environments empty; name fewer"),
    ],
)
def test_a_wrong_split_needs_no_library(
    options: tuple[str, ...], words: str, corpus: Store, invoke: Invoke, monkeypatch: pytest.MonkeyPatch
) -> None:
    corpus.close()
    monkeypatch.setitem(sys.modules, "rensa", None)
    result = invoke("corpus", "split", corpus.root, *options)
    assert result.exit_code == 2
    assert words in result.stderr


# Splits


def names(found: list[list[str]]) -> list[str]:
    return sorted(name for part in found for name in part)


def test_no_cluster_is_cut(corpus: Store) -> None:
    for seed in range(5):
        found = corpus_splits(corpus, (0.6, 0.2, 0.2), seed, FEW)
        copies = {"changed.py", "game0.py", "reformatted.py", "renamed.py"}
        assert sum(bool(copies & set(part)) for part in found) == 1
        assert len(names(found)) == 11
    assert corpus_splits(corpus, (0.6, 0.2, 0.2), 1, FEW) == corpus_splits(corpus, (0.6, 0.2, 0.2), 1, FEW)
    assert len({str(corpus_splits(corpus, (0.6, 0.2, 0.2), seed, FEW)) for seed in range(5)}) > 1


@pytest.mark.parametrize("fractions", [(0.8, 0.1, 0.1), (0.2,) * 5, (1.0,)])
def test_fractions_are_met_as_far_as_clusters_allow(fractions: tuple[float, ...]) -> None:
    groups: list[list[str]] = [
        [f"{number}-{copy}" for copy in range(1 + number % 7 * (number % 3))] for number in range(200)
    ]
    total = sum(map(len, groups))
    found = split(groups, fractions, 3)
    assert names(found) == sorted(name for group in groups for name in group)
    for part, fraction in zip(found, fractions, strict=True):
        assert abs(len(part) - fraction * total) <= 3
    for group in groups:
        assert sum(set(group) <= set(part) for part in found) == 1


def test_the_order_of_groups_makes_no_difference_and_one_more_moves_few() -> None:
    groups: list[list[str]] = [[f"{number}"] for number in range(300)]
    found = split(groups, (0.8, 0.1, 0.1), 0)
    assert split(groups[::-1], (0.8, 0.1, 0.1), 0) == found
    more = split([*groups, ["new"]], (0.8, 0.1, 0.1), 0)
    moved = sum(len(set(before) - set(after)) for before, after in zip(found, more, strict=True))
    assert moved <= 2


@pytest.mark.parametrize("fractions", [(), (0.5, 0.4), (1.5, -0.5), (0.5, 0.5, 0.0), (float("nan"), 1.0)])
def test_fractions_that_are_none(fractions: tuple[float, ...]) -> None:
    with pytest.raises(UsageError):
        split([["a"]], fractions)


# Splits by family


@pytest.fixture
def mixed(tmp_path: Path) -> Iterator[Store]:
    """Eight games of families of four, three and one."""
    with Store.create(tmp_path / "mixed") as made:
        for number, family in enumerate("aaaabbbc"):
            made.add(f"game{number}.py", game(number), origin={"family": family})
        yield made


def test_no_family_is_cut(mixed: Store) -> None:
    assert {family: len(names) for family, names in families(mixed).items()} == {"a": 4, "b": 3, "c": 1}
    assert sorted(map(len, family_splits(mixed))) == [1, 3, 4]
    assert sorted(map(len, family_splits(mixed, (0.5, 0.5)))) == [4, 4]
    # A share that is too small for any family still gets one.
    assert sorted(map(len, family_splits(mixed, (0.98, 0.01, 0.01)))) == [1, 3, 4]
    with pytest.raises(UsageError, match="has 3 families that share no duplicates, and 4 splits need one each"):
        family_splits(mixed, [0.25] * 4)


def test_families_that_share_a_copy_stay_together(mixed: Store) -> None:
    mixed.add("copy.py", reformatted(game(0)), origin={"family": "c"})
    mixed.add("stray.py", renamed(game(4)))
    found = family_splits(mixed, layers=FEW)
    assert sorted(map(len, found)) == [4, 6]
    assert {"copy.py", "game0.py", "game7.py"} <= set(sorted(found, key=len)[-1])
    with pytest.raises(UsageError, match="has 2 families"):
        family_splits(mixed, [1 / 3] * 3, layers=FEW)


def test_the_command_names_the_families_of_each_split(mixed: Store, invoke: Invoke) -> None:
    mixed.close()
    written = json.loads(invoke("corpus", "split", mixed.root, "--by", "family").stdout)
    assert written["by"] == "family"
    assert sorted((part["families"], len(part["environments"])) for part in written["splits"]) == [
        (["a"], 4),
        (["b"], 3),
        (["c"], 1),
    ]
    halves = json.loads(invoke("corpus", "split", mixed.root, "--by", "family", "--folds", "2").stdout)["splits"]
    assert sorted(part["families"] for part in halves) == [["a"], ["b", "c"]]
    assert invoke("corpus", "split", mixed.root, "--by", "family", "--folds", "4").exit_code == 2


def test_an_audit_tells_what_environments_do(tmp_path: Path, invoke: Invoke) -> None:
    """From the sandbox to the clusters: games that are written otherwise, and one that does otherwise."""
    folder = tmp_path / "games"
    folder.mkdir()
    paid: dict[str, Any] = {
        "one.py": game(0),
        "two.py": game(0).replace(b"self.score - before", b"-before + self.score"),
        "three.py": game(5),
    }
    for name, source in paid.items():
        (folder / name).write_bytes(source)
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source,reward", "--exit-zero")
    result = invoke("audit", folder, *options)
    assert result.exit_code == 0, result.output
    told = json.loads(invoke("corpus", "dedup", folder, "--layer", "behavioural", "--format", "json").stdout)
    assert told["layers"]["behavioural"] == {"keyed": 3, "clusters": [["one.py", "two.py"]]}
    with sqlite3.connect(folder / ".envcraft" / "corpus.sqlite") as db:
        reports = [json.loads(text) for (text,) in db.execute("SELECT report FROM verdicts")]
    assert all(len(report["fingerprint"]) > 100 for report in reports)
