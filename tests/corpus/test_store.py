"""The store: its contents, the input that it refuses, and atomic writes."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from envcraft.corpus.audit import Audit
from envcraft.corpus.store import CorpusBusy, CorpusDamaged, Environment, Store, decode, schema
from envcraft.corpus.store.audits import Selection
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.settings import Settings
from envcraft.model.verdict import Verdict

from .conftest import SETTINGS, report, rows, source


def test_what_was_written_is_there_when_it_is_opened_again(store: Store) -> None:
    written = rows(store)
    store.close()
    with Store(store.root) as again:
        assert rows(again) == written
        assert again.source(hashlib.sha256(source("ant")).hexdigest()) == source("ant")
        (text,) = again.db.execute("SELECT report FROM verdicts WHERE verdict = 'fail'").fetchone()
        assert decode(text) == report("bee", "EC107", "EC203")


def test_adding_again_changes_nothing_and_another_source_leaves_the_verdict_behind(store: Store) -> None:
    assert not store.add("ant", source("ant"))
    assert store.add("ant", source("ape"))
    assert store.twins(source("ape")) == ["ant"]
    verdict, current = store.db.execute(
        "SELECT v.source, e.source FROM environments e JOIN verdicts v ON v.id = e.verdict WHERE name = 'ant'"
    ).fetchone()
    assert verdict != current


@pytest.mark.parametrize(
    "change",
    [
        {"contract_sha256": "1" * 64},
        {"rules": "0.1.0+other"},
        {"seed": 1},
        {"budget": "standard"},
        {"driver": "docker"},
        {"image": "sha256:1"},
    ],
)
def test_a_verdict_is_kept_for_each_way_to_judge(store: Store, change: dict[str, str | int]) -> None:
    other: Settings = msgspec.structs.replace(SETTINGS, **change)
    environment = Environment("ant", hashlib.sha256(source("ant")).hexdigest(), "")
    for settings in (SETTINGS, other, other):
        store.record(environment, store.settings(settings), report("ant", "EC101"))
    found = store.db.execute("SELECT count(*) FROM verdicts WHERE source = ?", environment[1:2]).fetchone()
    assert found == (2,)
    assert store.db.execute("SELECT count(*) FROM findings WHERE code = 'EC101'").fetchone() == (2,)


def test_a_verdict_of_some_checks_takes_no_place_of_one_of_all(store: Store) -> None:
    def last(name: str) -> object:
        (found,) = store.db.execute(
            "SELECT v.verdict, s.checks FROM environments AS e JOIN verdicts AS v ON v.id = e.verdict "
            "JOIN settings AS s ON s.id = v.settings WHERE name = ?",
            (name,),
        )
        return found

    some = store.settings(msgspec.structs.replace(SETTINGS, rules="some", checks="source"))
    for name in ("bee", "dog"):
        environment = Environment(name, hashlib.sha256(source(name)).hexdigest(), "")
        store.record(environment, some, report(name))
    assert last("bee") == ("fail", "")
    assert last("dog") == ("pass", "source")
    # An audit with fewer checks whose verdicts are all known does not make them the last ones.
    Audit(store, some, Selection())
    assert last("bee") == ("fail", "")
    store.record(environment, store.settings(SETTINGS), report("dog", "EC107"))
    assert last("dog") == ("fail", "")
    # The changed source has no verdict of all checks.
    store.add("bee", b"# another\n" + source("bee"))
    store.record(
        Environment("bee", hashlib.sha256(b"# another\n" + source("bee")).hexdigest(), ""), some, report("bee")
    )
    assert last("bee") == ("pass", "source")


def test_removing_takes_the_source_and_the_verdicts_unless_another_has_them(store: Store) -> None:
    place = store.place(hashlib.sha256(source("bee")).hexdigest())
    store.add("bee2", source("bee"))
    assert store.remove("bee")
    assert place.exists()
    assert store.remove("bee2")
    assert not place.exists()
    assert not store.remove("bee")
    assert store.db.execute("SELECT count(*) FROM findings").fetchone() == (0,)


def test_a_source_that_has_changed_is_not_given(store: Store) -> None:
    sha256 = hashlib.sha256(source("ant")).hexdigest()
    store.place(sha256).write_bytes(b"other")
    with pytest.raises(CorpusDamaged, match="verify"):
        store.source(sha256)
    store.place(sha256).unlink()
    with pytest.raises(CorpusDamaged, match="verify"):
        store.source(sha256)


def test_a_source_that_cannot_be_written_whole_is_not_there(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        store.add("eel", source("eel"))
    assert not store.place(hashlib.sha256(source("eel")).hexdigest()).exists()
    assert not list((store.root / "tmp").iterdir())
    assert store.db.execute("SELECT 1 FROM environments WHERE name = 'eel'").fetchone() is None


def test_a_verdict_that_cannot_be_written_whole_leaves_the_one_before(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        raise RuntimeError("in between")

    before = rows(store)
    monkeypatch.setattr(store, "write_findings", breaks)
    with pytest.raises(RuntimeError):
        store.record(
            Environment("bee", hashlib.sha256(source("bee")).hexdigest(), ""), store.settings(SETTINGS), report("bee")
        )
    assert rows(store) == before


def test_what_a_killed_writer_left_half_written_is_swept(store: Store) -> None:
    (store.root / "tmp" / "tmpabc").write_bytes(b"half")
    store.close()
    Store(store.root, write=True).close()
    assert not list((store.root / "tmp").iterdir())


def test_second_writer_fails_and_readers_succeed(store: Store) -> None:
    with pytest.raises(CorpusBusy, match=f"process {os.getpid()} is writing"):
        Store(store.root, write=True)
    command = [sys.executable, "-m", "envcraft", "corpus", "rm", str(store.root), "ant"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 3
    assert "is writing to the corpus" in result.stderr
    with Store(store.root) as reader:
        assert rows(reader) == rows(store)
    store.close()
    Store(store.root, write=True).close()


def test_a_corpus_that_may_only_be_read_is_read(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    written = rows(store)
    # A folder without write permission, also for root.
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK)
    with Store(store.root) as reader:
        # An existing write-ahead log is read.
        assert rows(reader) == written
    store.close()
    for file in store.root.glob("corpus.sqlite-*"):
        file.unlink()
    with Store(store.root) as reader:
        assert rows(reader) == written
        assert not list(store.root.glob("corpus.sqlite-*"))
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            reader.db.execute("DELETE FROM environments")
    with (
        pytest.raises(EnvCraftError, match="cannot read or write the corpus") as told,
        Store(store.root) as reader,
    ):
        reader.db.execute("DELETE FROM environments")
    assert not isinstance(told.value, CorpusDamaged)


def test_names_of_corpora_may_have_any_signs(tmp_path: Path) -> None:
    root = tmp_path / "a?mode=memory#b%20c ü"
    with Store.create(root) as made:
        made.add("ant", source("ant"))
    with Store(root) as reader:
        assert [name for name, *_ in rows(reader)] == ["ant"]


def test_migrations_run_once_each_and_keep_what_there_is(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before = rows(store)
    store.close()
    added = "ALTER TABLE environments ADD COLUMN stars INTEGER NOT NULL DEFAULT 3"
    monkeypatch.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, added))
    for _ in range(2):
        with Store(store.root) as again:
            assert rows(again) == before
            assert again.db.execute("SELECT sum(stars) FROM environments").fetchone() == (12,)
            assert again.db.execute("PRAGMA user_version").fetchone() == (len(schema.MIGRATIONS),)


def test_a_migration_that_fails_changes_nothing(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before = rows(store)
    store.close()
    with monkeypatch.context() as patch:
        broken = "CREATE TABLE more (id INTEGER); INSERT INTO there_is_none VALUES (1)"
        patch.setattr(schema, "MIGRATIONS", (*schema.MIGRATIONS, broken))
        with pytest.raises(CorpusDamaged, match="there_is_none"):
            Store(store.root)
    with Store(store.root, write=True) as again:
        assert rows(again) == before
        assert again.db.execute("SELECT name FROM sqlite_master WHERE name = 'more'").fetchone() is None


def test_a_newer_schema_is_refused(store: Store) -> None:
    store.db.execute("PRAGMA user_version = 99")
    store.close()
    with pytest.raises(UsageError, match="schema 99"):
        Store(store.root)


def test_invalid_database_is_damage(store: Store) -> None:
    store.close()
    for file in store.root.glob("corpus.sqlite*"):
        file.unlink()
    (store.root / "corpus.sqlite").write_bytes(b"no database at all" * 100)
    with pytest.raises(CorpusDamaged, match="not a database"):
        Store(store.root)


@pytest.mark.parametrize("foreign", [False, True])
def test_an_empty_database_is_no_empty_corpus(store: Store, foreign: bool) -> None:
    store.close()
    for file in store.root.glob("corpus.sqlite*"):
        file.unlink()
    database = store.root / "corpus.sqlite"
    with contextlib.closing(sqlite3.connect(database)) as other:
        other.execute("CREATE TABLE mine (id)" if foreign else "VACUUM")
    before = database.read_bytes()
    with pytest.raises(CorpusDamaged, match="is empty or does not belong"):
        Store(store.root)
    assert database.read_bytes() == before
    with pytest.raises(CorpusDamaged, match="is empty or does not belong"):
        Store(store.root, write=True)
    with contextlib.closing(sqlite3.connect(database)) as other:
        assert other.execute("SELECT count(*) FROM sqlite_master").fetchone() == (int(foreign),)


def test_a_corpus_is_made_in_an_empty_folder_only(tmp_path: Path, store: Store) -> None:
    with pytest.raises(UsageError, match="is already a corpus"):
        Store.create(store.root)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.txt").touch()
    with pytest.raises(UsageError, match="is not empty"):
        Store.create(tmp_path / "full")
    with pytest.raises(UsageError, match="corpus init"):
        Store(tmp_path / "nowhere")


def test_one_that_was_killed_while_it_was_made_is_made_again(tmp_path: Path) -> None:
    (tmp_path / "sources").mkdir()
    for name in (".gitignore", "lock", "corpus.sqlite.new", "corpus.sqlite.new-journal"):
        (tmp_path / name).write_bytes(b"half")
    with Store.create(tmp_path, folder=True) as made:
        assert made.follows_folder
    assert not list(tmp_path.glob("*.new*"))


def test_foreign_keys_hold(store: Store) -> None:
    with pytest.raises(sqlite3.IntegrityError):
        store.db.execute("INSERT INTO findings VALUES (999, 1, 'api', 'EC101', 'error', NULL, '')")


def test_an_error_gives_way_to_a_verdict(store: Store) -> None:
    environment = Environment("cat", hashlib.sha256(source("cat")).hexdigest(), "")
    store.record(environment, store.settings(SETTINGS), report("cat"))
    found = store.db.execute("SELECT verdict FROM verdicts WHERE source = ?", environment[1:2]).fetchall()
    assert found == [(Verdict.PASS.value,)]
