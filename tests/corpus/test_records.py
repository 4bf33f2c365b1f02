"""Validation records: they are written, read, and compared with a new report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from envcraft.cli.commands.reverify import choose
from envcraft.corpus.records import Record, drift, evidence, read, record, records_of
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
from envcraft.model.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

from .conftest import ENVIRONMENT, QUICK, SETTINGS, Invoke, judged, report, source

Lines = list[bytes]


def write(path: Path, records: Iterable[Record]) -> None:
    path.write_bytes(b"".join(msgspec.json.encode(line) + b"\n" for line in records))


@pytest.fixture
def file(store: Store, tmp_path: Path) -> Path:
    judged(store, "elk", "EC301")
    path = tmp_path / "records.jsonl"
    write(path, records_of(store))
    return path


def test_each_judged_environment_has_a_line(file: Path) -> None:
    found = read(str(file))
    assert [(known.path, known.verdict.value) for known in found] == [("ant", "pass"), ("bee", "fail"), ("elk", "fail")]
    assert found[1].checks[0].codes == ["EC107", "EC203"]
    assert (found[1].envcraft, found[1].settings) == ("0.1.0", SETTINGS)
    sha256 = found[1].source_sha256
    place = f"sources/{sha256[:2]}/{sha256[2:4]}/{sha256}.py"
    assert (file.parent / "corpus" / place).read_bytes() == source("bee")
    assert found[1].command == (
        f"envcraft validate {place} --contract arcade --budget quick --seed 0 --sandbox process --checks api"
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"schema":1', '"schema":2'),
        ("{", "["),
        ('"kind":"record"', '"kind":"other"'),
        ('"verdict":"fail"', '"verdict":"won"'),
    ],
)
def test_an_invalid_line_is_named(file: Path, invoke: Invoke, old: str, new: str) -> None:
    lines: Lines = file.read_bytes().splitlines(keepends=True)
    assert old.encode() in lines[1]
    lines[1] = lines[1].replace(old.encode(), new.encode(), 1)
    file.write_bytes(b"".join(lines))
    result = invoke("reverify", file)
    assert result.exit_code == 2, result.output
    assert "line 2" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_files_with_a_hash_chain_are_still_read(file: Path) -> None:
    """Earlier versions chained the lines by digests and wrote their number in the last line."""
    before = read(str(file))
    chained = [{**json.loads(line), "previous": "", "digest": "0" * 64} for line in file.read_text().splitlines()]
    chained.append({"kind": "end", "records": 3, "previous": "0" * 64, "digest": "1" * 64})
    file.write_text("".join(f"{json.dumps(line)}\n" for line in chained))
    assert read(str(file)) == before


def test_another_layout_of_the_same_is_the_same(file: Path) -> None:
    before = read(str(file))
    lines = [json.dumps(json.loads(line), sort_keys=True) for line in file.read_text().splitlines()]
    file.write_text("\n".join(lines) + "\n")
    assert read(str(file)) == before


def test_what_was_known_of_an_older_source_is_no_record(store: Store) -> None:
    store.add("bee", b"import gymnasium\n")
    assert [known.path for known in records_of(store)] == ["ant"]


def test_evidence_is_codes_evidence_and_reproduction() -> None:
    def digest(**changes: Any) -> str:
        told: dict[str, Any] = {"share": 0.5, "seconds": 1.0}
        finding = Finding("EC107", Severity.ERROR, "m", 3, told, Repro(1, [[0, 0, 0]]))
        return evidence(CheckReport("api", Verdict.FAIL, 0.1, [msgspec.structs.replace(finding, **changes)]))

    same = digest()
    # The form in which a corpus returns it.
    found = Finding("EC107", Severity.ERROR, "n", 3, {"share": 0.5}, Repro(1, [[0, 0, 0]]))
    text = msgspec.json.encode(CheckReport("api", Verdict.FAIL, 9.0, [found]))
    stored = msgspec.json.decode(text, type=CheckReport)
    assert evidence(stored) == same
    assert digest(message="took 3 s", evidence={"seconds": 2.0, "share": 0.5}) == same
    assert digest(code="EC106") != same
    assert digest(evidence={"share": 0.25}) != same
    assert digest(repro=Repro(1, [[0, 0, 1]])) != same


def known(*codes: str, traces: str = "t") -> tuple[Record, SubjectReport]:
    told = msgspec.structs.replace(report("bee", *codes), traces=traces)
    return record("bee", "bee", told.source_sha256, None, SETTINGS, told), told


def test_drift_by_check_evidence_and_traces() -> None:
    recorded, told = known("EC107")
    assert drift(recorded, told) == ([], [])
    assert drift(recorded, msgspec.structs.replace(told, seconds=9.0, steps=7)) == ([], [])
    assert drift(recorded, msgspec.structs.replace(told, traces="u")) == ([], ["other traces"])
    assert drift(recorded, known("EC301")[1]) == ([], ["api with other evidence"])
    assert drift(recorded, known()[1]) == (["pass, was fail", "api pass, was fail"], [])
    assert drift(recorded, msgspec.structs.replace(told, checks=[])) == (["api not run, was fail"], [])
    # A verdict of a version without trace digests.
    assert drift(known("EC107", traces="")[0], told) == ([], [])


@pytest.mark.parametrize(("codes", "deterministic"), [((), True), (("EC107", "EC209"), True), (("EC203",), False)])
def test_what_is_not_deterministic_may_differ_in_traces(codes: tuple[str, ...], deterministic: bool) -> None:
    assert known(*codes)[0].deterministic is deterministic


@pytest.mark.parametrize(("sample", "count"), [(None, 30), ("1%", 1), ("10%", 3), ("7", 7), ("99", 30), ("100%", 30)])
def test_samples(sample: str | None, count: int) -> None:
    all_of_them = [msgspec.structs.replace(known()[0], path=f"e{number:02}") for number in range(30)]
    chosen = choose(all_of_them, sample, 3)
    assert len(chosen) == count
    assert chosen == choose(all_of_them, sample, 3)
    assert [item.path for item in chosen] == sorted(item.path for item in chosen)


@pytest.mark.parametrize("sample", ["0", "0%", "101%", "1.5", "-1", "many", "1%%"])
def test_no_samples(sample: str) -> None:
    with pytest.raises(UsageError, match="neither a number of records"):
        choose([known()[0]], sample, 0)


@pytest.fixture
def games(tmp_path: Path) -> Path:
    folder = tmp_path / "games"
    folder.mkdir()
    for name, crash in (("a.py", -1), ("b.py", 7)):
        (folder / name).write_text(ENVIRONMENT.replace("CRASH", str(crash)))
    return folder


def rewritten(path: Path, *changes: Callable[[Record], Record]) -> None:
    """Change the records of a file."""
    write(path, [change(line) for change, line in zip(changes, read(str(path)), strict=True)])


def test_a_corpus_is_recorded_and_judged_again(games: Path, invoke: Invoke) -> None:
    assert invoke("audit", "games", *QUICK).exit_code == 1
    database = (games / ".envcraft" / "corpus.sqlite").read_bytes()
    written = invoke("corpus", "records", "games", "--output", "games/records.jsonl")
    assert written.exit_code == 0
    file = games / "records.jsonl"
    text = file.read_text()
    assert written.stderr == "2 records written\n"
    assert invoke("corpus", "records", "games").stdout == text
    assert invoke("corpus", "records", "nowhere", "--output", "games/records.jsonl").exit_code == 2
    assert file.read_text() == text

    # From the corpus, from the files beside the records, and from the corpus beside them.
    again = invoke("reverify", "games")
    assert (again.exit_code, again.stdout) == (
        0,
        "2 of 2 records judged again: 2 as recorded, 0 drifted, 0 could not be judged\n",
    )
    (games / "a.py").write_text("changed\n")
    refused = invoke("reverify", "games/records.jsonl")
    assert refused.exit_code == 2
    assert "choose --sandbox process" in refused.stderr
    again = invoke("reverify", "games/records.jsonl", "--sandbox", "process")
    assert again.exit_code == 3
    assert "a.py: could not be judged: games/a.py has changed since it was recorded" in again.stdout
    assert "1 as recorded, 0 drifted, 1 could not be judged" in again.stdout

    def passes(known: Record) -> Record:
        checks = [msgspec.structs.replace(check, verdict=Verdict.PASS, codes=[]) for check in known.checks]
        return msgspec.structs.replace(known, verdict=Verdict.PASS, checks=checks)

    def played(known: Record) -> Record:
        settings = msgspec.structs.replace(known.settings, image="python 2", rules="0.0.9+other")
        return msgspec.structs.replace(known, traces="f" * 32, settings=settings)

    rewritten(file, played, passes)
    again = invoke("reverify", file, "--corpus", "games", "--sandbox", "process")
    assert again.exit_code == 1, again.output
    first, second, _ = again.stdout.splitlines()
    assert first.startswith("a.py: other traces (judged now by rules 0.1.0+")
    assert "not 0.0.9+other; image or libraries python 3" in first
    assert second == "b.py: fail, was pass, api fail, was pass"
    assert (games / ".envcraft" / "corpus.sqlite").read_bytes() == database


def test_usage_errors_are_one_line(games: Path, invoke: Invoke) -> None:
    invoke("corpus", "init", "corpus")
    for arguments, words in (
        (["none.jsonl"], "cannot read"),
        (["games"], "is not a corpus"),
        (["games/a.py"], "line 1 is not a record"),
        (["corpus"], "has no verdict to repeat"),
        (["corpus", "--corpus", "corpus"], "leave out --corpus"),
    ):
        result = invoke("reverify", *arguments)
        assert result.exit_code == 2, result.output
        assert words in result.stderr
