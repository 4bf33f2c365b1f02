"""Each kind of damage is detected and repaired, and is then gone; a second merge changes nothing."""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from envcraft.corpus.merge import merge
from envcraft.corpus.store import Environment, Store
from envcraft.corpus.verify import LOST, verify
from envcraft.errors import UsageError

from .conftest import SETTINGS, Invoke, judged, report, rows, source


def place(store: Store, name: str) -> Path:
    return store.place(hashlib.sha256(source(name)).hexdigest())


def unguarded(store: Store, statement: str) -> None:
    """Write like a program that does not enable foreign keys."""
    store.db.execute("PRAGMA foreign_keys = OFF")
    store.db.execute(statement)
    store.db.execute("PRAGMA foreign_keys = ON")


def elsewhere(store: Store) -> None:
    place(store, "ant").rename(store.root / "sources" / "ant.py")


def swapped(store: Store) -> None:
    ant, bee = place(store, "ant"), place(store, "bee")
    ant.rename(store.root / "other")
    bee.rename(ant)
    (store.root / "other").rename(bee)


def changed(store: Store) -> None:
    place(store, "ant").write_bytes(b"changed")


def gone(store: Store) -> None:
    place(store, "ant").unlink()


def orphan(store: Store) -> None:
    store.put(b"nobody's")


def copy(store: Store) -> None:
    (store.root / "sources" / "copy.py").write_bytes(source("ant"))


def dangling_environment(store: Store) -> None:
    unguarded(store, "UPDATE environments SET verdict = 99 WHERE name = 'ant'")


def dangling_findings(store: Store) -> None:
    unguarded(store, "INSERT INTO findings SELECT 99, number, rule_check, code, severity, line, message FROM findings")


def dangling_verdict(store: Store) -> None:
    unguarded(store, "UPDATE verdicts SET settings = 99 WHERE verdict = 'fail'")


def no_report(store: Store) -> None:
    store.db.execute("UPDATE verdicts SET report = substr(report, 1, 40) WHERE verdict = 'fail'")


def other_verdict(store: Store) -> None:
    store.db.execute("UPDATE verdicts SET verdict = 'pass'")


def lost_findings(store: Store) -> None:
    store.db.execute("DELETE FROM findings WHERE code = 'EC203'")


def torn_index(store: Store) -> None:
    """An index without one of its rows, as after a lost write."""
    definition = "SELECT sql FROM sqlite_master WHERE name = 'findings_by_code'"
    (sql,) = store.db.execute(definition).fetchone()
    store.db.execute("DROP INDEX findings_by_code")
    store.db.execute(f"{sql} WHERE code = 'EC107'")
    store.db.execute("PRAGMA writable_schema = ON")
    store.db.execute("UPDATE sqlite_master SET sql = ? WHERE name = 'findings_by_code'", (sql,))
    store.db.execute("PRAGMA writable_schema = RESET")


#: Damage, whether the repair restores everything, and what is set aside.
KINDS: list[tuple[Callable[[Store], None], bool, set[str]]] = [
    (elsewhere, True, set()),
    (swapped, True, set()),
    (changed, False, {"rows.jsonl", "ant"}),
    (gone, False, {"rows.jsonl"}),
    (orphan, True, {"orphan"}),
    (copy, True, {"copy.py"}),
    (dangling_environment, False, set()),
    (dangling_findings, True, {"rows.jsonl"}),
    (dangling_verdict, False, {"rows.jsonl"}),
    (no_report, False, {"rows.jsonl"}),
    (other_verdict, True, set()),
    (lost_findings, True, set()),
    (torn_index, True, set()),
]


@pytest.mark.parametrize(("damage", "whole", "aside"), KINDS, ids=[kind[0].__name__ for kind in KINDS])
def test_damage_is_found_and_mended(
    store: Store, damage: Callable[[Store], None], whole: bool, aside: set[str]
) -> None:
    before = rows(store)
    assert list(verify(store)) == []
    damage(store)
    found = list(verify(store))
    assert found
    assert not [one for one in found if one.done]
    assert list(verify(store)) == found
    mended = list(verify(store, repair=True))
    assert mended
    assert all(one.done for one in mended)
    assert list(verify(store)) == []
    assert (rows(store) == before) == whole
    names = {file.name for file in (store.root / LOST).glob("*")}
    assert len(names) == len(aside)
    assert ("rows.jsonl" in names) == ("rows.jsonl" in aside)


def test_what_is_set_aside_can_be_read(store: Store) -> None:
    gone(store)
    list(verify(store, repair=True))
    (line,) = (store.root / LOST / "rows.jsonl").read_text().splitlines()
    told = json.loads(line)
    assert (told["table"], told["row"]["name"]) == ("environments", "ant")


def test_command_tells_damage_by_its_status(store: Store, invoke: Invoke) -> None:
    store.close()
    assert "no damage" in invoke("corpus", "verify", store.root).stdout
    place(store, "ant").unlink()
    result = invoke("corpus", "verify", store.root)
    assert (result.exit_code, result.stdout) == (1, "the source of ant is missing\n")
    assert invoke("corpus", "verify", store.root, "--repair").exit_code == 0
    assert invoke("corpus", "verify", store.root).exit_code == 0


def test_moved_files_survive_an_interrupted_repair(store: Store) -> None:
    copy(store)
    place(store, "ant").write_bytes(b"somebody's work")
    assert next(verify(store, repair=True)).done
    store.close()
    with Store(store.root, write=True) as again:
        assert [file.read_bytes() for file in (again.root / LOST).iterdir()] == [b"somebody's work"]
        assert place(again, "ant").read_bytes() == source("ant")


def test_where_the_database_is_lost_the_sources_are_what_is_left(store: Store, invoke: Invoke) -> None:
    store.close()
    (store.root / "corpus.sqlite").write_bytes(b"no database at all" * 100)
    result = invoke("corpus", "verify", store.root)
    assert result.exit_code == 3
    assert "corpus verify" not in result.stderr
    assert f"`envcraft corpus init NEW` and `envcraft corpus add NEW {store.root}/sources`" in result.stderr
    assert invoke("corpus", "init", "new").exit_code == 0
    assert "4 environments added" in invoke("corpus", "add", "new", store.root / "sources").stdout
    assert "`envcraft corpus verify" in invoke("corpus", "list", store.root).stderr


def test_torn_database_is_reported_and_files_stay(store: Store, invoke: Invoke) -> None:
    for number in range(200):
        judged(store, f"a{number}", "EC107")
    store.db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    store.close()
    path = store.root / "corpus.sqlite"
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 8192] = bytes(8192)
    path.write_bytes(data)
    files = sorted((store.root / "sources").rglob("*.py"))
    result = invoke("corpus", "verify", store.root, "--repair")
    assert result.exit_code in (1, 3)
    assert "corpus" in result.output
    assert sorted((store.root / "sources").rglob("*.py")) == files


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A corpus with a new environment, one that differs, and an error as a verdict."""
    with Store.create(tmp_path / "other") as made:
        judged(made, "ant")
        judged(made, "cat")
        judged(made, "fox", "EC107")
        made.add("dog", source("wolf"))
    return tmp_path / "other"


def test_merge_adds_missing_and_is_idempotent(store: Store, other: Path) -> None:
    with Store(other) as source_store:
        merged = merge(store, source_store)
        assert (merged.added, merged.verdicts) == (2, 2)
        assert merged.renamed == [("dog", f"dog@{hashlib.sha256(source('wolf')).hexdigest()[:8]}")]
        after = rows(store)
        again = merge(store, source_store)
        assert (again.added, again.verdicts) == (0, 0)
        assert rows(store) == after
    assert list(verify(store)) == []
    verdicts = dict(
        store.db.execute("SELECT name, v.verdict FROM environments e LEFT JOIN verdicts v ON v.id = e.verdict")
    )
    assert (verdicts["cat"], verdicts["fox"], verdicts["dog"]) == ("pass", "fail", None)


def test_the_last_verdict_stays_the_last_when_it_is_merged(store: Store, tmp_path: Path) -> None:
    newer = msgspec.structs.replace(SETTINGS, rules="newer")
    with Store.create(tmp_path / "newest") as made:
        for name, codes in (("fox", ()), ("gnu", ("EC101",))):
            judged(made, name)
            environment = Environment(name, hashlib.sha256(source(name)).hexdigest(), "")
            made.record(environment, made.settings(newer), report(name, "EC107"))
            # Two failed last, one of them by the older rules.
            if codes:
                made.record(environment, made.settings(SETTINGS), report(name, *codes))
    with Store(tmp_path / "newest") as other:
        for _ in range(2):
            merge(store, other)
            assert dict(
                store.db.execute(
                    "SELECT name, s.rules || ' ' || v.verdict FROM environments e JOIN verdicts v ON v.id = e.verdict "
                    "JOIN settings s ON s.id = v.settings WHERE name IN ('fox', 'gnu')"
                )
            ) == {"fox": "newer fail", "gnu": f"{SETTINGS.rules} fail"}


def test_a_corpus_does_not_merge_with_itself(store: Store) -> None:
    with Store(store.root) as same, pytest.raises(UsageError, match="the same corpus"):
        merge(store, same)


def test_planted_rows_do_break_references(store: Store) -> None:
    dangling_verdict(store)
    with pytest.raises(sqlite3.IntegrityError):
        store.db.execute("UPDATE verdicts SET settings = 98 WHERE verdict = 'fail'")
