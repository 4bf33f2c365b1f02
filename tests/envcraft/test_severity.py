"""Which findings count: the table of severities, ``--strict``, and comments that ignore findings."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import Skip, Undecided, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check, Rule
from envcraft.judging.engine import Plan, validate
from envcraft.judging.ignore_comments import IgnoreComments
from envcraft.judging.selection import all_checks
from envcraft.judging.severity import SeverityPolicy, severity_table
from envcraft.judging.subject import Subject
from envcraft.model.events import Finished
from envcraft.model.target import Kind, Target
from envcraft.model.verdict import Finding, Report, Severity, Verdict
from envcraft.reports.sarif import SarifReporter

from .test_engine import StubDriver

SCHEMA = Path(__file__).resolve().parent.parent / "schemas" / "sarif-schema-2.1.0.json"


class Pieces(Check):
    """Reports findings of its rules at given lines."""

    name = "pieces"
    rules = (Rule("EC701", "a", "A.", "Mend."), Rule("EC702", "b", "B.", "Mend.", Severity.WARNING))

    def __init__(self, *found: tuple[str, int | None] | Exception, gate: bool = False, always: bool = False) -> None:
        self.found, self.gate, self.always = found, gate, always

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for each in self.found:
            if isinstance(each, Exception):
                raise each
            yield self.finding(each[0], "wrong", line=each[1])


class After(Check):
    name = "after"
    rules = ()

    def judge(self, subject: Subject) -> Iterator[Finding]:
        yield from ()


def judged(check: Check, policy: SeverityPolicy, source: str = "", kind: Kind = Kind.SOURCE) -> Report:
    target = Target("a.py" if kind is Kind.SOURCE else "a:B", source.encode(), kind=kind)
    *_, last = validate(Plan([target], ARCADE, StubDriver(), [check, After()], BUDGETS["quick"], severity=policy), 1)
    assert isinstance(last, Finished)
    return last.report


class Suspecting(Check):
    """Suspects from the code what EC701 and EC702 show in play."""

    name = "suspecting"
    rules = (
        Rule("EC751", "c", "C.", "Mend.", confirmed_by=("EC701",)),
        Rule("EC752", "d", "D.", "Mend.", confirmed_by=("EC702",)),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for rule in self.rules:
            yield self.finding(rule.code, "suspicious")


@pytest.mark.parametrize(
    ("policy", "suspected"),
    [
        (SeverityPolicy(), ["EC752"]),
        (SeverityPolicy(ignore=("EC701",)), ["EC752"]),
        (SeverityPolicy({"EC701": "off"}), ["EC752"]),
        (SeverityPolicy({"pieces": "off"}), ["EC752"]),
        (SeverityPolicy({"EC702": "warning"}), []),
        (SeverityPolicy({"EC702": "off"}), ["EC752"]),
        (SeverityPolicy(ignore=("EC702",)), ["EC752"]),
        (SeverityPolicy(select=("EC702", "EC75")), ["EC751", "EC752"]),
    ],
    ids=str,
)
def test_what_play_confirmed_stays_hidden_if_its_code_is_ignored(policy: SeverityPolicy, suspected: list[str]) -> None:
    target = Target("a.py", b"")
    checks = [Pieces(("EC701", 1), ("EC702", 1)), Suspecting()]
    *_, last = validate(Plan([target], ARCADE, StubDriver(), checks, BUDGETS["quick"], severity=policy), 1)
    assert isinstance(last, Finished)
    assert [finding.code for finding in last.report.reports[0].checks[1].findings] == suspected


@pytest.mark.parametrize(
    ("table", "strict", "severities", "verdict"),
    [
        ({}, False, ["error", "warning"], "fail"),
        ({"EC701": "warning"}, False, ["warning", "warning"], "pass"),
        ({"EC701": "off"}, False, ["warning"], "pass"),
        ({"pieces": "off"}, False, [], "pass"),
        ({"pieces": "off", "EC702": "error"}, False, ["error"], "fail"),
        ({"EC701": "off"}, True, ["error"], "fail"),
        ({"EC701": "warning", "EC702": "off"}, True, ["error"], "fail"),
    ],
)
def test_severities_of_the_project(table: dict[str, str], strict: bool, severities: list[str], verdict: str) -> None:
    report = judged(Pieces(("EC701", 1), ("EC702", 1)), SeverityPolicy(table, strict))
    (subject,) = report.reports
    assert [finding.severity for finding in subject.checks[0].findings] == severities
    assert subject.verdict == verdict
    written = json.loads(report.to_json())
    assert (written["severity"], written["strict"]) == (table, strict)


def test_an_open_question_fails_only_if_strict() -> None:
    for outcome, strict, verdict in (
        (Undecided("open"), False, "skip"),
        (Undecided("open"), True, "fail"),
        (Skip("not for it"), True, "skip"),
    ):
        (subject,) = judged(Pieces(outcome), SeverityPolicy(strict=strict)).reports
        assert (subject.checks[0].verdict, subject.checks[0].reason) == (verdict, str(outcome))
        assert subject.checks[0].undecided is isinstance(outcome, Undecided)


def test_a_raised_warning_of_a_gate_stops_no_other_check() -> None:
    policy = SeverityPolicy(strict=True)
    for code, verdicts in (("EC702", ["fail", "pass"]), ("EC701", ["fail", "skip"])):
        (subject,) = judged(Pieces((code, 1), gate=True), policy).reports
        assert [check.verdict for check in subject.checks] == verdicts


@pytest.mark.parametrize("role", ["gate", "always"])
def test_what_other_verdicts_depend_on_is_neither_lowered_nor_ignored(role: str) -> None:
    policy = SeverityPolicy({"EC701": "off", "pieces": "warning"}, comments=True)
    source = "# envcraft: ignore-file[EC701] it must not\n"
    (subject,) = judged(Pieces(("EC701", 1), **{role: True}), policy, source).reports
    assert [finding.code for finding in subject.checks[0].findings] == ["EC701"]
    assert (subject.verdict, subject.checks[0].ignored) == (Verdict.FAIL, [])


def table_of(folder: Path, text: str) -> dict[str, str]:
    (folder / "pyproject.toml").write_text(f"[tool.envcraft]\n{text}\n")
    return severity_table(folder)


def test_the_table_is_read(tmp_path: Path) -> None:
    assert table_of(tmp_path, "") == {}
    table = {"EC209": "error", "determinism": "warning", "EC009": "off"}
    written = "\n".join(f'{name} = "{value}"' for name, value in table.items())
    assert table_of(tmp_path, f"[tool.envcraft.severity]\n{written}") == table


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('severity = "error"', "must be a table"),
        ('severity.EC2003 = "off"', "there is no rule or check 'EC2003'; did you mean EC203?"),
        ('severity.determinsm = "off"', "did you mean determinism?"),
        ('severity.observation-range = "off"', "there is no rule or check 'observation-range'; did you mean EC109?"),
        ('severity.EC203 = "warn"', "EC203 is 'warn'; it must be error, warning or off"),
        ("severity.EC203 = 1", "EC203 is 1; it must be"),
        ('severity.EC907 = "warning"', "EC907 must stay an error"),
        ('severity.EC003 = "off"', "EC003 must stay an error"),
    ],
)
def test_errors_in_the_table_are_usage_errors(invoke: Any, tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match="severity"):
        table_of(tmp_path, text)
    (tmp_path / "a.py").write_text("import gymnasium\n")
    result = invoke("validate", "a.py")
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


SOURCE = """\
import gymnasium as gym

class Maze(gym.Env):  # envcraft: ignore[EC901, EC101] whole class
    def reset(self):
        x = (
            1
        )  # envcraft: ignore[EC201]: a statement
        # envcraft: ignore[EC202] the next line
        y = 2
        return x, y

    # envcraft: ignore[EC203] - above a decorator
    @property
    def size(
        self,
    ):
        return "# envcraft: ignore[EC999] no comment"

    def step(self): return 1  # envcraft: ignore[EC204] one line

    def last(self):
        # envcraft: ignore[EC205] the return, not the method
        return 1
# envcraft: ignore-file[ec301,EC302]
"""


@pytest.mark.parametrize(
    ("code", "first", "last"),
    [("EC101", 3, 23), ("EC201", 5, 7), ("EC202", 9, 9), ("EC203", 13, 17), ("EC204", 19, 19), ("EC205", 23, 23)],
)
def test_a_comment_covers_its_line_statement_or_definition(code: str, first: int, last: int) -> None:
    covered = [
        line
        for line in range(1, len(SOURCE.splitlines()) + 2)
        if IgnoreComments(SOURCE).take(Finding(code, Severity.ERROR, "", line))
    ]
    assert covered == list(range(first, last + 1))
    assert IgnoreComments(SOURCE).take(Finding(code, Severity.ERROR, "")) is None


def test_a_comment_for_the_file_covers_findings_without_a_line() -> None:
    comments = IgnoreComments(SOURCE)
    ignored = comments.take(Finding("EC302", Severity.ERROR, ""))
    assert ignored is not None
    assert (ignored.reason, ignored.line) == ("", 24)
    assert "EC999" not in {code for comment in comments.comments for code in comment.codes}
    assert [(comment.line, code) for comment, code in comments.unused()][-1] == (24, "EC301")


@pytest.mark.parametrize(
    "text", ["def f(:  # envcraft: ignore[EC203] a", "x = '''# envcraft: ignore[EC203] a", "# envcraft: hello\n", "\0"]
)
def test_no_comments_of_other_text(text: str) -> None:
    assert IgnoreComments(text).comments == []


def test_ignored_findings_stay_in_the_report_and_count_nowhere() -> None:
    source = "x = 1  # envcraft: ignore[EC701] it is so\n"
    report = judged(Pieces(("EC701", 1), ("EC701", 2)), SeverityPolicy(comments=True), source)
    check = report.reports[0].checks[0]
    assert [finding.line for finding in check.findings] == [2]
    written = json.loads(report.to_json())["reports"][0]["checks"][0]["ignored"]
    assert [(item["finding"]["code"], item["reason"], item["line"]) for item in written] == [("EC701", "it is so", 1)]
    alone = judged(Pieces(("EC701", 1)), SeverityPolicy(comments=True), source)
    assert alone.reports[0].verdict is Verdict.PASS
    assert msgspec.json.decode(alone.to_json(), type=Report) == alone


def test_comments_count_only_where_the_policy_says_so_and_in_files() -> None:
    source = "x = 1  # envcraft: ignore[EC701] it is so\n"
    assert judged(Pieces(("EC701", 1)), SeverityPolicy(), source).reports[0].verdict is Verdict.FAIL
    installed = judged(Pieces(("EC701", 1)), SeverityPolicy(comments=True), source, Kind.MODULE)
    assert installed.reports[0].verdict is Verdict.FAIL


def test_sarif_has_ignored_findings_as_suppressed_results() -> None:
    source = "x = 1  # envcraft: ignore[EC701] it is so\n"
    output = io.StringIO()
    SarifReporter(output, {}).handle(Finished(judged(Pieces(("EC701", 1)), SeverityPolicy(comments=True), source)))
    log = json.loads(output.getvalue())
    jsonschema.Draft7Validator(json.loads(SCHEMA.read_text("utf-8"))).validate(log)
    (result,) = log["runs"][0]["results"]
    assert result["suppressions"] == [{"kind": "inSource", "justification": "it is so"}]


BROKEN = """\
# contract: gymnasium
import gymnasium as gym
# envcraft: ignore-file[EC2O3] a letter for a digit
# envcraft: ignore-file[EC907] never
# envcraft: ignore-file EC203


class Line(gym.Env):
    observation_space = gym.spaces.Discrete(10)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = 0
        return self.at, {}

    def step(self, action):  # envcraft: ignore[EC504, EC502] fine
        self.at = (self.at + int(action)) % 10
        return self.at, 0.0, self.at == 9, 0, {}
"""


def test_comments_in_a_file_that_is_validated(invoke: Any, tmp_path: Path) -> None:
    (tmp_path / "line.py").write_text(BROKEN)
    options = ("--contract", "gymnasium", "--sandbox", "process", "--checks", "termination", "--format", "json")
    result = invoke("validate", "line.py", *options)
    assert result.exit_code == 0, result.stdout
    source, termination = json.loads(result.stdout)["reports"][0]["checks"][:2]
    assert [item["finding"]["code"] for item in termination["ignored"]] == ["EC504"]
    found = [(finding["code"], finding["line"], finding["message"]) for finding in source["findings"]]
    assert [(code, line) for code, line, _ in found] == [("EC011", 3), ("EC011", 4), ("EC011", 5), ("EC012", 17)]
    words = ["did you mean", "cannot be ignored", "names no code", "line 17 ignores EC502"]
    assert all(word in message for word, (_, _, message) in zip(words, found, strict=True))
    (tmp_path / "part.py").write_text(BROKEN.replace("EC2O3", "EC2"))
    assert "invalid: it needs whole codes, such as EC201, not EC2" in invoke("validate", "part.py", *options).stdout
    (tmp_path / "named.py").write_text(BROKEN.replace("EC2O3", "hash-seed"))
    assert "there is no rule 'hash-seed'; did you mean EC203?" in invoke("validate", "named.py", *options).stdout
    assert invoke("validate", "line.py", *options, "--budget", "quick").stdout.count('"EC012"') == 0
    strict = invoke("validate", "line.py", *options[:-2], "--strict")
    assert strict.exit_code == 1
    assert "strict" in strict.stdout
    assert "EC504 ignored by line 17: fine" in strict.stdout


def test_every_code_of_the_sandbox_must_stay_an_error() -> None:
    fixed = {rule.code for check in all_checks() for rule in check.rules if not check.waivable(rule.code)}
    assert {f"EC90{number}" for number in range(1, 8)} <= fixed
    assert "EC203" not in fixed
    assert "EC009" not in fixed


def test_a_comment_is_used_though_its_finding_is_left_out_for_another_reason() -> None:
    target = Target("a.py", b"x = 1  # envcraft: ignore[EC701] it is so\n")
    seen: list[list[tuple[int, str]]] = []

    class Last(After):
        def judge(self, subject: Subject) -> Iterator[Finding]:
            assert subject.ignore_comments is not None
            seen.append([(comment.line, code) for comment, code in subject.ignore_comments.unused()])
            yield from ()

    policy = SeverityPolicy({"EC701": "off"}, comments=True)
    plan = Plan([target], ARCADE, StubDriver(), [Pieces(("EC701", 1)), Last()], BUDGETS["quick"], severity=policy)
    *_, last = validate(plan, 1)
    assert isinstance(last, Finished)
    assert seen == [[]]
    assert last.report.reports[0].checks[0].ignored == []
