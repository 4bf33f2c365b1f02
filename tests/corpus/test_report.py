"""Reports on a corpus: their numbers match the database, text stays text, and a report is complete or absent."""

from __future__ import annotations

import csv
import hashlib
import importlib.util
import json
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.report import data, media, output
from envcraft.corpus.report.data import Entry, Measure, outliers
from envcraft.corpus.report.facets import Facets, values
from envcraft.corpus.report.generated import generation_stages
from envcraft.corpus.report.write import preview_contracts
from envcraft.corpus.store import Environment, Store, decode, generation
from envcraft.corpus.store.generation import ConceptRow, OutcomeRow
from envcraft.corpus.verify import verify
from envcraft.errors import UsageError
from envcraft.judging.engine import Plan
from envcraft.judging.statistics import Proportion
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Event, SubjectFinished
from envcraft.model.verdict import CheckReport, SubjectReport, Verdict, overall
from envcraft.text import one_line
from evaluation.drivers import IdleDriver

from .conftest import ENVIRONMENT, QUICK, SETTINGS, Invoke, judged, source
from .conftest import report as report_on
from .reported import CHECKS, HOSTILE, SIZE


@pytest.fixture(scope="module")
def corpus(reported: tuple[Path, Path]) -> Path:
    return reported[0]


@pytest.fixture(scope="module")
def site(reported: tuple[Path, Path]) -> Path:
    return reported[1]


@pytest.fixture(scope="module")
def reports(corpus: Path) -> dict[str, SubjectReport | None]:
    """The rows of the database by name."""
    with Store(corpus) as store:
        rows = store.db.execute(
            "SELECT name, report FROM environments LEFT JOIN verdicts ON verdicts.id = environments.verdict "
            "ORDER BY name"
        ).fetchall()
    return {name: None if text is None else decode(text) for name, text in rows}


def table(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def numbers_of(reports: dict[str, SubjectReport | None]) -> list[tuple[str, int, int]]:
    """Each check with the number that passed all earlier checks, and how many of these passed it."""
    left = [report for report in reports.values() if report is not None]
    found = []
    for check in CHECKS:
        kept = [
            report for report in left if next(c.verdict for c in report.checks if c.check == check) in ("pass", "skip")
        ]
        found.append((check, len(left), len(kept)))
        left = kept
    return found


class Parsed(HTMLParser):
    """Tags, attributes, and the cells of the table in each section."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.section = ""
        self.data: list[str] | None = None
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag == "section":
            self.section = dict(attrs).get("id") or ""
        if tag == "tr":
            self.tables.setdefault(self.section, []).append([])
        if tag in ("td", "th"):
            self.data = []

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th") and self.data is not None:
            self.tables[self.section][-1].append("".join(self.data).strip())
            self.data = None

    def handle_data(self, data: str) -> None:
        if self.data is not None:
            self.data.append(data)


def script(path: Path) -> Any:
    """The data that a script passes on."""
    found = re.fullmatch(r'envcraft\("(\w+)",(\d+),(.*)\);\n', path.read_text("utf-8"), re.DOTALL)
    assert found is not None
    assert path.name == f"{found[1]}-{found[2]}.js"
    return json.loads(found[3])


def test_the_stages_are_those_of_the_database(site: Path, reports: dict[str, SubjectReport | None]) -> None:
    expected = numbers_of(reports)
    assert [left for _, _, left in expected] != sorted({left for _, _, left in expected})
    rows = table(site / "stages.csv")
    assert [(row["stage"], int(row["input"]), int(row["output"])) for row in rows] == expected
    assert json.loads((site / "report.json").read_text())["stages"][1]["input"] == expected[1][1]
    shown = Parsed((site / "index.html").read_text("utf-8")).tables["cascade"]
    assert [(row[0], int(row[1]), int(row[5])) for row in shown[1:-1]] == expected
    for row, line in zip(rows, shown[1:-1], strict=True):
        passed, failed = int(row["output"]) - int(row["skipped"]), int(row["failed"])
        rate = passed / (passed + failed)
        assert float(row["pass_rate"]) == pytest.approx(rate)
        assert float(row["low"]) < rate <= float(row["high"])
        assert line[6] == f"{rate:.1%}"
    # Wilson's interval at 95%, computed by hand.
    n = int(rows[1]["output"]) - int(rows[1]["skipped"]) + int(rows[1]["failed"])
    p, z = float(rows[1]["pass_rate"]), 1.959964
    middle, half = p + z * z / (2 * n), z * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
    assert float(rows[1]["low"]) == pytest.approx((middle - half) / (1 + z * z / n))


def test_rates_exclude_unjudged_and_skipped() -> None:
    def entry(number: int, *verdicts: Verdict) -> data.Entry:
        checks = [CheckReport(name, verdict) for name, verdict in zip(("source", "api"), verdicts, strict=False)]
        report = SubjectReport("a.py", None, "0" * 64, overall(checks), "process", 1.0, 10, checks)
        return data.Entry(number, Environment(f"{number}.py", "0" * 64, ""), {}, "", None, report)

    survey = data.Survey(["source", "api"])
    ways = [(), (Verdict.PASS,), (Verdict.PASS, Verdict.SKIP), (Verdict.PASS, Verdict.PASS), (Verdict.FAIL,)]
    for number, way in enumerate(ways):
        survey.take(entry(number, *way), 1)
    first, second = survey.stages()
    assert (first.entered, first.unjudged, first.failed, first.left) == (5, 1, 1, 3)
    assert (first.rate.hits, first.rate.n) == (3, 4)
    assert (second.entered, second.unjudged, second.skipped, second.left) == (3, 1, 1, 2)
    assert (second.rate.hits, second.rate.n) == (1, 1)


def test_verdicts_and_codes_are_those_of_the_database(
    site: Path, corpus: Path, reports: dict[str, SubjectReport | None]
) -> None:
    told = json.loads((site / "report.json").read_text())
    assert told["verdicts"] == Counter(report.verdict if report else "none" for report in reports.values())
    with Store(corpus) as store:
        codes = store.db.execute(
            "SELECT code, count(DISTINCT verdict), count(*) FROM findings GROUP BY code ORDER BY 2 DESC, 1"
        ).fetchall()
    assert [(row["code"], row["environments"], row["findings"]) for row in told["codes"]] == codes
    assert [(row["code"], int(row["findings"])) for row in table(site / "codes.csv")] == [(c, n) for c, _, n in codes]
    checks = {row["check"]: row for row in told["checks"]}
    failing = sum(report is not None and report.checks[1].verdict == "fail" for report in reports.values())
    assert checks["api"]["fail"] == failing
    attempts = {row["attempt"]: row for row in told["attempts"]}
    odd = [(int(name[9:13]), report) for name, report in reports.items() if report and name != HOSTILE]
    for attempt in range(3):
        of_it = [report for number, report in odd if number % 2 and number % 3 == attempt]
        assert attempts[attempt]["passed"] == sum(report.verdict == "pass" for report in of_it)
        assert attempts[attempt]["judged"] == len(of_it)


def test_tables_read_back(site: Path, reports: dict[str, SubjectReport | None]) -> None:
    told = json.loads((site / "environments.json").read_text())
    assert [row["name"] for row in told] == list(reports)
    assert {row["name"]: row["verdict"] for row in told} == {n: r.verdict if r else "none" for n, r in reports.items()}
    assert next(row for row in told if row["name"] == HOSTILE)["origin"] == {"words": HOSTILE}
    rows = table(site / "environments.csv")
    # A spreadsheet evaluates text that starts with "=".
    assert [row["name"].removeprefix("'") for row in rows] == list(reports)
    assert f"'{HOSTILE}" in [row["name"] for row in rows]
    messages = [row["message"] for row in table(site / "findings.csv")]
    findings = [f.message for r in reports.values() if r for c in r.checks for f in c.findings]
    assert [words.removeprefix("'") for words in messages] == findings


def test_scripts_have_every_environment(site: Path, reports: dict[str, SubjectReport | None]) -> None:
    rows = [row for part in range(2) for row in script(site / "data" / f"rows-{part}.js")]
    assert [row[0] for row in rows] == [one_line(name) for name in reports]
    assert not (site / "data" / "rows-2.js").exists()
    for number, (name, report) in enumerate(reports.items()):
        if number % 100 and name != HOSTILE:
            continue
        about = next(a for a in script(site / "data" / f"about-{rows[number][8]}.js") if a["number"] == number)
        assert about["name"] == one_line(name)
        assert len(about["findings"]) == sum(len(check.findings) for check in report.checks) if report else True
        assert "import gymnasium" in about["source"]
        assert about["command"].startswith("envcraft validate ")
        assert not report or json.loads(about["record"])["verdict"] == report.verdict
    assert [number for number, row in enumerate(rows) if row[7]] == [
        int(file.stem) for file in (site / "media").rglob("*.webp")
    ]


def test_hostile_words_stay_words(site: Path) -> None:
    plain = Parsed((site / "index.html").read_text("utf-8"))
    listed = Parsed((site / "environments.html").read_text("utf-8"))
    # Besides the scripts of the site, there is one with data.
    for page, inline in ((plain, 0), (listed, 1)):
        sources = [value for name, value in page.attributes if name == "src" and value.endswith(".js")]
        assert page.tags["script"] == len(sources) + inline
        assert all((site / source).is_file() for source in sources)
    for page in (plain, listed):
        assert not [name for name, _ in page.attributes if name.startswith("on") or name == "style"]
        loaded = [value for name, value in page.attributes if name in ("src", "href")]
        assert not [value for value in loaded if ":" in value and not value.startswith("data:,")]
        assert "default-src 'none'" in dict(page.attributes)["content"] or any(
            "default-src 'none'" in value for name, value in page.attributes if name == "content"
        )
    assert not re.search("[\u202a-\u202e]", "".join(file.read_text("utf-8") for file in (site / "data").iterdir()))


def measure(*values: float) -> Measure:
    made = Measure("steps", "")
    for number, value in enumerate(values):
        made.take(number, value)
    return made


def test_outliers() -> None:
    spread = [float(value) for value in range(90, 111)]
    assert [(found.number, found.times > 1) for found in outliers(measure(*spread, 1000.0, 9.0))] == [
        (21, True),
        (22, False),
    ]
    seconds = msgspec.structs.replace(measure(*spread, 1000.0, 9.0), low=False)
    assert [found.times > 1 for found in outliers(seconds)] == [True]
    assert not list(outliers(measure(*spread)))
    # Few values, all but one the same, or far in units of the spread but hardly larger than the others.
    assert not list(outliers(measure(*spread[:6], 1000.0)))
    assert not list(outliers(measure(*[100.0] * 20, 1000.0)))
    assert not list(outliers(measure(*(100 + number / 1000 for number in range(20)), 120.0)))


def test_the_planted_outlier_is_found(site: Path) -> None:
    told = json.loads((site / "report.json").read_text())["outliers"]
    assert ("games/env0033.py", "seconds") in [(found["name"], found["measure"]) for found in told]


def test_copies_are_named_and_counted(site: Path) -> None:
    told = json.loads((site / "report.json").read_text())
    (cluster,) = told["clusters"]
    copies = [f"games/env{number:04}.py" for number in (100, 101, 102)]
    assert sorted(cluster["members"]) == copies
    assert {layer["name"]: layer["clusters"] for layer in told["layers"]}["exact"] == 1
    rows = {row["name"]: row["cluster"] for row in table(site / "environments.csv")}
    assert [name for name, number in rows.items() if number] == copies
    listed = script(site / "data" / "rows-0.js")
    row = next(row for row in listed if row[0] == copies[1])
    about = next(a for a in script(site / "data" / f"about-{row[8]}.js") if a["name"] == copies[1])
    assert sorted(listed[number][0] for number in about["duplicates"]) == [copies[0], copies[2]]
    assert about["layers"] == cluster["layers"]
    shown = (site / "index.html").read_text("utf-8")
    assert f"{SIZE - 2} environments remain if one of each cluster is kept" in shown
    assert "and 2 more" in shown


def test_the_map_puts_like_beside_like(tmp_path: Path) -> None:
    from envcraft.corpus.report.embedding import Embedding

    embedding = Embedding()
    families = ("import pygame\nclass Paddle: ball = bounce = 1", "import numpy\nclass Maze: wall = door = key = 2")
    for number in range(12):
        text = f"{families[number % 2]}\nlevel_{number} = {number}\n"
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        embedding.add(data.Entry(number, Environment(f"{number}.py", sha256, ""), {}, "", None, None), text)
    points = embedding.points()
    assert [point.number for point in points] == list(range(12))
    assert all(0 <= value <= 1 for point in points for value in (point.x, point.y))
    sides = {number: {round(point.x) for point in points if point.number % 2 == number} for number in (0, 1)}
    assert sides in ({0: {0}, 1: {1}}, {0: {1}, 1: {0}})
    assert points == embedding.points()


# The folder


def test_a_report_that_is_not_finished_leaves_the_old_one(tmp_path: Path) -> None:
    place = tmp_path / "report"
    with output.replaced(place) as made:
        (made / "report.json").write_text("old")

    def interrupted(error: type[BaseException]) -> None:
        with output.replaced(place) as made:
            (made / "report.json").write_text("half")
            raise error

    for error in (KeyboardInterrupt, ValueError):
        with pytest.raises(error):
            interrupted(error)
    assert (place / "report.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["report"]
    with output.replaced(place) as made:
        (made / "report.json").write_text("new")
    assert (place / "report.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["report"]


def test_a_killed_writer_leaves_the_old_one_and_the_next_clears_up(tmp_path: Path) -> None:
    place = tmp_path / "report"
    with output.replaced(place) as made:
        (made / "report.json").write_text("old")
    program = (
        "import os, pathlib; from envcraft.corpus.report.output import replaced\n"
        f"with replaced(pathlib.Path({str(place)!r})) as made:\n"
        "    (made / 'report.json').write_text('half'); os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -signal.SIGKILL
    assert (place / "report.json").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 2
    with output.replaced(place) as made:
        (made / "report.json").write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["report"]


def test_one_that_was_killed_between_the_renames_is_put_back(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    (tmp_path / f".report.old-{process.pid}").mkdir()
    (tmp_path / f".report.old-{process.pid}" / "report.json").write_text("old")
    with pytest.raises(ValueError, match="oops"), output.replaced(tmp_path / "report"):
        raise ValueError("oops")
    assert (tmp_path / "report" / "report.json").read_text() == "old"


def test_only_a_report_is_replaced(store: Store, invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    # A file that `audit --format json --output` may have written.
    (tmp_path / "mine" / "report.json").write_text("{}")
    (tmp_path / "file").write_text("")
    for place in ("mine", "file"):
        result = invoke("corpus", "report", store.root, "--output", place, "--no-previews")
        assert result.exit_code == 2
        assert place in result.output
    assert (tmp_path / "mine" / "letter.txt").read_text() == "dear"

    with output.replaced(tmp_path / "site") as made:
        (made / "index.html").write_text("")
    output.check_usable(tmp_path / "site")
    (tmp_path / "site" / "letter.txt").write_text("dear")
    with pytest.raises(UsageError, match=r"contains letter\.txt, which does not belong to a report"):
        output.check_usable(tmp_path / "site")


def test_what_is_not_installed_is_named_first(invoke: Invoke, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else found(name))
    result = invoke("audit", tmp_path / "nowhere", "--report", "report")
    assert result.exit_code == 2
    assert "matplotlib" in result.output
    assert "pip install 'envcraft-rl[report]'" in result.output


def test_without_verdicts_there_is_a_report(invoke: Invoke, tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as made:
        made.add("ant", b"import gymnasium\n")
        # Reading needs no lock, so an audit may be running.
        result = invoke("corpus", "report", made.root, "--output", "report", "--no-previews")
    assert result.exit_code == 0, result.output
    assert "none of which has a verdict" in (tmp_path / "report" / "index.html").read_text()


# Pictures


def frames(count: int, height: int = 84, width: int = 84, noise: bool = False) -> list[np.ndarray[Any, Any]]:
    generator = np.random.default_rng(0)
    if noise:
        return [generator.integers(0, 256, (height, width, 3), np.uint8) for _ in range(count)]
    return [np.full((height, width, 3), number * 3, np.uint8) for number in range(count)]


def opened(data: bytes) -> np.ndarray[Any, Any]:
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def test_previews_are_strips_of_bounded_size() -> None:
    strip = opened(media.encode(frames(61)))
    assert strip.shape == (84 * 12, 84, 3)
    assert [int(strip[84 * number, 0, 0]) // 3 for number in range(12)] == [
        0,
        5,
        11,
        16,
        22,
        27,
        33,
        38,
        44,
        49,
        55,
        60,
    ]
    assert opened(media.encode(frames(1))).shape == (84, 84, 3)
    wide = opened(media.encode([np.full((200, 400, 3), 200, np.uint8)]))
    assert wide.shape == (84, 84, 3)
    assert (wide[:20] == 0).all()
    assert (wide[22:62] == 200).all()
    for shape in ((84, 84), (3, 250), (600, 400)):
        assert len(media.encode(frames(61, *shape, noise=True))) <= media.MAX_BYTES


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A game that passes, one that fails but plays, and one that cannot be imported."""
    games = tmp_path / "games"
    games.mkdir()
    (games / "good.py").write_text(ENVIRONMENT.replace("CRASH", "-1"))
    (games / "late.py").write_text(ENVIRONMENT.replace("CRASH", "8"))
    (games / "none.py").write_text("import gymnasium\nimport nothing_of_the_kind\nclass A(gymnasium.Env): pass\n")
    return games


def test_an_audit_writes_a_report_with_pictures(folder: Path, invoke: Invoke, tmp_path: Path) -> None:
    result = invoke("audit", folder, *QUICK, "--report", "report")
    assert result.exit_code == 1, result.output
    assert "2 environments played for previews" in result.stderr
    site = tmp_path / "report"
    rows = script(site / "data" / "rows-0.js")
    assert [(row[0], row[7]) for row in rows] == [("good.py", 1), ("late.py", 1), ("none.py", 0)]
    assert opened((site / "media" / "0" / "0.webp").read_bytes()).shape[1] == 84
    about = script(site / "data" / "about-0.js")
    options = "--budget quick --checks source,api,sandbox --format json --output report.json"
    assert about[0]["command"] == f"envcraft validate {folder}/good.py {options}"
    # Known pictures are reused; a lost one is played again.
    again = invoke("corpus", "report", folder, "--output", "report", "--sandbox", "process")
    assert again.exit_code == 0, again.output
    assert "played" not in again.stderr
    with Store(folder, write=True) as store:
        file = media.files(store)[0]
        file.write_bytes(b"torn")
        (store.root / "media" / "stray.webp").write_bytes(b"")
        assert len(list(verify(store))) == 2
        assert all(damage.done for damage in verify(store, repair=True))
        assert list(verify(store)) == []
    assert (
        "1 environment played"
        in invoke("corpus", "report", folder, "--output", "report", "--sandbox", "process").stderr
    )
    (folder / "late.py").unlink()
    invoke("audit", folder, *QUICK, "--report", "report")
    with Store(folder) as store:
        assert len(media.files(store)) == 2
    (folder / "good.py").write_text(ENVIRONMENT.replace("CRASH", "-2"))
    invoke("audit", folder, *QUICK, "--report", "report")
    with Store(folder) as store:
        (kept,) = media.files(store)
        assert store.db.execute("SELECT media FROM previews").fetchall() == [(kept.stem,)]


def test_pictures_are_played_under_the_contract_that_was_judged(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """ant and bee under arcade, cat under another contract, dog without a verdict, eel under an unknown contract."""
    known = Environment("cat", hashlib.sha256(source("cat")).hexdigest(), "")
    store.record(known, store.settings(msgspec.structs.replace(SETTINGS, contract="gymnasium")), report_on("cat"))
    judged(store, "eel")
    gone = Environment("eel", hashlib.sha256(source("eel")).hexdigest(), "")
    store.record(gone, store.settings(msgspec.structs.replace(SETTINGS, contract="gone")), report_on("eel"))
    played: list[tuple[str, str]] = []

    def stream(plan: Plan, workers: int | None, pool: WorkerPool) -> Iterator[tuple[int, Event]]:
        for number, target in enumerate(plan.targets, 1):
            played.append((plan.contract.name, target.path))
            yield number, SubjectFinished(report_on(target.path))

    monkeypatch.setattr(media, "stream", stream)
    notes: list[str] = []
    for _ in range(2):
        for promised in preview_contracts(store, ARCADE, notes):
            media.make(store, promised, ARCADE.name, IdleDriver())
    assert played == [("arcade", "ant"), ("arcade", "bee"), ("arcade", "dog"), ("gymnasium", "cat")]
    assert notes[0].startswith("Previews of 1 environment are missing: there is no contract 'gone'")


def test_no_previews_plays_nothing(store: Store, invoke: Invoke, tmp_path: Path) -> None:
    judged(store, "eel")
    result = invoke("corpus", "report", store.root, "--output", "report", "--no-previews")
    assert result.exit_code == 0, result.output
    assert not (tmp_path / "report" / "media").exists()


def test_what_is_not_a_corpus_is_refused(invoke: Invoke, tmp_path: Path) -> None:
    result = invoke("corpus", "report", tmp_path, "--output", "report", "--no-previews")
    assert result.exit_code == 2
    assert "is not a corpus" in result.output


def test_the_corpus_is_the_size_that_the_tests_suppose(reports: dict[str, SubjectReport | None]) -> None:
    assert len(reports) == SIZE


def test_facets_are_listed_in_the_order_of_stages_and_of_numbers() -> None:
    facets = Facets(["viability", "code"])
    for stage, difficulty in (("all passed", "chosen 0.5 to 0.75"), ("code", "EC804"), ("viability", "as promised")):
        facets.row({"stage": [stage], "difficulty": [difficulty], "attempts": ["10" if stage == "code" else "9"]})
    listed = {facet["name"]: [facet["words"][place] for place in facet["order"]] for facet in facets.legend()}
    assert listed["stage"] == ["viability", "code", "all passed"]
    assert listed["attempts"] == ["9", "10"]


def test_stages_of_generation_filter_concepts(tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as store:
        generation.add_concepts(store, [ConceptRow(f"c{number}", "", "", {}) for number in range(5)])
        for number, (stage, result, reason) in enumerate(
            [
                *[("viability", "passed", "")] * 3,
                ("viability", "rejected", "vague: it has no goal"),
                ("viability", "rejected", "vague: it has no end"),
                ("code", "passed", ""),
                ("code", "failed", "<b>no code"),
            ]
        ):
            generation.put_outcome(store, OutcomeRow(f"c{number % 5}", stage, result, reason, {}))
        first, second = generation_stages(store, ["viability", "code"])
    assert (first.filter.name, first.filter.entered, first.filter.left) == ("viability", 5, 3)
    assert (first.rate, first.reasons) == (Proportion(3, 5), [("vague", 2)])
    # A concept that is still in work is in no outcome.
    assert (second.filter.entered, second.filter.failed, second.filter.unjudged, second.filter.left) == (2, 0, 1, 1)
    assert second.reasons == [("<b>no code", 1)]


def test_a_family_gives_facets_of_its_axes() -> None:
    axes = {"goal": "meals", "size": [10, 14], "difficulty": 0.76, "board": {"shape": "ring", "walls": [], "hole": ""}}
    entry = Entry(0, Environment("a.py", "0" * 64, ""), {"family": "snake", "axes": axes}, "", None, None)
    assert values(entry, None) == {
        "family": ["snake"],
        "mechanic": ["goal: meals", "board shape: ring"],
        "difficulty": ["chosen 0.75 to 1"],
    }
