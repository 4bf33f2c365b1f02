"""A corpus counts and lists environments that a check left undecided apart from those that passed."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from pathlib import Path

import msgspec
import pytest

from envcraft.cli.commands.audit_reports import write
from envcraft.corpus.audit import Audit
from envcraft.corpus.report.data import Survey, entries
from envcraft.corpus.store import Environment, Store
from envcraft.corpus.store.audits import Selection
from envcraft.model.verdict import CheckReport, Finding, Outcome, Severity, Verdict
from envcraft.reports.reporter import reporter_named

from .conftest import SETTINGS, Invoke, report, source
from .reported import written
from .test_report import Parsed

OPEN = CheckReport("difficulty", Verdict.SKIP, reason="no episode was won", undecided=True)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty environments without a failure, 18 of them with an open question."""
    root = tmp_path_factory.mktemp("undecided") / "corpus"
    with Store.create(root) as store:
        settings = store.settings(SETTINGS)
        for number in range(20):
            name = f"env{number}"
            store.add(name, source(name))
            judged = report(name)
            # These words in evidence, or a check that fails under --strict, are no open question.
            judged.checks[0].findings = [
                Finding("EC209", Severity.WARNING, '"undecided":true', evidence={"info": {"undecided": True}})
            ]
            if number >= 2:
                judged.checks.append(msgspec.structs.replace(OPEN))
            else:
                judged.checks.append(CheckReport("difficulty", Verdict.PASS))
            store.record(Environment(name, hashlib.sha256(source(name)).hexdigest(), ""), settings, judged)
    return root


def test_an_audit_counts_them(corpus: Path) -> None:
    with Store(corpus, write=True) as store:
        run = Audit(store, store.settings(SETTINGS), Selection())
        assert run.verdicts() == {"pass": 20}
        assert run.outcomes() == {Outcome.PASS: 2, Outcome.UNDECIDED: 18}
        assert run.undecided() == {"difficulty": 18}
        text = io.StringIO()
        write(run, [(reporter_named("console"), text)], {}, run.outcomes(), None)
    assert "difficulty  undecided in 18 environments; `envcraft corpus show` has the reasons" in text.getvalue()


def test_an_environment_shows_its_reasons(corpus: Path, invoke: Invoke) -> None:
    assert "  difficulty undecided: no episode was won" in invoke("corpus", "show", corpus, "env5").stdout
    assert "difficulty" not in invoke("corpus", "show", corpus, "env1").stdout


def test_the_list_filters_on_them(corpus: Path, invoke: Invoke) -> None:
    rows = json.loads(invoke("corpus", "list", corpus, "--verdict", "undecided", "--format", "json").stdout)
    assert len(rows) == 18
    assert {(row["verdict"], row["undecided"]) for row in rows} == {("pass", True)}
    assert (
        invoke("corpus", "list", corpus, "--verdict", "pass").stdout
        == "pass       env0  EC209\npass       env1  EC209\n"
    )
    assert "undecided  env2  EC209\n" in invoke("corpus", "list", corpus).stdout


def test_the_report_counts_and_filters_them(corpus: Path, tmp_path: Path) -> None:
    site = written(corpus, tmp_path / "site")
    index = (site / "index.html").read_text("utf-8")
    assert "Of 20 environments, 2 pass, 0 fail and 18 are undecided" in index
    tables = Parsed(index).tables
    assert tables["cascade"][-1] == ["all", "20", "0", "18", "2", "10.0%", "2.8\N{EN DASH}30.1%"]
    assert tables["cascade"][-2][:5] == ["difficulty", "20", "0", "18", "20"]
    assert tables["checks"][-1][:6] == ["difficulty", "2", "0", "18", "0", "0"]
    told = json.loads((site / "report.json").read_text())
    assert (told["verdicts"], told["undecided"]) == ({"pass": 20}, 18)
    with (site / "environments.csv").open(encoding="utf-8", newline="") as stream:
        assert [row["undecided"] for row in csv.DictReader(stream)].count("difficulty") == 18
    assert '<option value="undecided">undecided (18)</option>' in (site / "environments.html").read_text("utf-8")
    # The list's script compares the number of the word, which is that of "undecided".
    assert '"verdicts": ["pass", "undecided"]' in (site / "environments.html").read_text("utf-8")


def test_the_share_that_passes_counts_them(corpus: Path) -> None:
    survey = Survey(["api", "difficulty"])
    with Store(corpus) as store:
        for entry in entries(store):
            survey.take(entry, 1)
    assert (survey.rate.hits, survey.rate.n) == (2, 20)
    last = survey.stages()[-1]
    assert (last.undecided, last.skipped, last.rate.hits, last.rate.n) == (18, 0, 2, 2)


@pytest.mark.parametrize("form", ["hf", "package"])
def test_exports_say_so(corpus: Path, invoke: Invoke, tmp_path: Path, form: str) -> None:
    result = invoke("export", corpus, "--to", form, "--output", tmp_path / "out", "--all")
    assert result.exit_code == 0, result.output
    card = " ".join((tmp_path / "out" / "README.md").read_text("utf-8").split())
    assert ("2 passed, 0 failed" in card, "18 are undecided" in card or "18 undecided" in card) == (True, True)
