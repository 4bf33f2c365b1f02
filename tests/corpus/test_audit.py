"""Audits of canned environments: the selection, the verdicts and the events."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.audit import Audit, follow
from envcraft.corpus.records import records_of
from envcraft.corpus.store import Store, verdicts
from envcraft.corpus.store.audits import Selection
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check, Rule
from envcraft.judging.driver import Limits
from envcraft.judging.engine import Plan, stream
from envcraft.judging.selection import select_checks
from envcraft.judging.settings import Settings, rules_version, settings_of
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import SubjectFinished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding
from evaluation.drivers import IdleDriver

from .conftest import ENVIRONMENT, Invoke, told


class Words(Check):
    """Gives the findings that the source names, without running it."""

    name = "words"
    rules = tuple(Rule(code, code.lower(), "A.", "Mend.") for code in ("EC101", "EC102", "EC107"))

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if "break" in subject.text:
            raise ValueError("oops")
        if "late" in subject.text:
            raise subject.time_limit.skip()
        for code in re.findall(r"EC\d+", subject.text):
            finding = self.finding(code, f"{code} in {subject.target.path}")
            yield finding.as_warning() if "mildly" in subject.text else finding


class Corpus:
    """A folder of canned environments, and audits of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.store = Store.create(folder / ".envcraft", folder=True)
        self.judged: list[str] = []

    def write(self, **sources: str) -> None:
        targets = [(name, Target(name, text.encode())) for name, text in sorted(sources.items())]
        follow(self.store, targets)

    def audit(
        self,
        resume: bool = True,
        seed: int = 0,
        stop: int | None = None,
        budgets: Sequence[str] = ("quick",),
        fail_fast: bool = False,
        **choice: Any,
    ) -> Audit:
        """Audit the selection and set `judged` to the judged paths. `stop` interrupts after this many."""
        driver, checks, self.judged = IdleDriver(), [Words()], []
        stages = [self.store.settings(settings_of(ARCADE, checks, driver, BUDGETS[name], seed)) for name in budgets]
        choice_made = Selection(**choice, seed=seed)
        audit = Audit(self.store, stages[0], choice_made, "games", resume, complete=not fail_fast)

        def tell(event: Any) -> None:
            if isinstance(event, SubjectFinished):
                self.judged.append(event.report.path.removeprefix("games/"))
                if stop is not None and len(self.judged) >= stop:
                    raise KeyboardInterrupt

        for number, settings in enumerate(stages):
            if number:
                audit.advance(settings)
            if audit.pending:
                budget = BUDGETS[budgets[number]]
                plan = Plan(audit.targets, ARCADE, driver, checks, budget, seed, fail_fast=fail_fast)
                with WorkerPool(driver, Limits(), len(audit.pending)) as pool:
                    audit.run(stream(plan, 2, pool), tell)
        audit.end()
        return audit


@pytest.fixture
def corpus(tmp_path: Path) -> Iterator[Corpus]:
    made = Corpus(tmp_path)
    yield made
    made.store.close()


def test_codes_that_are_never_errors_are_known(corpus: Corpus) -> None:
    corpus.write(a="mildly EC101 EC107", b="mildly EC101 EC102", c="EC107")
    audit = corpus.audit()
    assert audit.codes() == {"EC101": 2, "EC107": 2, "EC102": 1}
    assert audit.warning_codes() == {"EC101", "EC102"}


def test_only_what_changed_is_judged_again(corpus: Corpus) -> None:
    sources = {f"e{number}": f"{number} EC107" if number % 3 == 0 else str(number) for number in range(9)}
    corpus.write(**sources)
    assert corpus.audit().verdicts() == {"pass": 6, "fail": 3}
    assert sorted(corpus.judged) == sorted(sources)
    corpus.write(**sources)
    assert corpus.audit().verdicts() == {"pass": 6, "fail": 3}
    assert corpus.judged == []
    corpus.write(**{**sources, "e1": "1 EC101", "new": "n"})
    again = corpus.audit()
    assert sorted(corpus.judged) == ["e1", "new"]
    assert (again.verdicts(), again.codes()) == ({"pass": 6, "fail": 4}, {"EC107": 3, "EC101": 1})
    corpus.write(**sources)
    # The earlier verdict is still there.
    assert (corpus.audit().verdicts(), corpus.judged) == ({"pass": 6, "fail": 3}, [])
    corpus.audit(seed=1)
    assert len(corpus.judged) == 9
    corpus.audit(resume=False)
    assert len(corpus.judged) == 9


def test_a_verdict_that_the_clock_decided_is_not_settled(corpus: Corpus) -> None:
    corpus.write(a="late", b="1", c="late EC101")
    audit = corpus.audit()
    assert (audit.verdicts(), audit.out_of_time()) == ({"pass": 3}, 2)
    assert sorted(corpus.judged) == ["a", "b", "c"]
    shown = [row.environment for row in verdicts.last(corpus.store)]
    given = {row.name: next(verdicts.given(corpus.store, row.source, row.env_class)).settled for row in shown}
    assert given == {"a": False, "b": True, "c": False}
    assert {record.path for record in records_of(corpus.store)} == {"b"}
    corpus.audit(changed=True)
    assert sorted(corpus.judged) == ["a", "c"]
    corpus.audit()
    assert sorted(corpus.judged) == ["a", "c"]


def test_what_is_not_settled_replaces_no_settled_verdict(corpus: Corpus, monkeypatch: pytest.MonkeyPatch) -> None:
    corpus.write(a="1 EC101")
    corpus.audit()
    judge = Words.judge

    def late(self: Words, subject: Subject) -> Iterator[Finding]:
        yield from judge(self, subject)
        raise subject.time_limit.skip()

    monkeypatch.setattr(Words, "judge", late)
    audit = corpus.audit(resume=False)
    assert corpus.judged == ["a"]
    assert [report.out_of_time for report in audit.kept] == [True]
    assert (audit.out_of_time(), audit.codes()) == (0, {"EC101": 1})


def test_a_second_budget_judges_what_passes_the_first_one(corpus: Corpus) -> None:
    corpus.write(a="1", b="2 EC101", c="3", d="4 break")
    staged = ("quick", "standard")
    audit = corpus.audit(budgets=staged)
    assert sorted(corpus.judged) == ["a", "a", "b", "c", "c", "d"]
    assert audit.verdicts() == {"pass": 2, "fail": 1, "error": 1}
    assert [report.path for report in audit.reports()] == ["games/a", "games/b", "games/c", "games/d"]
    budgets = {row.environment.name: row.settings.budget for row in verdicts.last(corpus.store) if row.settings}
    assert budgets == {"a": "standard", "b": "quick", "c": "standard", "d": "quick"}
    corpus.write(a="1", b="2", c="3 EC102")
    audit = corpus.audit(budgets=staged)
    assert sorted(corpus.judged) == ["b", "b", "c"]
    assert audit.verdicts() == {"pass": 2, "fail": 1}
    assert (audit.selected, audit.judged, audit.known) == (3, 3, 0)
    assert corpus.audit(budgets=staged).judged == 0


@pytest.mark.parametrize("stop", [1, 2, 4, 5])
def test_an_interrupted_audit_of_two_budgets_goes_on_in_its_stage(corpus: Corpus, stop: int) -> None:
    corpus.write(a="1", b="2 EC101", c="3", d="4")
    with pytest.raises(KeyboardInterrupt):
        corpus.audit(budgets=("quick", "standard"), stop=stop)
    first = len(corpus.judged)
    audit = corpus.audit(budgets=("quick", "standard"))
    assert first + len(corpus.judged) == 7
    assert audit.verdicts() == {"pass": 3, "fail": 1}


def test_what_ended_at_the_first_error_is_judged_again_in_full(corpus: Corpus) -> None:
    corpus.write(a="1 EC101 EC107", b="2")
    assert corpus.audit(fail_fast=True).codes() == {"EC101": 1}
    corpus.audit(fail_fast=True)
    assert corpus.judged == []
    assert [record.fail_fast for record in records_of(corpus.store)] == [True, False]
    assert corpus.audit().codes() == {"EC101": 1, "EC107": 1}
    assert corpus.judged == ["a"]


def test_one_source_is_judged_once_for_all_that_have_it(corpus: Corpus) -> None:
    corpus.write(a="x EC101", b="x EC101", c="y")
    audit = corpus.audit()
    assert sorted(corpus.judged) == ["a", "c"]
    assert [(report.path, report.verdict.value) for report in audit.reports()] == [
        ("games/a", "fail"),
        ("games/b", "fail"),
        ("games/c", "pass"),
    ]


def test_what_could_not_be_judged_is_tried_again(corpus: Corpus) -> None:
    corpus.write(a="break", b="x")
    for expected in (["a", "b"], ["a"]):
        assert corpus.audit().verdicts() == {"pass": 1, "error": 1}
        assert sorted(corpus.judged) == expected


def test_what_cannot_be_judged_again_keeps_its_verdict(corpus: Corpus, monkeypatch: pytest.MonkeyPatch) -> None:
    corpus.write(a="EC101", b="b")
    corpus.audit()

    def judge(*_: object) -> Iterator[Finding]:
        raise OSError("no memory")

    with monkeypatch.context() as patch:
        patch.setattr(Words, "judge", judge)
        audit = corpus.audit(resume=False)
    assert (audit.verdicts(), audit.codes()) == ({"pass": 1, "fail": 1}, {"EC101": 1})
    assert sorted((report.path, report.verdict.value) for report in audit.kept) == [
        ("games/a", "error"),
        ("games/b", "error"),
    ]
    assert corpus.audit(resume=False).kept == []


def test_audit_reports_that_the_earlier_verdict_stays(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(ENVIRONMENT.replace("CRASH", "-1"))
    options = ("--checks", "source", "--sandbox", "process", "--budget", "quick")
    assert invoke("corpus", "init", "corpus").exit_code == 0
    assert invoke("corpus", "add", "corpus", "a.py").exit_code == 0
    first = invoke("audit", "corpus", *options)
    assert (first.exit_code, first.stderr) == (0, "1 environment, 1 of them to be judged\n")
    (kept,) = (tmp_path / "corpus" / "sources").rglob("*.py")
    kept.unlink()
    again = invoke("audit", "corpus", *options, "--no-resume")
    assert again.exit_code == 3
    assert "a.py: could not be judged again (cannot read the source" in again.stderr
    assert again.stderr.endswith("; the earlier verdict stays\n")
    assert "1 environment: 1 passed" in again.stdout


def test_a_source_that_is_damaged_stops_nothing_else(corpus: Corpus) -> None:
    corpus.write(a="x", b="y", c="z")
    corpus.store.place(hashlib.sha256(b"y").hexdigest()).write_bytes(b"else")
    audit = corpus.audit()
    assert audit.verdicts() == {"pass": 2, "error": 1}
    lost = audit.report("b")
    assert lost is not None
    assert "has changed" in lost.reason
    assert lost.source_sha256 == hashlib.sha256(b"y").hexdigest()
    corpus.store.place(lost.source_sha256).write_bytes(b"y")
    assert corpus.audit().verdicts() == {"pass": 3}
    assert corpus.judged == ["b"]


def test_choices(corpus: Corpus) -> None:
    sources = {f"e{number:02}": f"{number} EC107" if number % 4 == 0 else str(number) for number in range(20)}
    corpus.write(**sources)
    picked = [report.path for report in corpus.audit(sample=6).reports()]
    assert len(picked) == 6
    assert [report.path for report in corpus.audit(sample=6).reports()] == picked
    assert corpus.judged == []
    corpus.audit()
    assert len(corpus.judged) == 14
    mended = {**sources, "e04": "mended", "e05": "other"}
    corpus.write(**mended)
    assert corpus.audit(changed=True, sample=20).verdicts() == {"pass": 2}
    assert sorted(corpus.judged) == ["e04", "e05"]
    assert corpus.audit(changed=True).selected == 0
    assert corpus.audit(only_failed=True).verdicts() == {"fail": 4}
    assert corpus.audit(only_failed=True, resume=False).selected == 4
    assert sorted(corpus.judged) == ["e00", "e08", "e12", "e16"]


def test_partial_audit_leaves_the_rest_changed(corpus: Corpus) -> None:
    corpus.write(a="EC101", b="b", c="c")
    corpus.audit()
    corpus.write(a="EC101", b="other", c="another", d="d")
    corpus.audit(sample=1)
    corpus.audit(only_failed=True)
    corpus.audit(changed=True, sample=1)
    assert corpus.audit(changed=True).selected == 3
    assert corpus.audit(changed=True).selected == 0
    corpus.write(a="EC101", b="other", c="another")
    assert corpus.audit(changed=True).selected == 0
    # It has not changed, but it has no verdict.
    assert corpus.audit(changed=True, seed=1).selected == 3


def test_error_is_judged_again_with_changed(corpus: Corpus) -> None:
    corpus.write(a="a", b="b")
    corpus.store.place(hashlib.sha256(b"b").hexdigest()).unlink()
    assert corpus.audit().verdicts() == {"pass": 1, "error": 1}
    assert corpus.audit(changed=True).verdicts() == {"error": 1}


def test_what_failed_is_looked_at_again_once_it_is_mended(corpus: Corpus) -> None:
    corpus.write(a="EC101", b="b", c="EC107")
    corpus.audit()
    corpus.write(a="mended", b="changed", c="EC107")
    assert corpus.audit(only_failed=True).verdicts() == {"pass": 1, "fail": 1}
    assert corpus.judged == ["a"]


def test_an_interrupted_audit_goes_on_where_it_was(corpus: Corpus, tmp_path: Path) -> None:
    sources = {f"e{number:02}": f"{number} EC107" if number % 4 == 0 else str(number) for number in range(20)}
    corpus.write(**sources)
    with pytest.raises(KeyboardInterrupt):
        corpus.audit(stop=7)
    before = len(corpus.judged)
    resumed = corpus.audit()
    assert before + len(corpus.judged) == 20
    other = Corpus(tmp_path / "other")
    other.write(**sources)
    undisturbed = other.audit()
    rows = [told(json.loads(json.dumps(line))) for line in _lines(undisturbed)]
    assert [told(line) for line in _lines(resumed)] == rows
    other.store.close()
    ended = corpus.store.db.execute("SELECT ended IS NOT NULL FROM audits ORDER BY id").fetchall()
    assert ended == [(0,), (1,)]


def _lines(audit: Audit) -> list[Any]:
    rows = audit.store.db.execute(
        "SELECT name, v.report FROM environments e JOIN verdicts v ON v.id = e.verdict ORDER BY 1"
    )
    return [[name, json.loads(report)] for name, report in rows]


def test_reports_are_never_held_together(corpus: Corpus) -> None:
    corpus.write(**{f"e{number}": str(number) for number in range(30)})
    audit = corpus.audit()
    reports = audit.reports()
    assert next(reports).path == "games/e0"
    assert iter(reports) is reports


def test_the_version_of_the_rules_follows_the_rules() -> None:
    class Other(Words):
        rules = (Rule("EC101", "other", "A.", "Mend."),)

    driver = IdleDriver()
    version = rules_version([Words()], driver)
    assert version == rules_version([Words()], driver)
    assert version != rules_version([Other()], driver)
    assert version != rules_version([], driver)


def test_settings_say_whether_all_checks_ran() -> None:
    def settings(checks: list[Check]) -> Settings:
        return settings_of(ARCADE, checks, IdleDriver(), BUDGETS["quick"], 0)

    whole = settings(select_checks(None, None))
    assert (whole.checks, whole.offered) == ("", "")
    some = settings(select_checks("source,api", None))
    assert some.checks == ",".join(sorted(check.name for check in select_checks("source,api", None)))
    # The rules already identify the checks, so older verdicts without this field still count.
    assert some.digest == msgspec.structs.replace(some, checks="", offered="").digest
    assert some.offered == whole.rules != some.rules


def test_a_thousand_names_for_one_source_are_one_question(corpus: Corpus) -> None:
    corpus.write(**{f"e{number:04}": "x EC107" for number in range(1000)})
    audit = corpus.audit()
    assert (len(corpus.judged), audit.verdicts(), audit.codes()) == (1, {"fail": 1000}, {"EC107": 1000})
