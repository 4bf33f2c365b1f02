"""What people type out of habit: selection by code, exclusion, quiet and concise output, a baseline, Tab, colours."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from envcraft.cli.group import cli
from envcraft.judging.selection import all_checks
from envcraft.model.verdict import Finding, Severity
from envcraft.reports.concise import ConciseReporter
from envcraft.reports.console import ConsoleReporter
from tests.envcraft.conftest import ENVIRONMENT, Invoke
from tests.envcraft.report_samples import RULES, events, rendered, sample

SOURCE = ("--sandbox", "process", "--budget", "quick", "--checks", "source,lint")
#: Two warnings of the check lint: a file that is opened, and a broad handler.
UNTIDY = ENVIRONMENT.replace(
    "        self.steps += 1\n",
    """        self.steps += 1
        try:
            open('log.txt', 'w')
        except Exception:
            pass
""",
)

#: A list outlives the episodes, and where an episode starts depends on it.
LEAKY = ENVIRONMENT.replace("class Walk", "SEEN = []\n\n\nclass Walk").replace(
    "self.x, self.steps, self.goal = 5, 0,",
    "SEEN.append(0)\n        self.x, self.steps, self.goal = len(SEEN) % 3, 0,",
)


@pytest.fixture
def games(tmp_path: Path) -> Path:
    """A folder with a good file, an untidy one, and one in a folder of drafts that cannot be parsed."""
    folder = tmp_path / "games"
    (folder / "drafts").mkdir(parents=True)
    (folder / "walk.py").write_text(ENVIRONMENT)
    (folder / "untidy.py").write_text(UNTIDY)
    (folder / "drafts" / "old.py").write_text("import gymnasium\nclass Old(gymnasium.Env)\n    pass\n")
    return folder


def codes(output: str) -> list[str]:
    return [found["code"] for one in json.loads(output)["reports"] for c in one["checks"] for found in c["findings"]]


class TestSelection:
    def test_ignored_codes_do_not_report(self, games: Path, invoke: Invoke) -> None:
        def run(*options: str) -> list[str]:
            return codes(invoke("validate", "games/untidy.py", *SOURCE, "--format", "json", *options).stdout)

        assert (every := run()) == ["EC055", "EC058"]
        assert run("--ignore", "ec055") == ["EC058"]
        assert run("--ignore", "EC05") == []
        assert run("--select", "EC05", "--ignore", "EC058") == every[:1]

    def test_a_check_whose_rules_are_all_ignored_does_not_run(self, games: Path, invoke: Invoke) -> None:
        rules = next(check.rules for check in all_checks() if check.name == "lint")
        codes = ",".join(rule.code for rule in rules)
        result = invoke("validate", "games/walk.py", *SOURCE, "--ignore", codes, "--format", "json")
        assert [check["check"] for check in json.loads(result.stdout)["reports"][0]["checks"]] == ["source", "sandbox"]

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--ignore", "EC999"), "there is no rule 'EC999'"),
            (("--ignore", "EC901"), "EC901 cannot be ignored, because other verdicts depend on it"),
            (("--ignore", "lint"), "lint is a check, and --ignore takes codes; name --skip lint"),
            (("--select", "EC05,API"), "API is a check, and --select takes codes; name --checks api"),
            (("-q", "-v"), "-q and -v contradict each other; leave one out"),
            (("--exclude", "*"), "--exclude leaves none of 3 environments"),
            (("--baseline", "nothing.json"), "the baseline nothing.json does not exist"),
        ],
    )
    def test_usage_errors(self, games: Path, invoke: Invoke, options: tuple[str, ...], words: str) -> None:
        result = invoke("validate", "games", *SOURCE, *options)
        assert (result.exit_code, words in result.stderr) == (2, True)

    @pytest.mark.parametrize(("setting", "option", "passes"), [("quiet", "-v", True), ("verbose", "-q", False)])
    def test_an_option_replaces_the_opposite_setting(
        self, games: Path, invoke: Invoke, setting: str, option: str, passes: bool
    ) -> None:
        Path("pyproject.toml").write_text(f"[tool.envcraft]\n{setting} = true\n")
        result = invoke("validate", "games/walk.py", *SOURCE, option)
        assert (result.exit_code, "PASS" in result.stdout) == (0, passes), result.output

    @pytest.mark.parametrize("pattern", ["drafts", "drafts/", "old.py", "dr*/*.py", "drafts/old.py"])
    def test_excluded_files_are_not_judged(self, games: Path, invoke: Invoke, pattern: str) -> None:
        result = invoke("validate", "games", *SOURCE, "--format", "json", "--exclude", pattern)
        assert [Path(one["path"]).name for one in json.loads(result.stdout)["reports"]] == ["untidy.py", "walk.py"]

    def test_a_named_file_is_judged_in_any_case(self, games: Path, invoke: Invoke) -> None:
        assert invoke("validate", "games/drafts/old.py", *SOURCE, "--exclude", "drafts").exit_code == 1


class TestOutput:
    def test_concise_prints_one_line_for_each_finding(self) -> None:
        assert rendered(ConciseReporter, sample()).splitlines() == [
            "good.py: EC209 (warning) seeds 0 and 1 give one level",
            *["games/bad game.py:91: EC107 step 155 raises IndexError"] * 2,
            "games/bad game.py:41: EC203 seed 0 gives another trace under another PYTHONHASHSEED: the observation "
            "differs at step 12",
            "games/bad game.py: EC209 (warning) seeds 0 and 1 give one level",
            "lost.py: error: the check api could not judge: the worker stopped answering",
            "1 passed, 1 failed, 0 undecided, 1 could not be judged: 3 findings, 2 warnings",
        ]

    def test_a_newline_in_a_message_forges_no_line(self) -> None:
        report = sample()
        report.reports[1].checks[1].findings = [Finding("EC107", Severity.ERROR, "boom\nother.py:1: EC107 forged", 3)]
        lines = rendered(ConciseReporter, report).splitlines()
        assert [line for line in lines if line.startswith("other.py")] == []

    @pytest.mark.parametrize("option", ["--format", "--output-format"])
    def test_both_spellings(self, games: Path, invoke: Invoke, option: str) -> None:
        result = invoke("validate", "games/untidy.py", *SOURCE, option, "concise", "-q")
        assert [line.partition(" ")[0] for line in result.stdout.splitlines()] == [
            f"games/untidy.py:{UNTIDY.splitlines().index(line) + 1}:"
            for line in ("            open('log.txt', 'w')", "        except Exception:")
        ]

    def test_quiet_shows_only_what_does_not_pass(self) -> None:
        stream = io.StringIO()
        reporter = ConsoleReporter(stream, RULES)
        reporter.verbosity = -1
        for event in events(sample()):
            reporter.handle(event)
        text = stream.getvalue()
        assert ("good.py" in text, "games/bad game.py" in text, "Show finding" in text) == (False, True, False)
        # The numbers are those of `envcraft replay --finding`, which count hidden findings, too.
        assert "#2: seed 3, 12 actions" in text
        assert "#1: " not in text

    def test_an_audit_writes_the_formats_of_validate(self, games: Path, invoke: Invoke) -> None:
        options = ("--sandbox", "process", "--budget", "quick", "--checks", "source")
        result = invoke(
            "audit", "games", *options, "--output-format", "json", "--output", "a.json", "--report", "concise:a.txt"
        )
        assert (result.exit_code, result.stdout) == (1, "")
        told = json.loads(Path("a.json").read_text())
        assert told["audit"]["verdicts"] == {"pass": 2, "fail": 1}
        lines = Path("a.txt").read_text().splitlines()
        assert lines[0].startswith("games/drafts/old.py:2: EC001 ")
        assert lines[-1].startswith("2 passed, 1 failed, 0 undecided: ")
        result = invoke("audit", "games", *options, "--output", "nowhere/a.txt")
        assert (result.exit_code, "nowhere/a.txt cannot be written" in result.stderr) == (2, True)
        result = invoke("audit", "games", *options, "--report", "one", "--report", "two")
        assert (result.exit_code, "--report names two folders, one and two" in result.stderr) == (2, True)


class TestBaseline:
    def test_only_new_findings_count(self, games: Path, invoke: Invoke) -> None:
        options = ("games/untidy.py", *SOURCE, "--strict", "--format", "json")
        first = invoke("validate", *options, "--ignore", "EC058", "--output", "base.json")
        assert (first.exit_code, codes(Path("base.json").read_text())) == (1, ["EC055"])
        # An edit that moves lines makes no finding new.
        (games / "untidy.py").write_text("# first\n" + UNTIDY)
        again = invoke("validate", *options, "--baseline", "base.json", "--output", "again.json")
        assert (again.exit_code, codes(Path("again.json").read_text())) == (1, ["EC058"])
        # What a report knows from its own baseline is in it, too.
        assert invoke("validate", *options, "--baseline", "again.json").exit_code == 0
        said = invoke("validate", "games/untidy.py", *SOURCE, "--baseline", "again.json").stdout
        assert "2 known from the baseline" in said
        for form in ("concise", "github", "markdown"):
            brief = invoke("validate", "games/untidy.py", *SOURCE, "--baseline", "again.json", "--format", form).stdout
            assert "0 warnings; 2 known from the baseline" in brief

    def test_what_lint_says_of_a_known_defect_is_not_new(self, games: Path, invoke: Invoke) -> None:
        (games / "leaky.py").write_text(LEAKY)
        options = ("games/leaky.py", "--sandbox", "process", "--budget", "quick", "--checks", "determinism,lint")
        invoke("validate", *options, "--output", "base.json")
        assert set(codes(Path("base.json").read_text())) >= {"EC207"}
        again = invoke("validate", *options, "--format", "json", "--baseline", "base.json")
        assert (again.exit_code, codes(again.stdout)) == (0, [])

    def test_what_lint_says_of_a_defect_that_is_a_warning_is_not_said_again(self, games: Path, invoke: Invoke) -> None:
        (games / "leaky.py").write_text(LEAKY)
        options = ("games/leaky.py", "--sandbox", "process", "--budget", "quick", "--checks", "determinism,lint")
        errors = set(codes(invoke("validate", *options, "--format", "json").stdout))
        lowered = "".join(f'{code} = "warning"\n' for code in errors)
        Path("pyproject.toml").write_text(f"[tool.envcraft.severity]\n{lowered}")
        again = invoke("validate", *options, "--format", "json")
        assert (again.exit_code, set(codes(again.stdout))) == (0, errors)

    def test_a_report_from_another_folder_names_the_same_files(
        self, games: Path, invoke: Invoke, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        options = (*SOURCE, "--strict", "--format", "json")
        assert invoke("validate", "games/untidy.py", *options, "--output", "base.json").exit_code == 1
        elsewhere = games.parent / "elsewhere"
        elsewhere.mkdir()
        monkeypatch.chdir(elsewhere)
        again = invoke("validate", "../games/untidy.py", *options, "--baseline", "../base.json")
        assert (again.exit_code, codes(again.stdout)) == (0, [])

    def test_what_other_verdicts_depend_on_is_never_known(self, games: Path, invoke: Invoke) -> None:
        options = ("games/drafts/old.py", *SOURCE, "--format", "json")
        invoke("validate", *options, "--output", "base.json")
        result = invoke("validate", *options, "--baseline", "base.json")
        assert (result.exit_code, codes(result.stdout)) == (1, ["EC001"])


@pytest.mark.parametrize(
    ("words", "incomplete", "offered"),
    [
        (["validate", "--contract"], "arc", {"arcade", "arcade-native"}),
        (["audit", "--contract"], "gym", {"gymnasium"}),
        (["validate", "--checks"], "api,det", {"api,determinism"}),
        (["audit", "--skip"], "difficulty,diff", set()),
        (["validate", "--select"], "ec20", {f"EC20{number}" for number in range(1, 10)}),
        (
            ["validate", "--ignore"],
            "EC203,EC204,EC20",
            {f"EC203,EC204,EC20{number}" for number in (1, 2, 5, 6, 7, 8, 9)},
        ),
        (["validate", "--format"], "con", {"concise", "console"}),
        (["audit", "--output-format"], "jun", {"junit"}),
        (["validate", "--sandbox"], "", {"auto", "docker", "bubblewrap", "process"}),
        (["validate", "--report"], "h", {"html:report.html"}),
        (["audit", "--report"], "sar", {"sar", "sarif:report.sarif"}),
        (["play", "--contract"], "gym", {"gymnasium"}),
        (["replay", "--contract"], "gym", {"gymnasium"}),
        (["new", "--contract"], "gym", {"gymnasium"}),
        (["play", "--sandbox"], "d", {"docker"}),
        (["generate", "--family"], "te", {"tetris"}),
        (["generate", "--family"], "tetris,comp", {"tetris,composer"}),
        (["export", "--to"], "pack", {"package"}),
        (["explain"], "determ", {"determinism"}),
        (["explain"], "EC203", {"EC203"}),
        (["val"], "val", {"validate"}),
    ],
)
def test_tab_completes_names(words: list[str], incomplete: str, offered: set[str]) -> None:
    given = [] if words == ["val"] else words
    items = ShellComplete(cli, {}, "envcraft", "_ENVCRAFT_COMPLETE").get_completions(given, incomplete)
    found = {str(item.value) for item in items}
    assert found == offered if offered != {"EC203"} else offered <= found


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (["validate"], "file"),
        (["validate", "--policy"], "file"),
        (["validate", "--baseline"], "file"),
        (["audit"], "dir"),
        (["audit", "--output"], "file"),
        (["play"], "file"),
        (["replay"], "file"),
        (["new", "--folder"], "dir"),
    ],
)
def test_tab_leaves_files_to_the_shell(words: list[str], kind: str) -> None:
    items = ShellComplete(cli, {}, "envcraft", "_ENVCRAFT_COMPLETE").get_completions(words, "ga")
    assert [(item.value, item.type) for item in items] == [("ga", kind)]


def test_tab_completes_a_file_after_its_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "report.html").touch()
    (tmp_path / "other.html").touch()
    given = ["validate", "walk.py", "--report"]
    items = ShellComplete(cli, {}, "envcraft", "_ENVCRAFT_COMPLETE").get_completions(given, "html:rep")
    assert [item.value for item in items] == ["html:report.html"]


def test_tab_completes_every_name_of_a_file_a_contract_or_a_sandbox() -> None:
    """A parameter of type text is completed only by a function of its own."""
    completed = re.compile(r"FILE|FOLDER|DIR|TARGET|RECORDS|\bCORPUS\b|\.json|FORMAT|CODE")
    names = {"--contract", "--sandbox", "--family", "--checks", "--format", "--policy"}
    missed = [
        f"{path} {param.opts[0]}"
        for path, param in _parameters(cli, "envcraft")
        if (completed.search(param.metavar or "") or names.intersection(param.opts))
        and isinstance(param.type, click.types.StringParamType)
        and not param.shell_complete(click.Context(cli), "")
    ]
    assert missed == []


def _parameters(command: click.Command, path: str) -> Iterator[tuple[str, click.Parameter]]:
    yield from ((path, param) for param in command.params)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            yield from _parameters(found, f"{path} {name}")


@pytest.mark.parametrize(
    ("variables", "coloured"),
    [({}, False), ({"FORCE_COLOR": "1"}, True), ({"NO_COLOR": "1", "FORCE_COLOR": "1"}, False)],
)
def test_colours_are_the_readers_choice(
    variables: dict[str, str], coloured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"TERM": "xterm-256color", **variables}.items():
        monkeypatch.setenv(name, value)
    assert ("\x1b[1;37;41m" in rendered(ConsoleReporter, sample())) is coloured


def test_an_empty_request_for_colours_is_none() -> None:
    """As of a CI file that sets FORCE_COLOR to a variable that is not set."""
    environment = {**os.environ, "FORCE_COLOR": "", "TERM": "xterm-256color"}
    environment.pop("NO_COLOR", None)
    ours, theirs = pty.openpty()
    with os.fdopen(ours, "rb", buffering=0) as screen:
        words = [sys.executable, "-m", "envcraft", "explain", "EC203"]
        subprocess.run(words, stdout=theirs, env=environment, timeout=120, check=True)
        os.close(theirs)
        assert b"\x1b[" in screen.read(65536)


@pytest.mark.parametrize("columns", ["40", "60", "80"])
def test_a_narrow_terminal_cuts_no_name_of_a_list(
    columns: str, invoke: Invoke, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", columns)
    codes = {rule.code for check in all_checks() for rule in check.rules}
    assert codes <= set(click.unstyle(invoke("checks").stdout).split())
    assert {"envcraft.corpus.export.package", "envcraft-rl"} <= set(click.unstyle(invoke("plugins").stdout).split())
