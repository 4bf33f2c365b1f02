"""``envcraft export --to hf`` and ``--to site``: the tests read the files and compare them with the corpus."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import sys
from pathlib import Path
from typing import Any

import markdown_it
import pytest
import yaml

from envcraft.corpus.deduplication import groups_of
from envcraft.corpus.export import shards
from envcraft.corpus.export.exporter import Exporter, Order
from envcraft.corpus.export.hf import COLUMNS, DatasetExporter
from envcraft.corpus.store import CorpusDamaged, Environment, Store, decode
from envcraft.errors import UsageError
from envcraft.judging.statistics import Proportion

from .conftest import SETTINGS, Invoke, judged, source
from .reported import fill
from .reported import source as program

#: The path of the example plugin, which is not installed here.
FILES = Path(__file__).parents[1] / "plugin_package" / "src" / "envcraft_lantern" / "files.py"


def rows_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of each split in the files."""
    found: dict[str, list[dict[str, Any]]] = {}
    from pyarrow import parquet

    for file in sorted((folder / "data").iterdir()):
        found.setdefault(file.name.partition("-")[0], []).extend(parquet.read_table(file).to_pylist())
    return found


def front(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((folder / "README.md").read_text().split("---\n")[1])
    return found


def exported(corpus: Path, folder: Path) -> Path:
    """A data set of the whole corpus in small files and row groups."""
    with pytest.MonkeyPatch.context() as patch, Store(corpus) as store:
        patch.setattr(shards, "_ROWS", 20)
        patch.setattr(shards, "_FILE", 40_000)
        DatasetExporter().export(Order(store, folder, everything=True))
    return folder


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("published") / "games"
    with Store.create(root) as store:
        fill(store, 140)
        for number in range(20, 40):
            # With this many, none stays together by chance.
            store.add(f"copies/{number}.py", program(number) + b"# a copy\n")
    return root


@pytest.fixture(scope="module")
def dataset(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(corpus, tmp_path_factory.mktemp("dataset") / "made")


def test_every_row_is_as_in_the_corpus(corpus: Path, dataset: Path) -> None:
    rows = {row["name"]: row for part in rows_of(dataset).values() for row in part}
    with Store(corpus) as store:
        wanted = {
            environment.name: environment for environment in Order(store, dataset, everything=True).environments()
        }
        assert sorted(rows) == sorted(wanted)
        assert len(rows) == 160
        for name, row in rows.items():
            assert list(row) == [column for column, *_ in COLUMNS]
            environment = wanted[name]
            assert row["source"].encode() == store.source(environment.source)
            assert hashlib.sha256(row["source"].encode()).hexdigest() == row["sha256"]
            assert json.loads(row["origin"]) == environment.origin
            assert (row["verdict"], row["report"]) == (environment.verdict, environment.report)
            if environment.report is None:
                assert row["codes"] is row["checks"] is row["steps"] is row["contract"] is row["image"] is None
                continue
            told = json.loads(environment.report)
            findings = {finding["code"] for check in told["checks"] for finding in check["findings"]}
            assert row["codes"] == sorted(findings)
            assert [(check["name"], check["verdict"], check["reason"]) for check in row["checks"]] == [
                (check["check"], check["verdict"], check["reason"]) for check in told["checks"]
            ]
            assert (row["class"], row["steps"], row["seconds"]) == (told["env_class"], told["steps"], told["seconds"])
            columns = ("contract", "contract_sha256", "rules", "seed", "budget", "sandbox", "image")
            assert tuple(row[column] for column in columns) == tuple(
                getattr(SETTINGS, "driver" if column == "sandbox" else column) for column in columns
            )
    assert sum(row["verdict"] is None for row in rows.values()) == 21


def test_splits_never_cut_a_group(corpus: Path, dataset: Path) -> None:
    rows = rows_of(dataset)
    assert {name: len(part) for name, part in rows.items()} == {"train": 128, "validation": 16, "test": 16}
    group = {row["name"]: row["group"] for part in rows.values() for row in part}
    split = {row["name"]: name for name, part in rows.items() for row in part}
    with Store(corpus) as store:
        groups = groups_of(store)
    assert any(len(members) == 3 for members in groups)
    for members in groups:
        assert len({group[name] for name in members}) == len({split[name] for name in members}) == 1
    assert len(set(group.values())) == len(groups)


def test_the_same_corpus_gives_the_same_files(corpus: Path, dataset: Path, tmp_path: Path) -> None:
    """The result does not depend on the order in which environments were added."""
    with Store(corpus) as old, Store.create(tmp_path / "games") as new:
        settings = new.settings(SETTINGS)
        for environment in reversed(list(Order(old, tmp_path, everything=True).environments())):
            new.add(environment.name, old.source(environment.source), environment.env_class, environment.origin)
            if environment.report is not None:
                key = Environment(environment.name, environment.source, environment.env_class)
                new.record(key, settings, decode(environment.report))
    files = [
        {path.relative_to(made): path.read_bytes() for path in made.rglob("*") if path.is_file()}
        for made in (dataset, exported(tmp_path / "games", tmp_path / "made"))
    ]
    assert files[0] == files[1]


def test_files_and_row_groups_stay_small(dataset: Path) -> None:
    from pyarrow import parquet

    files = sorted((dataset / "data").glob("train-*"))
    assert len(files) > 1
    assert [file.name for file in files] == [
        f"train-{number:05}-of-{len(files):05}.parquet" for number in range(len(files))
    ]
    for file in files:
        metadata = parquet.read_metadata(file)
        assert all(metadata.row_group(number).num_rows <= 20 for number in range(metadata.num_row_groups))


def test_datasets_loads_it(dataset: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in (
        ("HF_HUB_OFFLINE", "1"),
        ("HF_HOME", str(tmp_path)),
        ("HF_DATASETS_DISABLE_PROGRESS_BARS", "1"),
    ):
        monkeypatch.setenv(name, value)
    from datasets import load_dataset

    loaded = load_dataset(str(dataset), cache_dir=str(tmp_path / "cache"))
    rows = rows_of(dataset)
    assert sorted(loaded) == sorted(rows)
    for name, part in rows.items():
        assert loaded[name].to_list() == part


def test_what_the_card_says(corpus: Path, dataset: Path) -> None:
    told = front(dataset)
    assert told["size_categories"] == ["n<1K"]
    assert told["configs"][0]["data_files"][0] == {"split": "train", "path": "data/train-*.parquet"}
    assert "license" not in told
    text = (dataset / "README.md").read_text()
    assert "No licence is stated for the sources" in text
    assert not re.search(r"@[A-Z]+@", text)
    with Store(corpus) as store:
        verdicts = dict(store.db.execute("SELECT verdict, count(*) FROM verdicts GROUP BY verdict"))
        api = store.db.execute("SELECT count(DISTINCT verdict) FROM findings WHERE code = 'EC107'").fetchone()[0]
    rate = Proportion(verdicts["pass"], verdicts["pass"] + verdicts["fail"])
    assert f"{rate.estimate:.1%} passed (interval {rate.low:.1%} to {rate.high:.1%})" in text
    share = Proportion(api, 139)
    assert f"| {api} | {share.estimate:.1%} | {share.low:.1%} to {share.high:.1%} |" in text
    # 100, 101 and 102 are the same program with different comments.
    assert re.search(r"^\| exact \| 160 \| 21 \| 22 \|$", text, re.MULTILINE)


def test_words_of_a_corpus_are_text_in_the_card(store: Store, tmp_path: Path) -> None:
    words = '<img src=x> [a](http://b.invalid) | `c` **d** "\n# e'
    store.db.execute("UPDATE settings SET image = ?", (words,))
    order = Order(store, tmp_path / "made", words, licence=words)
    DatasetExporter().export(order)
    told = front(tmp_path / "made")
    assert told["pretty_name"] == told["license_name"] == " ".join(words.split())
    assert told["license"] == "other"
    body = (tmp_path / "made" / "README.md").read_text().split("---\n", 2)[2]
    page = markdown_it.MarkdownIt("gfm-like").render(body)
    assert page.count(html := "&lt;img src=x&gt; [a](") == 3, html
    assert "<img" not in page
    assert "<strong>d" not in page


def test_only_what_has_passed_unless_all_is_wanted(store: Store, invoke: Invoke, tmp_path: Path) -> None:
    store.db.execute("""UPDATE environments SET origin = '{"file": "/home/me/ant.py", "model": "m"}'""")
    store.close()
    result = invoke("export", "corpus", "--to", "hf", "--output", "made", "--name", "Games")
    assert result.exit_code == 0, result.output
    assert result.output.startswith("made has 1 environment: train 1")
    (rows,) = rows_of(tmp_path / "made").values()
    assert [(row["name"], row["origin"]) for row in rows] == [("ant", '{"model": "m"}')]
    assert [part["split"] for part in front(tmp_path / "made")["configs"][0]["data_files"]] == ["train"]
    assert invoke("corpus", "rm", "corpus", "ant").exit_code == 0
    result = invoke("export", "corpus", "--to", "hf", "--output", "none")
    assert (result.exit_code, "has passed all checks" in result.output) == (2, True)
    assert not (tmp_path / "none").exists()


def test_sources_that_are_not_utf8_are_skipped_and_counted(store: Store, tmp_path: Path) -> None:
    store.add("latin", b"# -*- coding: latin-1 -*-\n# \xe4\n")
    store.add("marked", b"\xef\xbb\xbfimport gymnasium\r\n")
    told = DatasetExporter().export(Order(store, tmp_path / "made", everything=True))
    assert told[0] == "skipped sources that are not UTF-8: 1"
    assert "not UTF-8: 1." in (tmp_path / "made" / "README.md").read_text()
    rows = {row["name"]: row for part in rows_of(tmp_path / "made").values() for row in part}
    assert set(rows) == {"ant", "bee", "cat", "dog", "marked"}
    assert rows["marked"]["source"].encode() == b"\xef\xbb\xbfimport gymnasium\r\n"


@pytest.mark.parametrize(
    ("origins", "said", "licence", "words"),
    [
        ({"ant": {"licence": "MIT"}, "bee": {"license": "mit"}}, None, "mit", "licensed under MIT."),
        ({"ant": {"licence": "MIT"}}, None, None, "licences are: MIT (1), none (1)."),
        ({"ant": {"licence": "MIT"}, "bee": {"licence": "isc"}}, None, None, "licences are: MIT (1), isc (1)."),
        ({"ant": {"licence": ""}, "bee": {"licence": 3}}, None, None, "No licence is stated"),
        ({}, "Apache-2.0", "apache-2.0", "licensed under Apache-2.0."),
        ({"ant": {"licence": "mit"}, "bee": {"licence": "MIT"}}, "MIT", "mit", "licensed under MIT."),
        ({"ant": {"licence": "mit"}}, "isc", UsageError, "--licence is isc, but the corpus states mit"),
        ({}, "Our own", "other", "licensed under Our own."),
    ],
)
def test_licences(
    store: Store, tmp_path: Path, origins: dict[str, Any], said: str | None, licence: Any, words: str
) -> None:
    """The licence is stated if it is known, and never invented."""
    store.db.execute("DELETE FROM environments WHERE name NOT IN ('ant', 'bee')")
    for name, origin in origins.items():
        store.db.execute("UPDATE environments SET origin = ? WHERE name = ?", (json.dumps(origin), name))
    order = Order(store, tmp_path / "made", everything=True, licence=said)
    if licence is UsageError:
        with pytest.raises(UsageError, match=words):
            DatasetExporter().export(order)
        assert not (tmp_path / "made").exists()
        return
    DatasetExporter().export(order)
    assert front(tmp_path / "made").get("license") == licence
    assert words in (tmp_path / "made" / "README.md").read_text()


@pytest.mark.parametrize("module", ["pyarrow", "rensa"])
def test_without_a_library_it_says_what_to_install(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=rf"needs {module}: pip install 'envcraft-rl\[publish\]'"):
        DatasetExporter().export(Order(store, tmp_path / "made"))
    assert not (tmp_path / "made").exists()


def test_a_site_is_the_report(store: Store, invoke: Invoke, tmp_path: Path) -> None:
    store.close()
    result = invoke("export", "corpus", "--to", "site", "--output", "site")
    assert result.exit_code == 0, result.output
    assert "site/index.html opens in a browser" in result.output
    assert invoke("corpus", "report", "corpus", "--output", "report", "--no-previews").exit_code == 0
    names = [
        sorted(path.relative_to(tmp_path / made) for path in (tmp_path / made).rglob("*"))
        for made in ("site", "report")
    ]
    assert names[0] == names[1]
    assert (tmp_path / "site" / "environments.csv").read_bytes() == (
        tmp_path / "report" / "environments.csv"
    ).read_bytes()
    result = invoke("export", "corpus", "--to", "site", "--output", "x", "--licence", "mit")
    assert (result.exit_code, "does not use --licence mit" in result.output) == (2, True)


def exporters() -> list[Exporter]:
    from envcraft.corpus.export.package import PackageExporter

    spec = importlib.util.spec_from_file_location("lantern_files", FILES)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return [PackageExporter(), DatasetExporter(), module.FilesExporter()]


@pytest.mark.parametrize("exporter", exporters(), ids=lambda exporter: exporter.name)
@pytest.mark.parametrize("name", ["../x.py", "/x.py", "a/../../x.py", "a\\..\\..\\x.py", "C:/x.py", "..", "", "x\0.py"])
def test_no_name_leads_out_of_an_export(store: Store, tmp_path: Path, exporter: Exporter, name: str) -> None:
    judged(store, name, "EC107")
    order = Order(store, tmp_path / "deep" / "made", "games")
    exporter.export(order)
    store.db.execute("UPDATE verdicts SET verdict = 'pass'")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(CorpusDamaged, match="leads out of the folder"):
        exporter.export(Order(store, tmp_path / "deep" / "other", "games"))
    assert sorted(tmp_path.rglob("*")) == before


def test_names_that_only_look_as_if_they_lead_out(store: Store, tmp_path: Path) -> None:
    names = ["..x.py", "a..b/c.py", "...", "a:b.py", ".hidden/x.py"]
    for name in names:
        store.add(name, source("ant"))
    found = [environment.name for environment in Order(store, tmp_path, everything=True).environments()]
    assert set(names) <= set(found)


def test_help_lists_the_forms(invoke: Invoke) -> None:
    text = invoke("export", "--help").output
    assert all(re.search(rf"^  {name}  +\w", text, re.MULTILINE) for name in ("package", "hf", "site"))
