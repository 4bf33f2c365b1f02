"""The command line's own promises: light imports, exit statuses, and one sentence for each usage error."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from envcraft import __version__
from envcraft.cli.configured import configuration
from envcraft.cli.group import cli
from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.registry import did_you_mean, offered


def offering(drivers: list[Any]) -> Callable[[str], list[Any]]:
    """The plugins' hooks, with these drivers in place of theirs."""
    return lambda hook: drivers if hook == "envcraft_sandbox_drivers" else offered(hook)


HEAVY = ("numpy", "gymnasium", "torch", "scipy", "stable_baselines3", "PIL")
QUICK = ("--sandbox", "process", "--budget", "quick", "--checks", "source")


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["--version"], ["checks"], ["explain", "EC203"], ["validate", "-h"], ["play", "-h"], ["export", "-h"]],
)
def test_light_commands_import_no_numerical_library(arguments: list[str]) -> None:
    code = (
        "import sys\nfrom envcraft.cli.group import cli\n"
        f"try:\n    cli({arguments!r})\nexcept SystemExit as end:\n    status = end.code\n"
        f"print('status', status, 'heavy', [name for name in {HEAVY!r} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True)
    assert result.stdout.splitlines()[-1] == "status 0 heavy []"


def test_version_and_module_entry() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "envcraft", "--version"], capture_output=True, text=True, timeout=240, check=True
    )
    assert __version__ in result.stdout


def test_all_built_in_commands_are_there(invoke: Any) -> None:
    result = invoke("--help")
    listed = [line.split()[0] for line in result.stdout.partition("Commands:\n")[2].splitlines()]
    assert listed == sorted(listed)
    wanted = {"validate", "replay", "explain", "checks", "contracts", "plugins", "doctor", "sandbox", "new", "play"}
    assert set(listed) >= wanted


@pytest.mark.parametrize("columns", [60, 100])
def test_every_help_fits_the_terminal_and_cuts_no_summary(columns: int) -> None:
    pending: list[tuple[click.Command, str]] = [(cli, "envcraft")]
    for command, name in pending:
        context = click.Context(command, info_name=name, terminal_width=columns)
        text = command.get_help(context)
        assert [line for line in text.splitlines() if len(line) > columns] == [], name
        if isinstance(command, click.Group):
            commands = text.partition("Commands:\n")[2]
            assert commands
            assert "..." not in commands, commands
            inner = [(command.get_command(context, each), each) for each in command.list_commands(context)]
            pending += [(found, each) for found, each in inner if found is not None]
    assert {"transfer", "dedup", "build"} < {name for _, name in pending}


def test_unknown_command_names_the_nearest(invoke: Any) -> None:
    result = invoke("valdate")
    assert result.exit_code == 2
    assert "did you mean validate?" in result.stderr


def test_good_and_bad_environments_by_exit_status(invoke: Any, good: Path, bad: Path) -> None:
    assert invoke("validate", good, *QUICK).exit_code == 0
    assert invoke("validate", good, bad, *QUICK).exit_code == 1
    assert invoke("validate", good, bad, *QUICK, "--exit-zero").exit_code == 0


def test_missing_path_is_a_sentence_and_the_others_are_judged(invoke: Any, good: Path, bad: Path) -> None:
    result = invoke("validate", "nowhere.py", bad, good, *QUICK, "--format", "json", "--exit-zero")
    assert result.exit_code == 2
    assert result.stderr.splitlines() == [
        "Error: nowhere.py does not exist; give a Python file, a folder with some, package.module:Class or an id like "
        "CartPole-v1",
    ]
    assert [Path(subject["path"]).name for subject in json.loads(result.stdout)["reports"]] == ["bad.py", "walk.py"]


def test_folder_without_environments(invoke: Any, tmp_path: Path) -> None:
    folder = tmp_path / "empty"
    folder.mkdir()
    (folder / "tool.py").write_text("import gymnasium\nprint(1)\n")
    (folder / "other.py").write_text("class A:\n    pass\n")
    result = invoke("validate", folder)
    assert result.exit_code == 2
    assert "holds no environment" in result.stderr
    assert result.stdout == ""


def test_other_files_of_a_folder_are_counted(invoke: Any, good: Path, tmp_path: Path) -> None:
    folder = tmp_path / "games"
    folder.mkdir()
    shutil.copy(good, folder)
    result = invoke("validate", folder, *QUICK)
    assert "without an environment" not in result.stderr
    (folder / "a.py").write_bytes(good.read_text().encode("utf-16"))
    for name in "bcd":
        (folder / f"{name}.py").write_text("print(1)\n")
    result = invoke("validate", folder, *QUICK)
    assert result.exit_code == 0
    assert f"skipped 4 files without an environment in {folder}: a.py, b.py, c.py, …" in result.stderr
    assert len(json.loads(invoke("validate", folder, *QUICK, "--format", "json").stdout)["reports"]) == 1


def test_a_class_selects_the_files_of_a_folder_that_define_it(invoke: Any, good: Path, tmp_path: Path) -> None:
    folder = tmp_path / "games"
    folder.mkdir()
    shutil.copy(good, folder)
    (folder / "run.py").write_text(good.read_text().replace("Walk", "Run"))
    result = invoke("validate", folder, *QUICK, "--class", "Run", "--format", "json")
    assert result.exit_code == 0, result.output
    assert [Path(report["path"]).stem for report in json.loads(result.stdout)["reports"]] == ["run"]
    assert f"skipped 1 file without the class Run in {folder}: {good.name}" in result.stderr
    nothing = invoke("validate", folder, *QUICK, "--class", "Jump")
    assert nothing.exit_code == 2
    assert "no .py file in it defines a subclass Jump of gymnasium.Env" in nothing.stderr


def test_tests_in_a_folder_are_not_judged(invoke: Any, good: Path, tmp_path: Path) -> None:
    folder = tmp_path / "games"
    folder.mkdir()
    for name, more in (("walk", ""), ("conftest", ""), ("test_agent", "\n\ndef test_it(): ...\n"), ("test_level", "")):
        (folder / f"{name}.py").write_text(good.read_text() + more)
    result = invoke("validate", folder, *QUICK, "--format", "json")
    assert f"skipped 2 test files in {folder}: conftest.py, test_agent.py" in result.stderr
    judged = [Path(report["path"]).stem for report in json.loads(result.stdout)["reports"]]
    assert judged == ["test_level", "walk"]
    assert invoke("validate", folder / "test_agent.py", *QUICK).exit_code == 0


def test_links_to_files_are_followed(invoke: Any, good: Path, tmp_path: Path) -> None:
    folder = tmp_path / "snapshot"
    folder.mkdir()
    (folder / "game.py").symlink_to(good)
    (folder / "gone.py").symlink_to(tmp_path / "nowhere.py")
    (folder / "folder.py").mkdir()
    result = invoke("validate", folder, *QUICK)
    assert result.exit_code == 0
    assert "game.py" in result.stdout
    assert "gone.py" not in result.stderr


def test_folder_is_searched_for_environments(invoke: Any, good: Path, tmp_path: Path) -> None:
    for name in ("a/one.py", ".venv/lib/two.py", "b/c/three.py", "__pycache__/four.py"):
        path = tmp_path / "tree" / name
        path.parent.mkdir(parents=True)
        path.write_bytes(good.read_bytes())
    (tmp_path / "tree" / "a" / "helper.py").write_text("x = 1\n")
    result = invoke("validate", tmp_path / "tree", *QUICK, "--format", "json", "--workers", 2)
    paths = [Path(subject["path"]).name for subject in json.loads(result.stdout)["reports"]]
    assert paths == ["one.py", "three.py"]


@pytest.mark.parametrize(
    ("content", "code"),
    [(b"\x7fELF\x02\x01\x01\x00\x00\xff\xfe" * 50, "EC001"), (b"# big\n" * (50 * 1024**2 // 6), "EC010")],
    ids=["binary", "50 MB"],
)
def test_files_that_are_no_environments_fail_with_a_code(
    invoke: Any, tmp_path: Path, content: bytes, code: str
) -> None:
    path = tmp_path / "odd.py"
    path.write_bytes(content)
    result = invoke("validate", path, *QUICK, "--format", "json")
    assert result.exit_code == 1
    found = [
        finding["code"] for check in json.loads(result.stdout)["reports"][0]["checks"] for finding in check["findings"]
    ]
    assert found == [code]


def test_endless_import_costs_its_file_only(invoke: Any, good: Path, tmp_path: Path) -> None:
    (tmp_path / "loop.py").write_text("import time\nimport gymnasium\nwhile True:\n    time.sleep(60)\n")
    result = invoke("validate", tmp_path / "loop.py", good, *QUICK, "--format", "json")
    first, second = json.loads(result.stdout)["reports"]
    assert [finding["code"] for finding in first["checks"][0]["findings"]] == ["EC004"]
    assert second["verdict"] == "pass"


def test_a_pipe_is_refused_rather_than_waited_for(invoke: Any, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.py")
    result = invoke("validate", tmp_path / "pipe.py")
    assert result.exit_code == 2
    assert "neither a file nor a folder" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--checks", "determinsm"), "did you mean determinism?"),
        (("--skip", "rewards"), "did you mean reward?"),
        (("--contract", "arcad"), "did you mean"),
        (("--contract", "zzz"), "choose from arcade"),
        (("--format", "jsn"), "did you mean json?"),
        (("--format", "yaml"), "there is no format 'yaml'; choose from"),
        (("--sandbox", "dokcer"), "did you mean docker?"),
        (("--output", "missing/report.json"), "the report missing/report.json cannot be written"),
        (("--report", "missing/report.json"), "must be FORMAT:FILE"),
        (("--report", "jsn:a"), "did you mean json?"),
        (("--report", "json:missing/a"), "the report missing/a cannot be written"),
        (("--report", "json:a", "--report", "sarif:./a"), "have the same file"),
        (("--policy", "missing.py"), "the policy missing.py cannot be read"),
        (("--policy", "tetriz"), "name a Python file, or a player that has a policy: "),
        (("--seed", "-1"), "-1"),
        (("--workers", "0"), "0"),
        (("--budget", "huge"), "huge"),
        (("--checks", "source", "--skip", "source"), "leave no check to run"),
        (("--skip", "source"), "--skip source is not possible"),
        (("--ignore", "EC"), "--ignore 'EC' leaves no check to run"),
        (("--select", "XX1"), "there is no rule 'XX1'; there are 1"),
        (("--ignore", "observation-range"), "there is no rule 'observation-range'; did you mean EC109?"),
        (("--select", "Step-raise"), "there is no rule 'step-raise'; did you mean EC107?"),
    ],
)
def test_a_usage_error_is_one_sentence(invoke: Any, good: Path, arguments: tuple[str, ...], words: str) -> None:
    result = invoke("validate", good, *arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.output
    assert result.stdout == ""


def test_an_interrupt_leaves_the_report_of_before(
    invoke: Any, good: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "kept" / "report.json"
    kept.parent.mkdir()
    kept.write_text("the report of before")

    def interrupted(*_: object) -> Iterator[object]:
        yield from ()
        raise KeyboardInterrupt

    monkeypatch.setattr("envcraft.judging.engine.validate", interrupted)
    result = invoke("validate", good, "--sandbox", "process", "--format", "json", "--output", kept)
    assert result.exit_code == 130, result.output
    assert kept.read_text() == "the report of before"
    assert [path.name for path in kept.parent.iterdir()] == ["report.json"]


def test_output_may_be_a_device(invoke: Any, good: Path) -> None:
    result = invoke("validate", good, "--sandbox", "process", "--checks", "source", "--output", os.devnull)
    assert result.exit_code == 0, result.output
    assert not Path(os.devnull).is_file()


def test_no_engine_is_a_sentence_and_exit_3(invoke: Any, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DOCKER_HOST", "unix:///nonexistent/engine.sock")
    result = invoke("validate", good, "--sandbox", "docker")
    assert result.exit_code == 3
    assert result.stderr.startswith("Error: the docker sandbox does not work here")
    assert len(result.stderr.splitlines()) == 1


class Stub(Driver):
    """A driver that is there, or is not, and launches nothing."""

    rank = 10

    def __init__(self, isolation: Isolation, works: bool = True) -> None:
        self.name, self.isolation, self.works = f"by-{isolation}", isolation, works
        self.swept = False

    def probe(self) -> Availability:
        return Availability(self.works, "" if self.works else "it is broken", "" if self.works else "mend it")

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        raise SandboxUnavailable(f"launched {self.name}")

    def sweep(self) -> None:
        self.swept = True


@pytest.mark.parametrize("has", Isolation)
@pytest.mark.parametrize("asked", Isolation)
@pytest.mark.parametrize("how", ["auto", "named"])
def test_required_isolation_fails_closed(
    invoke: Any, good: Path, monkeypatch: pytest.MonkeyPatch, has: Isolation, asked: Isolation, how: str
) -> None:
    levels = list(Isolation)
    # What is stronger is broken, as on a machine that lost its engine.
    stubs = [Stub(level, works=levels.index(level) >= levels.index(has)) for level in levels]
    for rank, stub in enumerate(reversed(stubs)):
        stub.rank = rank
    monkeypatch.setattr("envcraft.judging.selection.offered", offering(stubs))
    name = "auto" if how == "auto" else f"by-{has}"
    result = invoke("validate", good, "--sandbox", name, "--require-isolation", asked.value)
    assert result.exit_code == 3
    enough = levels.index(has) <= levels.index(asked)
    assert (f"{asked} isolation is required" in result.stderr) is not enough
    # Nothing was judged where it does not hold; where it does, the worker was asked for.
    assert (f"launched by-{has}" in result.stdout) is enough
    assert enough or result.stdout == ""


def test_every_driver_sweeps_before_anything_is_judged(
    invoke: Any, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stubs = [Stub(level) for level in Isolation]
    monkeypatch.setattr("envcraft.judging.selection.offered", offering(stubs))
    invoke("validate", good, "--sandbox", "by-process")
    assert all(stub.swept for stub in stubs)


@pytest.mark.parametrize("command", ["validate", "replay"])
@pytest.mark.parametrize("name", ["process", "bubblewrap"])
def test_a_runtime_needs_the_docker_sandbox(invoke: Any, good: Path, bad: Path, command: str, name: str) -> None:
    target = good
    if command == "replay":
        target = bad.with_suffix(".json")
        invoke("validate", bad, *QUICK, "--format", "json", "--output", target)
    result = invoke(command, target, "--sandbox", name, "--runtime", "runsc")
    assert result.exit_code == 2
    assert result.stderr == f"Error: --runtime runsc requires the docker sandbox, not {name}\n"


def test_a_runtime_that_cannot_be_had_is_exit_3(invoke: Any, good: Path) -> None:
    result = invoke("validate", good, "--runtime", "no-such-runtime")
    assert result.exit_code == 3
    assert result.stderr.startswith("Error: the docker sandbox does not work here: ")


def test_the_report_says_what_the_code_ran_in(invoke: Any, good: Path) -> None:
    (report,) = json.loads(invoke("validate", good, *QUICK, "--format", "json").stdout)["reports"]
    told = report["sandbox"]
    assert told["driver"] == report["driver"] == "process"
    # The driver's own, and what the worker found inside.
    assert {"own process", "rlimits"} <= set(told["layers"])
    assert not set(told["layers"]) & set(told["missing"])
    assert told["image"] is None


def test_class_picks_one_of_several(invoke: Any, good: Path, tmp_path: Path) -> None:
    path = tmp_path / "two.py"
    path.write_text(
        good.read_text()
        + "\n\nclass Other(Walk):\n    metadata = {'render_modes': []}\n\n\nclass Third(Walk):\n    pass\n"
    )
    assert invoke("validate", path, *QUICK).exit_code == 1
    result = invoke("validate", path, *QUICK, "--class", "Other", "--format", "json")
    assert json.loads(result.stdout)["reports"][0]["env_class"] == "Other"


def test_skip_leaves_a_check_out(invoke: Any, good: Path) -> None:
    result = invoke(
        "validate",
        good,
        "--sandbox",
        "process",
        "--budget",
        "quick",
        "--skip",
        "api,determinism,difficulty",
        "--format",
        "json",
    )
    ran = [check["check"] for check in json.loads(result.stdout)["reports"][0]["checks"]]
    assert ran[0] == "source"
    assert "reward" in ran
    assert not {"api", "determinism", "difficulty"} & set(ran)


def test_output_goes_to_the_file(invoke: Any, good: Path, tmp_path: Path) -> None:
    result = invoke("validate", good, *QUICK, "--format", "json", "--output", "report.json")
    assert result.stdout == ""
    assert json.loads((tmp_path / "report.json").read_text())["reports"][0]["verdict"] == "pass"


def test_without_a_format_the_name_of_the_file_decides(invoke: Any, good: Path, tmp_path: Path) -> None:
    invoke("validate", good, *QUICK, "--output", "report.json")
    assert json.loads((tmp_path / "report.json").read_text())["reports"][0]["verdict"] == "pass"
    invoke("validate", good, *QUICK, "--output", "report.xml", "--format", "console")
    assert "1 passed" in (tmp_path / "report.xml").read_text()


def test_one_run_gives_several_reports(invoke: Any, good: Path, bad: Path, tmp_path: Path) -> None:
    result = invoke("validate", good, bad, *QUICK, "--report", "json:a.json", "--report", "sarif:out:b.sarif")
    assert result.exit_code == 1
    assert "1 passed" in result.stdout
    reports = json.loads((tmp_path / "a.json").read_text())["reports"]
    assert [report["verdict"] for report in reports] == ["pass", "fail"]
    assert json.loads((tmp_path / "out:b.sarif").read_text())["version"] == "2.1.0"


def test_several_reports_may_be_settings(invoke: Any, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(
        '[tool.envcraft]\nsandbox = "process"\nchecks = ["source"]\nreport = ["json:a.json", "junit:b.xml"]\n'
    )
    assert invoke("validate", good).exit_code == 0
    assert (tmp_path / "a.json").read_text().startswith("{")
    assert (tmp_path / "b.xml").read_text().startswith("<?xml")


@pytest.mark.parametrize("setting", ['select = ["EC106"]', 'select = "EC106,EC107"'])
def test_selected_rules_may_be_a_setting(setting: str, invoke: Any, good: Path, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(f"[tool.envcraft]\n{setting}\n")
    (report,) = json.loads(invoke("validate", good, *QUICK[:4], "--format", "json").stdout)["reports"]
    assert [check["check"] for check in report["checks"]] == ["source", "api", "sandbox"]


def test_environments_only_skips_other_files(invoke: Any, good: Path, bad: Path, tmp_path: Path) -> None:
    helper = tmp_path / "helper.py"
    helper.write_text("class Tiles:\n    size = 8\n")
    assert invoke("validate", helper, *QUICK).exit_code == 1
    asked = (*QUICK, "--environments-only", "--format", "json")
    result = invoke("validate", helper, good, *asked)
    assert result.exit_code == 0
    assert f"skipped 1 file without an environment: {helper}" in result.stderr
    assert [Path(report["path"]).name for report in json.loads(result.stdout)["reports"]] == ["walk.py"]
    assert invoke("validate", helper, bad, *asked).exit_code == 1
    for nothing in (invoke("validate", helper, *asked), invoke("validate", helper, *asked, "--workers", 2)):
        assert nothing.exit_code == 0
        assert json.loads(nothing.stdout)["reports"] == []
    assert "nothing judged" in invoke("validate", helper, *QUICK, "--environments-only").stdout
    assert invoke("validate", helper, "nowhere.py", *asked).exit_code == 2


def test_settings_come_from_the_nearest_pyproject(invoke: Any, bad: Path, tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "pyproject.toml").write_text(
        '[tool.envcraft]\nformat = "json"\nsandbox = "process"\nseed = 7\n'
        'exit-zero = true\nskip = ["api", "difficulty"]\n'
    )
    below = tmp_path / "below"
    below.mkdir()
    monkeypatch.chdir(below)
    result = invoke("validate", bad)
    report = json.loads(result.stdout)
    assert result.exit_code == 0
    assert report["seed"] == 7
    assert "api" not in [check["check"] for check in report["reports"][0]["checks"]]
    assert json.loads(invoke("validate", bad, "--seed", 8).stdout)["seed"] == 8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[tool.envcraft]\nbugdet = 'quick'\n", "did you mean budget?"),
        ("[tool.envcraft\n", "cannot be read as configuration"),
        ("[tool]\nenvcraft = 3\n", "must be a table"),
    ],
)
def test_wrong_settings_are_a_sentence(invoke: Any, good: Path, tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "pyproject.toml").write_text(text)
    result = invoke("validate", good)
    assert result.exit_code == 2
    assert words in result.stderr
    with pytest.raises(UsageError, match="pyproject"):
        configuration(tmp_path, {"budget": "budget"})


def test_a_bug_of_ours_is_exit_3_never_1(invoke: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("envcraft.cli.group.named", lambda hook, name: click.Command(name, callback=broken))
    result = invoke("boom")
    assert result.exit_code == 3
    assert "a bug in EnvCraft" in result.stderr


def test_ctrl_c_is_exit_130(invoke: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("envcraft.cli.group.named", lambda hook, name: click.Command(name, callback=interrupted))
    result = invoke("wait")
    assert result.exit_code == 130
    assert result.stderr == "interrupted\n"


def test_ctrl_c_is_exit_130_before_any_command_runs(invoke: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(hook: str) -> list[Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr("envcraft.cli.group.offered", interrupted)
    result = invoke("--help")
    assert (result.exit_code, result.stderr) == (130, "interrupted\n")
    code = (
        "import sys\n"
        "class Finder:\n    def find_spec(self, *_):\n        raise KeyboardInterrupt\n"
        "from envcraft.__main__ import main\nsys.meta_path.insert(0, Finder())\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


@pytest.mark.skipif(sys.platform != "linux", reason="it counts the threads in /proc")
def test_numpy_starts_no_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    code = (
        "import os, sys\nfrom envcraft.__main__ import main\nsys.argv[1:] = ['--version']\n"
        "try:\n    main()\nexcept SystemExit:\n    import numpy\n    print(len(os.listdir('/proc/self/task')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True)
    assert done.stdout.splitlines()[-1] == "1"


@pytest.mark.parametrize("arguments", [("checks", "--format", "json"), ("checks",), ("--version",)])
def test_a_closed_pipe_is_no_bad_environment(arguments: tuple[str, ...]) -> None:
    """Whoever writes to it: Click, Rich, or the interpreter at the end."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "envcraft", *arguments]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=240)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("workers", [1, 2])
def test_ending_it_leaves_no_process(tmp_path: Path, number: signal.Signals, workers: int) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.py").write_text(
            "import gymnasium\n\nclass A(gymnasium.Env):\n    while True:\n        pass\n"
        )
    command = [sys.executable, "-m", "envcraft", "validate", ".", "--sandbox", "process", "--workers", str(workers)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    deadline = time.monotonic() + 120
    while len(started := descendants(process.pid)) < 2 * workers and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(started) >= 2 * workers, "no worker was started"
    process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert errors.splitlines()[-1] == "interrupted"
    assert "Traceback" not in errors
    deadline = time.monotonic() + 60
    while (left := [child for child in started if alive(child)]) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left


def test_unknown_names_the_nearest_or_all() -> None:
    assert did_you_mean("rewrad", ["reward", "api"]) == "'rewrad'; did you mean reward?"
    assert did_you_mean("zzz", ["reward", "api"]) == "'zzz'; choose from reward, api"
    # The codes of a family are nearer than one that has as many letters.
    assert did_you_mean("ec5", ["EC05", "EC501", "EC502", "EC503"]) == "'ec5'; did you mean EC501, EC502 or EC503?"
    assert did_you_mean("EC2O4", ["EC204", "EC214"]) == "'EC2O4'; did you mean EC204?"


@pytest.mark.parametrize(("name", "words"), [("EC203", "hash-seed"), ("ec203", "hash-seed"), ("determinism", "EC204")])
def test_explain(invoke: Any, name: str, words: str) -> None:
    result = invoke("explain", name)
    assert result.exit_code == 0
    assert words in result.stdout


def test_explain_names_the_nearest(invoke: Any) -> None:
    result = invoke("explain", "EC2003")
    assert result.exit_code == 2
    assert "EC203" in result.stderr


@pytest.mark.parametrize("listing", ["checks", "contracts", "plugins"])
def test_listings_in_both_formats(invoke: Any, listing: str) -> None:
    words = {"checks": "EC203", "contracts": "arcade", "plugins": "envcraft_checks.source"}[listing]
    assert words in invoke(listing).stdout
    assert words in json.dumps(json.loads(invoke(listing, "--format", "json").stdout))


def descendants(parent: int) -> set[tuple[int, str]]:
    """The processes below one, each with the time of its start, which tells it from a later one of the same number."""
    parents, starts = {}, {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and (fields := stat(int(folder.name))):
            parents[int(folder.name)], starts[int(folder.name)] = int(fields[1]), fields[19]
    found: set[int] = set()
    while new := {child for child, above in parents.items() if above in found | {parent}} - found:
        found |= new
    return {(child, starts[child]) for child in found}


def alive(process: tuple[int, str]) -> bool:
    number, start = process
    fields = stat(number)
    return bool(fields) and fields[19] == start and fields[0] != "Z"


def stat(number: int) -> list[str]:
    """The fields of /proc/PID/stat from the state on, or none when there is no such process."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []
