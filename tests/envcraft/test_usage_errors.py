"""A name that does not exist is a usage error, and a bad setting is blamed on its file."""

from __future__ import annotations

import json
import os
import re
import threading
from pathlib import Path

import pytest

from tests.envcraft.conftest import ENVIRONMENT, Invoke

_CHEAP = ("--sandbox", "process", "--budget", "quick")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--class", "Nope"), "defines no class Nope; its classes are Walk"),
        (("--wrap", "nomod:func"), "the module nomod of the wrapper nomod:func is not installed"),
        (("--wrap", "gymnasium.wrappers:TimeLimits"), "has no wrapper TimeLimits; did you mean TimeLimit?"),
        (
            ("--wrap", "gymnasium.wrappers:TimeLimit"),
            "missing a required argument: 'max_episode_steps'; write a function",
        ),
        (("--wrap", "gymnasium:__version__"), "--wrap: gymnasium:__version__ is a str, not a wrapper"),
        (("--wrap", "builtins:print"), "--wrap: builtins:print returns a NoneType, not an environment"),
        (("--kwargs", '{{"self": 1}}'), "--kwargs: Walk.__init__() got multiple values for argument 'self'"),
        (("--select", ""), "--select is empty; write --select CODES, or leave it out"),
        (("--select", ","), "--select ',' names no code; leave it out"),
        (("--checks", ","), "--checks ',' leaves no check to run"),
        (("--skip", "{every}"), "leaves no check to run"),
    ],
)
def test_unknown_names_are_usage_errors(arguments: tuple[str, str], words: str, invoke: Invoke, good: Path) -> None:
    every = ",".join(check["check"] for check in json.loads(invoke("checks", "--format", "json").stdout))
    result = invoke("validate", good, *_CHEAP, arguments[0], arguments[1].format(every=every))
    assert result.exit_code == 2, result.output
    assert words in " ".join((result.stderr + result.stdout).split())


def test_codes_that_are_selected_and_ignored_leave_no_check(invoke: Invoke, good: Path) -> None:
    result = invoke("validate", good, *_CHEAP, "--select", "EC301", "--ignore", "EC3")
    assert result.exit_code == 2, result.output
    assert "--select 'EC301' and --ignore 'EC3' leave no check to run" in result.stderr


@pytest.mark.parametrize("options", [("--output", "{good}", "--format", "json"), ("--report", "html:./{name}")])
def test_a_report_does_not_replace_what_is_judged(options: tuple[str, ...], invoke: Invoke, good: Path) -> None:
    filled = [each.format(good=good, name=good.name) for each in options]
    result = invoke("validate", ".", *_CHEAP, "--checks", "source", *filled)
    assert result.exit_code == 2, result.output
    assert "would replace the file that is judged; name another file" in result.stderr
    assert good.read_text() == ENVIRONMENT


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--report", "json:-"), "two reports have the same file, standard output"),
        (("--output", "-", "--report", "json:-"), "two reports have the same file, standard output"),
        (("--output", "a.json", "--report", "sarif:./a.json"), "a.json; name another file for one of them"),
    ],
)
def test_two_reports_have_two_files(options: tuple[str, ...], words: str, invoke: Invoke, good: Path) -> None:
    result = invoke("validate", good, *_CHEAP, "--checks", "source", *options)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr


def test_an_empty_output_is_standard_output(invoke: Invoke, good: Path) -> None:
    result = invoke("validate", good, *_CHEAP, "--checks", "source", "--format", "concise", "--output", "")
    assert (result.exit_code, result.stdout) == (0, "1 passed, 0 failed, 0 undecided: 0 findings, 0 warnings\n")


def test_a_class_that_only_running_the_file_defines_is_judged(invoke: Invoke, good: Path) -> None:
    good.write_text(good.read_text() + "\nglobals()['Run'] = Walk\n")
    result = invoke("validate", good, *_CHEAP, "--checks", "source", "--class", "Run")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('contract = "arcaed"', "contract: there is no contract 'arcaed'; did you mean arcade?"),
        ('checks = ["sauce"]', "checks: there is no check 'sauce'; did you mean source?"),
        ('skip = "sauce"', "skip: there is no check 'sauce'; choose from "),
        ('format = "jsno"', "format: there is no format 'jsno'; did you mean json?"),
        ('sandbox = "proces"', "sandbox: there is no sandbox 'proces'; did you mean process?"),
        ('budget = "huge"', "budget: 'huge' is not one of"),
        ('seed = "many"', "seed: 'many' is a string; write a number without quotes"),
        ("seed = true", "seed: 'true' is not a whole number from 0 to 2147483647"),
        ("time-limit = true", "time-limit: 'true' is not a number above 0"),
        ('strict = "yes"', "strict: 'yes' is neither true nor false"),
        ("strict = 3", "strict: 3 is neither true nor false"),
        ("corpus = 3", "corpus must be the path of a corpus, not 3"),
        ('skip = "nosuch"', "skip: there is no check 'nosuch'; choose from "),
        ("seed = 1.5", "seed: '1.5' is not a whole number from 0 to 2147483647"),
        ('kwargs = "[1]"', "kwargs: [1] is not a JSON object"),
        ('wrap = ["TimeLimit"]', "wrap: TimeLimit must be MODULE:FUNC"),
        ('policy = "none.py"', "policy: the policy none.py cannot be read: No such file or directory"),
        ("checks = []", "checks: '' leaves no check to run"),
        ('class = "Nope"', "class: walk.py defines no class Nope; its classes are Walk"),
        ('ignore = "EC901"', "ignore: EC901 cannot be ignored"),
        ("select = []", "select: '' names no code"),
        ('select = "snake_*"', "select: there is no rule 'SNAKE_*'"),
        ("quiet = true\nverbose = true", "quiet: quiet and verbose contradict each other"),
        ('output = "none/report.json"', "output: the report none/report.json cannot be written"),
        ('report = ["json:none/report.json"]', "report: the report none/report.json cannot be written"),
        ('report = ["foo:x"]', "report: foo:x: there is no format 'foo'"),
        ('checks = ["api"]\nskip = ["api"]', "checks: 'api' and skip 'api' leave no check to run"),
        ("exclude = 3", "exclude: 3 is not a string"),
        ('exclude = ["a", 3]', "exclude: 3 is not a string"),
    ],
)
def test_a_setting_is_blamed_on_its_file(setting: str, words: str, invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(f"[tool.envcraft]\n{setting}\n")
    result = invoke("validate", good.name)
    assert result.exit_code == 2
    assert f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] {words}" in result.stderr
    assert "--" not in result.stderr


@pytest.mark.parametrize(
    ("setting", "target", "words"),
    [
        ('class = "Nope"', "CartPole-v1", "class: Nope does not apply to CartPole-v1, which has one class"),
        ('exclude = "*"', ".", "exclude: leaves none of 1 environment"),
        ("kwargs = {sise = 3}", "walk.py", "kwargs: Walk.__init__() got an unexpected keyword argument 'sise'"),
        ('wrap = ["nomod:func"]', "walk.py", "wrap: the module nomod of the wrapper nomod:func is not installed"),
        ('wrap = ["own:Wrap"]', "walk.py", "wrap: own:Wrap is in a file of the project, and the contract arcade"),
    ],
)
def test_a_setting_that_does_not_fit_the_target_is_blamed_on_its_file(
    setting: str, target: str, words: str, invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / "pyproject.toml").write_text(f"[tool.envcraft]\n{setting}\n")
    (tmp_path / "own.py").write_text("import gymnasium\n\nclass Wrap(gymnasium.Wrapper): ...\n")
    result = invoke("validate", target, "--sandbox", "process", "--checks", "source")
    assert result.exit_code == 2, result.output
    assert f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] {words}" in result.stderr


@pytest.mark.parametrize("form", ["console", "concise", "github", "html", "json", "junit", "markdown", "sarif"])
def test_a_report_blames_a_setting_on_its_file(form: str, invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft]\nkwargs = {sise = 3}\n")
    result = invoke("validate", good.name, *_CHEAP, "--checks", "source", "--format", form)
    assert "[tool.envcraft] kwargs: Walk" in re.sub(r"&#(\d+);", lambda found: chr(int(found[1])), result.stdout)
    assert "--kwargs:" not in result.stdout


def test_of_two_settings_that_contradict_each_other_each_is_named(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\nskip = ["api"]\n')
    result = invoke("validate", good.name, *_CHEAP, "--checks", "api")
    assert result.exit_code == 2
    place = f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] skip"
    assert f"Error: --checks 'api' and {place} 'api' leave no check to run" in result.stderr


def test_an_isolation_that_the_file_requires_names_it(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\nrequire-isolation = "container"\n')
    result = invoke("validate", good.name, *_CHEAP)
    assert result.exit_code == 3
    place = f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] require-isolation"
    assert f"Error: {place}: the process sandbox isolates by process only" in result.stderr


def test_a_report_without_a_format_names_its_option(invoke: Invoke, good: Path) -> None:
    result = invoke("validate", good, *_CHEAP, "--report", "foo:x")
    assert result.exit_code == 2
    assert "Error: --report foo:x: there is no format 'foo'" in result.stderr


def test_a_file_of_settings_that_is_no_toml_is_an_error(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    file = tmp_path / "pyproject.toml"
    file.write_text("[tool.ruff\nline-length = 88\n")
    result = invoke("validate", good)
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"{file} cannot be read as configuration: " in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("audit", ""), "CORPUS|FOLDER is empty; name a corpus or a folder"),
        (("audit", ".", "--report", ""), "--report is empty; write --report DIR|FORMAT:FILE, or leave it out"),
        (("replay", "report.json", "--gif", ""), "--gif is empty; write --gif FILE, or leave it out"),
        (("validate", "walk.py", "--kwargs", ""), "--kwargs is empty; write --kwargs JSON, or leave it out"),
        (("validate", "walk.py", "--exclude="), "--exclude is empty; write --exclude GLOB, or leave it out"),
        (("validate", "walk.py", "--class", " "), "--class is empty; write --class NAME, or leave it out"),
        (("train", "games", "--output", "run", "--select", ""), "--select is empty; write --select PATTERN, or"),
        (("generate", "--family", "tetris", "--output", ""), "--output is empty; write --output DIR, or leave it out"),
        (("export", "games", "--output", "x", "--to", ""), "--to is empty; write --to FORMAT\n"),
        (("corpus", "init", ""), "CORPUS is empty; write its path"),
        (("corpus", "list", "games", "--name", ""), "--name is empty; write --name GLOB, or leave it out"),
    ],
)
def test_an_empty_name_is_a_usage_error(arguments: tuple[str, ...], words: str, invoke: Invoke, good: Path) -> None:
    result = invoke(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr


def test_an_empty_value_turns_a_setting_off(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    settings = 'baseline = "none.json"\nskip = "source"\nignore = "EC001"\npolicy = "none.py"'
    (tmp_path / "pyproject.toml").write_text(f"[tool.envcraft]\n{settings}\n")
    unset = [word for name in ("baseline", "skip", "ignore", "policy") for word in (f"--{name}", "")]
    assert invoke("validate", good, *_CHEAP, *unset, "--checks", "source").exit_code == 0


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('exclude = [""]', "[tool.envcraft] exclude is empty; give a value, or leave it out"),
        ('class = ""', "[tool.envcraft] class is empty; give a value, or leave it out"),
        ('kwargs = ""', "[tool.envcraft] kwargs is empty; give a value, or leave it out"),
        ('seed = "3"', "[tool.envcraft] seed: '3' is a string; write a number without quotes"),
        ('time-limit = "3"', "[tool.envcraft] time-limit: '3' is a string; write a number without quotes"),
        (
            'contract = "own"\ncontracts.own.success = ""',
            "[tool.envcraft.contracts.own]: success is empty; name a key of info",
        ),
        ('severity.source = "off"', "[tool.envcraft.severity]: source must stay an error"),
        ('severity.sandbox = "warning"', "[tool.envcraft.severity]: sandbox must stay an error"),
    ],
)
def test_an_empty_or_harmful_setting_is_named(
    setting: str, words: str, invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / "pyproject.toml").write_text(f"[tool.envcraft]\n{setting}\n")
    result = invoke("validate", good, *_CHEAP)
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"{tmp_path / 'pyproject.toml'}: {words}" in result.stderr


def test_a_corpus_is_judged_by_audit(invoke: Invoke, good: Path) -> None:
    assert invoke("corpus", "init", "corpus").exit_code == 0
    assert invoke("corpus", "add", "corpus", good).exit_code == 0
    result = invoke("validate", "corpus", *_CHEAP)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "corpus is a corpus, not a folder of environments; judge it with `envcraft audit corpus`" in result.stderr


def test_a_table_of_contracts_is_one(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft]\ncontracts = 3\n")
    result = invoke("validate", good)
    assert (result.exit_code, "[tool.envcraft.contracts] must hold a table" in result.stderr) == (2, True)


def test_arguments_of_the_constructor_are_a_table(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft]\nkwargs = {sise = 3}\n")
    result = invoke("validate", good, *_CHEAP, "--checks", "source")
    assert "unexpected keyword argument 'sise'" in " ".join(result.stdout.split())
    assert "--kwargs" in invoke("explain", "EC007").stdout


def test_a_misspelt_argument_is_wrong_use_though_another_is_required(invoke: Invoke, good: Path) -> None:
    good.write_text(good.read_text().replace("def __init__(self", "def __init__(self, size", 1))
    assert "def __init__(self, size" in good.read_text()
    result = invoke("validate", good, *_CHEAP, "--checks", "source", "--kwargs", '{"sise": 3}')
    assert result.exit_code == 2, result.output
    assert "--kwargs: Walk.__init__() got an unexpected keyword argument 'sise'" in " ".join(result.output.split())


def test_an_argument_that_the_constructor_passes_on_is_the_environment_s_fault(invoke: Invoke, good: Path) -> None:
    good.write_text(
        ENVIRONMENT.replace("render_mode=None):", "**more):\n        render_mode = dict(key=more)[more['size']]")
    )
    result = invoke("validate", good, *_CHEAP, "--checks", "source", "--kwargs", '{"size": 3}')
    assert result.exit_code == 1, result.output
    assert "EC008" in result.stdout


def test_a_baseline_is_below_the_folder_of_the_settings(
    invoke: Invoke, good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\nbaseline = "base.json"\n')
    missing = invoke("validate", good)
    assert missing.exit_code == 2
    assert f"{tmp_path / 'pyproject.toml'}: [tool.envcraft] baseline: the baseline base.json" in missing.stderr
    (tmp_path / "base.json").write_text('{"reports": []}')
    (tmp_path / "deeper").mkdir()
    monkeypatch.chdir(tmp_path / "deeper")
    assert invoke("validate", good, *_CHEAP, "--checks", "source").exit_code == 0


def test_a_notebook_is_no_file_to_judge(invoke: Invoke, tmp_path: Path) -> None:
    (tmp_path / "game.ipynb").write_text('{"cells": []}')
    result = invoke("validate", "game.ipynb")
    assert result.exit_code == 2
    assert "game.ipynb is a notebook; envcraft.validate(CLASS) in a cell judges a class of it" in result.stderr


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("walk", "walk does not exist; did you mean walk.py?"),
        ("README.md", "README.md is not a Python file; the name of an environment's file ends in .py"),
        ("walk.png", "walk.png is not a Python file, but a binary one; name a file that ends in .py"),
        ("CartPole", "CartPole does not exist; did you mean CartPole-v1?"),
    ],
)
def test_what_is_no_file_of_python_is_a_sentence(target: str, words: str, invoke: Invoke, good: Path) -> None:
    good.with_name("README.md").write_text("Hello\n")
    good.with_name("walk.png").write_bytes(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR")
    result = invoke("validate", target)
    assert (result.exit_code, words in result.stderr) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("validate", "walk.py", "--seed", "1.5"), "'--seed': '1.5' is not a whole number from 0 to 2147483647"),
        (("validate", "walk.py", "--seed", "-1"), "'--seed': -1 is not a whole number from 0 to 2147483647"),
        (("validate", "walk.py", "--time-limit", "long"), "'--time-limit': 'long' is not a number above 0"),
        (("audit", ".", "--sample", "few"), "'--sample': 'few' is not a whole number of at least 1"),
        (("corpus", "dedup", ".", "--threshold", "x"), "'--threshold': 'x' is not a number from 0.1 to 1"),
        (("validate", "walk.py", "--budget", "huge"), "'--budget': 'huge' is not one of 'quick', 'standard'"),
    ],
)
def test_a_refused_number_says_what_is_expected(
    arguments: tuple[str, ...], words: str, invoke: Invoke, good: Path
) -> None:
    result = invoke(*arguments)
    assert (result.exit_code, words in result.stderr) == (2, True), result.stderr


def test_an_option_is_blamed_on_the_command_line(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\ncontract = "arcade"\n')
    result = invoke("validate", good, "--contract", "arcaed")
    assert result.exit_code == 2
    assert "pyproject" not in result.stderr


@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (
            "def policy(env):\n    return [4, 0, 1 // 0]",
            "the policy raises ZeroDivisionError: integer division or modulo by zero at step 1 (play.py:2)",
        ),
        # The exception comes from a line of the environment, below one of the policy.
        ("def policy(env):\n    env.x = 5\n    env.step('left')", "at step 1 (play.py:3)"),
        ("def policy(env):\n    return [9, 0, 0]", "the policy's action 1 is invalid"),
        ("def policy(env):\n    env.x = 9\n    return [4, 0, 0]", "it changes x (play.py)"),
        ("policy = 3", "no class with act(state) and no function policy(env) at step 1 (play.py)"),
    ],
)
def test_a_policy_that_fails_is_wrong_use(policy: str, words: str, invoke: Invoke, good: Path, tmp_path: Path) -> None:
    (tmp_path / "play.py").write_text(policy)
    options = ["--sandbox", "process", "--budget", "quick", "--checks", "difficulty", "--policy", "play.py"]
    result = invoke("validate", good.name, *options, "--format", "json")
    assert result.exit_code == 2, result.output
    [subject] = json.loads(result.stdout)["reports"]
    assert subject["verdict"] == "error"
    assert not [finding for check in subject["checks"] for finding in check["findings"]]
    assert subject["reason"].startswith("--policy: ")
    assert words in subject["reason"]


@pytest.mark.parametrize(
    ("settings", "options", "codes"),
    [
        ("", ("--ignore", "EC805"), []),
        ('[tool.envcraft.contracts.calm]\nbase = "arcade"\nwithout = ["EC805"]\n', ("--contract", "calm"), []),
        ('[tool.envcraft.severity]\nEC805 = "warning"\n', (), ["EC805"]),
    ],
    ids=["option", "contract", "warning"],
)
def test_a_fault_of_a_policy_that_does_not_count_is_no_wrong_use(
    settings: str, options: tuple[str, ...], codes: list[str], invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / "pyproject.toml").write_text(settings)
    (tmp_path / "play.py").write_text("def policy(env):\n    return [4, 0, 1 // 0]")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "difficulty", "--policy", "play.py", *options)
    result = invoke("validate", good.name, *options, "--format", "json")
    assert result.exit_code == 1, result.output
    [subject] = json.loads(result.stdout)["reports"]
    found = {finding["code"]: finding["severity"] for check in subject["checks"] for finding in check["findings"]}
    assert found == {"EC802": "error"} | dict.fromkeys(codes, "warning")


@pytest.mark.parametrize("options", [(), ("--contract", "arcade")])
def test_a_contract_with_the_name_of_a_built_in_one_is_an_error(
    options: tuple[str, ...], invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / "pyproject.toml").write_text("[tool.envcraft.contracts.arcade]\nlimit = 50\n")
    result = invoke("validate", good.name, *options)
    assert result.exit_code == 2
    place = f"{tmp_path / 'pyproject.toml'}: [tool.envcraft.contracts.arcade]"
    assert f'{place}: the name arcade is taken; choose another, with base = "arcade"' in result.stderr


@pytest.mark.parametrize(
    ("target", "kwargs", "words"),
    [
        ("walk.py", {"size": "x"}, "Walk(size='x') raises TypeError"),
        ("walk.py", {"size": -1}, "reading the spaces of a new Walk(size=-1) raises IndexError"),
        ("FrozenLake-v1", {"map_name": "9x9"}, "constructing FrozenLake-v1 with map_name='9x9' raises KeyError"),
    ],
)
def test_a_constructor_that_raises_is_shown_with_its_arguments(
    target: str, kwargs: dict[str, object], words: str, invoke: Invoke, good: Path
) -> None:
    text = good.read_text().replace("render_mode=None):", "render_mode=None, size=1):\n        self.size = size + 1")
    spaces = "\n    @property\n    def observation_space(self):\n        return [self.box][-int(self.size == 0) * 9]\n"
    good.write_text(text.replace("self.observation_space", "self.box") + spaces)
    result = invoke("validate", target, *_CHEAP, "--checks", "source", "--kwargs", json.dumps(kwargs))
    assert result.exit_code == 1, result.output
    assert words in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the baseline old.json is empty; a baseline is a report that `envcraft audit` or"),
        ("{}", "the baseline old.json is not a report ("),
    ],
)
def test_a_baseline_that_is_no_report_is_a_usage_error(
    text: str, words: str, invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / "old.json").write_text(text)
    result = invoke("validate", good.name, "--baseline", "old.json")
    assert result.exit_code == 2
    assert words in result.stderr


def test_a_baseline_may_come_through_a_pipe(invoke: Invoke, good: Path, tmp_path: Path) -> None:
    made = invoke("validate", good.name, *_CHEAP, "--checks", "source", "--format", "json").stdout
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_text, args=(made,), daemon=True)
    writer.start()
    result = invoke("validate", good.name, *_CHEAP, "--checks", "source", "--baseline", "pipe")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["walk.py:Walk"], "walk.py:Walk does not exist; to name a class of a file, write walk.py --class Walk"),
        (["./walk.py:Walk"], "./walk.py:Walk does not exist; to name a class of a file, write ./walk.py --class Walk"),
        (["gymnasium:"], "gymnasium: names no environment; write its id after the colon"),
        (["walk.py::Walk"], "walk.py::Walk does not exist; to name a class of a file, write walk.py --class Walk"),
        (["games.walk.Walk"], "games.walk.Walk does not exist; did you mean games.walk:Walk?"),
        ([""], "the target is empty; give a Python file"),
        (["walk.py", "--checks", "ec301"], "ec301 is a code, and --checks takes checks; name --select EC301"),
        (["walk.py", "--skip", "EC301"], "EC301 is a code, and --skip takes checks; name --ignore EC301"),
        (["walk.py", "--kwargs", "size=3"], "--kwargs size=3 is not JSON ("),
        (["walk.py", "--kwargs", "size=3"], """); write it like '{"size": 8}'"""),
        (
            ["walk.py", "--baseline", "none.json"],
            "the baseline none.json does not exist; "
            "`envcraft validate TARGET --baseline '' --format json --output none.json` makes it",
        ),
        (["walk.py", "--policy", "play.py"], "the policy play.py is not valid Python: '(' was never closed (line 1)"),
        (["walk.py", "--policy", "no.py"], "no.py is not a policy: it defines no function policy(env) and no class"),
    ],
)
def test_a_usage_error_has_a_next_step(
    arguments: list[str], words: str, invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    assert good.parent == tmp_path
    (tmp_path / "play.py").write_text("def policy(\n")
    (tmp_path / "no.py").write_text("ACTION = 3\n")
    result = invoke("validate", *arguments, *_CHEAP)
    assert result.exit_code == 2, result.output
    assert words in result.stderr


def test_a_file_in_place_of_a_command_has_a_next_step(invoke: Invoke, good: Path) -> None:
    result = invoke(good.name)
    assert result.exit_code == 2
    assert "'walk.py' is not a command; to judge it: envcraft validate walk.py" in result.stderr


def test_a_file_that_is_named_twice_is_judged_once(invoke: Invoke, good: Path) -> None:
    result = invoke("validate", "walk.py", "./walk.py", good, *_CHEAP, "--checks", "source", "--format", "json")
    assert [subject["path"] for subject in json.loads(result.stdout)["reports"]] == ["walk.py"]


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("taken is a file; name a folder", ("generate", "--family", "tetris", "--output", "taken")),
        ("taken is a file; name a folder", ("generate", "--family", "tetris", "--corpus", "taken/games")),
        ("taken is a file; name a folder", ("corpus", "init", "taken")),
        ("taken is a file; name a folder", ("new", "Lamp", "--folder", "taken/games")),
        ("taken is a file; name a folder", ("export", "games", "--to", "package", "--output", "taken")),
    ],
)
def test_a_file_in_place_of_a_folder_is_named(
    words: str, arguments: tuple[str, ...], invoke: Invoke, tmp_path: Path
) -> None:
    tmp_path.joinpath("taken").touch()
    assert invoke("corpus", "init", "games").exit_code == 0
    result = invoke(*arguments)
    assert (result.exit_code, result.stderr.splitlines()[-1]) == (2, f"Error: {words}")


@pytest.mark.parametrize(
    ("text", "words"),
    [("tool = 3", "cannot be read as configuration: [tool] must be a table"), ("tool.envcraft = 3", "must be a table")],
)
def test_a_tool_that_is_no_table_is_named(text: str, words: str, invoke: Invoke, good: Path, tmp_path: Path) -> None:
    path = tmp_path / "pyproject.toml"
    path.write_text(text)
    result = invoke("validate", good, *_CHEAP)
    assert (result.exit_code, result.stderr.startswith(f"Error: {path}")) == (2, True)
    assert result.stderr.endswith(f"{words}\n")
