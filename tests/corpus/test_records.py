"""Validation records: a file shows what was done to it, and what is judged again is held against it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from envcraft.commands.reverify import choose
from envcraft.corpus.records import Record, chain, drift, encode, evidence, read, record, records_of
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
from envcraft.verdict import CheckReport, Finding, Repro, Severity, SubjectReport, Verdict

from .conftest import ENVIRONMENT, QUICK, SETTINGS, Invoke, judged, report, source

Lines = list[bytes]


@pytest.fixture
def file(store: Store, tmp_path: Path) -> Path:
    judged(store, "elk", "EC301")
    path = tmp_path / "records.jsonl"
    path.write_bytes(b"".join(encode(line) for line in chain(records_of(store))))
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


def test_the_chain_can_be_told_by_anybody(file: Path) -> None:
    previous = ""
    lines = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    for line in lines:
        told = {name: value for name, value in line.items() if name != "digest"}
        text = json.dumps(told, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        assert line["digest"] == hashlib.sha256(text.encode()).hexdigest()
        assert line["previous"] == previous
        previous = line["digest"]
    assert lines[-1]["records"] == 3


def changed(at: int, old: str, new: str) -> Callable[[Lines], Lines]:
    def change(lines: Lines) -> Lines:
        assert old.encode() in lines[at]
        return [*lines[:at], lines[at].replace(old.encode(), new.encode(), 1), *lines[at + 1 :]]

    return change


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (changed(1, '"verdict":"fail"', '"verdict":"pass"'), 2),
        (changed(0, '"steps":7', '"steps":8'), 1),
        (changed(2, '"kind":"record"', '"kind":"record","note":"sound"'), 3),
        (changed(3, '"records":3', '"records":2'), 4),
        (changed(1, '"schema":1', '"schema":2'), 2),
        (changed(1, "{", "["), 2),
        (lambda lines: lines[1:], 1),
        (lambda lines: [lines[0], *lines[2:]], 2),
        (lambda lines: [lines[0], lines[2], lines[1], lines[3]], 2),
        (lambda lines: [*lines[:2], lines[1], *lines[2:]], 3),
        (lambda lines: lines[:-1], 3),
        (lambda lines: [*lines, lines[0]], 5),
        (lambda lines: [], 0),
    ],
    ids=[
        "verdict", "number", "addition", "count", "schema", "no JSON", "first gone", "one gone", "moved", "twice",
        "cut off", "more", "nothing",
    ],
)  # fmt: skip
def test_whatever_is_done_to_a_file_shows(
    file: Path, invoke: Invoke, change: Callable[[Lines], Lines], line: int
) -> None:
    file.write_bytes(b"".join(change(file.read_bytes().splitlines(keepends=True))))
    result = invoke("reverify", file)
    assert result.exit_code == 2, result.output
    assert f"line {line}" in result.stderr
    assert len(result.stderr.splitlines()) == 1


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
    # As it comes back from a corpus.
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


def test_drift_is_told_by_check_evidence_and_traces() -> None:
    recorded, told = known("EC107")
    assert drift(recorded, told) == ([], [])
    assert drift(recorded, msgspec.structs.replace(told, seconds=9.0, steps=7)) == ([], [])
    assert drift(recorded, msgspec.structs.replace(told, traces="u")) == ([], ["other traces"])
    assert drift(recorded, known("EC301")[1]) == ([], ["api with other evidence"])
    assert drift(recorded, known()[1]) == (["pass, was fail", "api pass, was fail"], [])
    assert drift(recorded, msgspec.structs.replace(told, checks=[])) == (["api not run, was fail"], [])
    # Of a verdict from before there were digests of traces.
    assert drift(known("EC107", traces="")[0], told) == ([], [])


@pytest.mark.parametrize(("codes", "unsteady"), [((), False), (("EC107", "EC209"), False), (("EC203",), True)])
def test_what_is_not_deterministic_may_differ_in_traces(codes: tuple[str, ...], unsteady: bool) -> None:
    assert known(*codes)[0].unsteady is unsteady


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
    """Make it a whole file again, in which the records say something else."""
    lines = [change(line) for change, line in zip(changes, read(str(path)), strict=True)]
    path.write_bytes(b"".join(encode(line) for line in chain(lines)))


def test_a_corpus_is_recorded_and_judged_again(games: Path, invoke: Invoke) -> None:
    assert invoke("audit", "games", *QUICK).exit_code == 1
    database = (games / ".envcraft" / "corpus.sqlite").read_bytes()
    written = invoke("corpus", "records", "games", "--output", "games/records.jsonl")
    assert written.exit_code == 0
    file = games / "records.jsonl"
    digest = json.loads(file.read_text().splitlines()[-1])["digest"]
    assert written.stderr == f"2 records; the digest of all is {digest}\n"
    assert invoke("corpus", "records", "games").stdout == file.read_text()
    assert invoke("corpus", "records", "nowhere", "--output", "games/records.jsonl").exit_code == 2
    assert json.loads(file.read_text().splitlines()[-1])["digest"] == digest

    # From the corpus, from the files beside the records, and from the corpus beside.
    again = invoke("reverify", "games")
    assert (again.exit_code, again.stdout) == (
        0,
        "2 of 2 records judged again: 2 as recorded, 0 drifted, 0 could not be judged\n",
    )
    (games / "a.py").write_text("changed\n")
    refused = invoke("reverify", "games/records.jsonl")
    assert refused.exit_code == 2
    assert "--sandbox process judges there again" in refused.stderr
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


def test_wrong_use_is_told_in_a_sentence(games: Path, invoke: Invoke) -> None:
    invoke("corpus", "init", "corpus")
    for arguments, words in (
        (["none.jsonl"], "cannot be read"),
        (["games"], "is no corpus"),
        (["games/a.py"], "line 1 is no record"),
        (["corpus"], "has no verdict to repeat"),
        (["corpus", "--corpus", "corpus"], "leave out --corpus"),
    ):
        result = invoke("reverify", *arguments)
        assert result.exit_code == 2, result.output
        assert words in result.stderr
