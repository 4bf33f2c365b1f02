"""A third-party plugin in a virtual environment: the command line with it, with a broken one, and after its removal."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from envcraft import hookspecs

PACKAGE = Path(__file__).resolve().parents[1] / "plugin_package"
GAMES = PACKAGE / "tests" / "games"
SANDBOX = ("--sandbox", "process")


@dataclass(frozen=True)
class Installed:
    """A virtual environment whose command line runs in an empty folder."""

    python: Path
    site: Path
    folder: Path

    def run(self, *arguments: str | Path, module: str = "envcraft", **more: str) -> subprocess.CompletedProcess[str]:
        command = [self.python, "-m", module, *arguments]
        variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more
        return subprocess.run(
            command, cwd=self.folder, env=variables, capture_output=True, text=True, timeout=300, check=False
        )

    def pip(self, *arguments: str | Path) -> None:
        command = [sys.executable, "-m", "pip", "--python", self.python, "--disable-pip-version-check", *arguments]
        subprocess.run(command, check=True, capture_output=True, timeout=300)

    def listed(self, command: str) -> str:
        done = self.run(command)
        assert done.returncode == 0, done.stderr
        return done.stdout


def make(folder: Path) -> Installed:
    """A virtual environment with the packages of this one and the plugin."""
    venv.create(folder / "venv", with_pip=False)
    (site,) = (folder / "venv").glob("lib/python*/site-packages")
    (site / "base.pth").write_text(f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n")
    (folder / "empty").mkdir()
    made = Installed(folder / "venv" / "bin" / "python", site, folder / "empty")
    # A copy, so that the build writes nothing beside the sources.
    source = shutil.copytree(PACKAGE, folder / "source")
    made.pip("install", "--no-index", "--no-deps", "--no-build-isolation", source)
    return made


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return make(tmp_path_factory.mktemp("lantern"))


@pytest.fixture(scope="module")
def report(installed: Installed) -> Path:
    """The report of the new check on a bad game and a good one."""
    path = installed.folder / "report.json"
    games = [GAMES / "bad" / "shares.py", GAMES / "good" / "torch.py"]
    only = ("--checks", "brightness", "--format", "json", "--output", path)
    done = installed.run("validate", *games, *only, *SANDBOX)
    assert done.returncode == 1, done.stderr
    assert done.stderr == ""
    return path


def test_it_is_listed_with_its_distribution_and_all_its_hooks(installed: Installed) -> None:
    told = json.loads(installed.run("plugins", "--format", "json").stdout)
    assert told["broken"] == []
    (own,) = [plugin for plugin in told["plugins"] if plugin["plugin"] == "lantern"]
    assert own["distribution"] == "envcraft-lantern"
    hooks = [name for name, spec in vars(hookspecs).items() if hasattr(spec, "envcraft_spec")]
    # All hooks: the package is the example of what a third party can do.
    assert own["hooks"] == sorted(hooks)
    assert "envcraft-lantern" in installed.listed("plugins")


def test_what_it_adds_is_listed_and_explained(installed: Installed) -> None:
    assert "LN001" in installed.listed("checks")
    assert "arcade-large" in installed.listed("contracts")
    assert "census" in installed.listed("--help")
    for name in ("LN001", "brightness"):
        explained = installed.run("explain", name)
        assert explained.returncode == 0
        assert "fades in" in explained.stdout


def test_its_family_writes_environments_that_pass(installed: Installed, tmp_path: Path) -> None:
    assert "doors  " in installed.run("generate", "--list").stdout
    done = installed.run("generate", "--family", "doors", "--count", "2", "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["doors_0_000.py", "doors_0_001.py"]
    judged = installed.run("validate", tmp_path / "doors_0_001.py", "--budget", "quick", *SANDBOX)
    assert judged.returncode == 0, judged.stdout


def test_a_player_from_a_file_is_recorded(installed: Installed, tmp_path: Path) -> None:
    installed.run("generate", "--family", "doors", "--count", "1", "--corpus", tmp_path / "doors")
    (tmp_path / "tape.json").write_text("[[3, 0, 0], [4, 0, 0]]")
    demos = ("demos", tmp_path / "doors", "--steps", "20", *SANDBOX, "--player")
    done = installed.run(*demos, f"tape:{tmp_path / 'tape.json'}")
    assert (done.returncode, done.stdout.splitlines()[0]) == (
        0,
        "tape: recorded 20 steps in 1 environment, 0 already recorded",
    )
    wrong = installed.run(*demos, "tape:missing.json")
    assert wrong.returncode == 2
    assert "missing.json is no JSON list of actions" in wrong.stderr


def test_its_check_fails_and_passes(report: Path) -> None:
    bad, good = json.loads(report.read_text())["reports"]
    assert (bad["verdict"], good["verdict"]) == ("fail", "pass")
    # The check sandbox runs after the checks of plugins.
    assert [check["check"] for check in bad["checks"]] == ["source", "brightness", "sandbox"]
    (finding,) = bad["checks"][1]["findings"]
    assert (finding["code"], finding["severity"], finding["line"]) == ("LN001", "error", 28)
    assert finding["evidence"]["brightest"] == 1
    assert finding["evidence"]["rate"]["hits"] == 12
    assert len(finding["repro"]["actions"]) == 63


def test_its_finding_is_replayed_from_the_report(installed: Installed, report: Path, tmp_path: Path) -> None:
    done = installed.run("replay", report, *SANDBOX)
    assert done.returncode == 0, done.stderr
    assert "LN001" in done.stdout
    mended = tmp_path / "shares.py"
    text = (GAMES / "bad" / "shares.py").read_text()
    mended.write_text(text.replace("return frame.astype", "return (frame * 255).astype"))
    told = json.loads(report.read_text())
    told["reports"][0]["path"] = str(mended)
    changed = tmp_path / "report.json"
    changed.write_text(json.dumps(told))
    done = installed.run("replay", changed, "--anyway", *SANDBOX)
    assert done.returncode == 1
    assert "not reproduced" in done.stdout


def test_its_contract_holds_games_to_larger_frames(installed: Installed, tmp_path: Path) -> None:
    large = tmp_path / "large.py"
    large.write_text((GAMES / "good" / "torch.py").read_text().replace("(84, 84, 3)", "(128, 128, 3)"))
    options = ("--checks", "api", "--contract", "arcade-large", "--budget", "quick", "--format", "json")
    done = installed.run("validate", large, GAMES / "good" / "torch.py", *options, *SANDBOX)
    told = json.loads(done.stdout)
    assert told["contract"] == "arcade-large"
    first, second = told["reports"]
    assert first["verdict"] == "pass"
    assert "EC101" in {finding["code"] for check in second["checks"] for finding in check["findings"]}


def test_its_command_counts_what_its_reporter_wrote(installed: Installed, tmp_path: Path) -> None:
    lines = tmp_path / "games.jsonl"
    options = ("--checks", "brightness", "--output", lines)
    done = installed.run("validate", GAMES, *options, *SANDBOX)
    assert done.returncode == 1, done.stderr
    assert {Path(json.loads(line)["path"]).name for line in lines.read_text().splitlines()} == {
        "dawn.py",
        "palette.py",
        "shares.py",
        "torch.py",
    }
    done = installed.run("census", lines)
    assert done.returncode == 0
    assert [line.split() for line in done.stdout.splitlines()] == [["2", "fail"], ["2", "pass"], ["2", "LN001"]]
    lines.write_text(lines.read_text() + "{}\n")
    done = installed.run("census", lines)
    assert done.returncode == 2
    assert "line 5" in done.stderr


def test_environments_are_judged_in_its_sandbox(installed: Installed) -> None:
    options = ("--checks", "reward", "--budget", "quick", "--format", "json", "--sandbox", "nice")
    done = installed.run("validate", GAMES / "good" / "torch.py", *options)
    (report,) = json.loads(done.stdout)["reports"]
    assert (report["verdict"], report["driver"], report["isolation"]) == ("pass", "nice", "process")
    assert "lowest priority" in report["sandbox"]["layers"]
    assert "nice" in installed.listed("doctor")


def test_an_audit_runs_in_its_processes_and_is_exported(installed: Installed, tmp_path: Path) -> None:
    games = shutil.copytree(GAMES, tmp_path / "games")
    options = ("--checks", "brightness", "--budget", "quick", "--format", "json", *SANDBOX)
    there = installed.run("audit", games, "--executor", "processes", "--workers", "2", *options)
    assert (there.returncode, there.stderr) == (1, "4 environments, 4 of them to be judged\n")
    here = installed.run("audit", games, "--no-resume", *options)
    assert untimed(json.loads(there.stdout)["reports"]) == untimed(json.loads(here.stdout)["reports"])

    # An environment that only one check has judged has not passed.
    for more, count in (((), 0), (("--all",), 4)):
        written = installed.run("export", games, "--to", "files", "--output", tmp_path / f"files{count}", *more)
        assert written.stdout.startswith(f"wrote {count} environments\n"), written.stderr
    sums = subprocess.run(["sha256sum", "--check", "SHA256SUMS"], cwd=tmp_path / "files4", check=False)
    assert sums.returncode == 0

    wrong = installed.run("audit", games, "--no-resume", "--executor", "processes", "--scheduler", "x:1", *options)
    assert (wrong.returncode, wrong.stderr.splitlines()[-1]) == (
        2,
        "Error: --scheduler x:1 leads to a cluster, and processes are of this machine: leave it out",
    )


def untimed(value: Any) -> Any:
    """A report without its times."""
    if isinstance(value, dict):
        return {key: untimed(item) for key, item in value.items() if key != "seconds"}
    return [untimed(item) for item in value] if isinstance(value, list) else value


def test_its_sandbox_conforms(installed: Installed, root: Path) -> None:
    # One file of the suite: the driver differs from `process`, which must pass all files, only in its start.
    suite = (root / "tests" / "sandbox" / "conformance" / "test_jobs.py", "-q", "-p", "no:cacheprovider")
    named = "envcraft_lantern.nice:NiceDriver"
    done = installed.run("--rootdir", root, *suite, module="pytest", ENVCRAFT_CONFORMANCE_DRIVER=named)
    assert done.returncode == 0, done.stdout + done.stderr


def test_its_own_tests_pass(installed: Installed) -> None:
    tests = ("--rootdir", PACKAGE, "-p", "no:cacheprovider", "-q", PACKAGE / "tests")
    done = installed.run(*tests, "--envcraft-sandbox", "process", module="pytest")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 passed" in done.stdout


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("from __future__", "raise RuntimeError('no luck')\nfrom __future__", "SyntaxError"),
        ("@hookimpl", "raise RuntimeError('no luck')\n@hookimpl", "RuntimeError: no luck"),
        ("def envcraft_reporters", "def envcraft_reportres", "there is no hook envcraft_reportres"),
        ("from .jsonl", "from .jason", "No module named 'envcraft_lantern.jason'"),
        ("Brightness()]", "Brightness(), Brightness()]", "brightness is taken by the plugin lantern"),
    ],
    ids=["syntax", "import", "misspelt hook", "hook", "name taken"],
)
def test_a_broken_plugin_is_named_and_the_others_work(
    installed: Installed, tmp_path: Path, old: str, new: str, words: str
) -> None:
    folder = tmp_path / "site"
    shutil.copytree(installed.site, folder)
    module = folder / "envcraft_lantern" / "plugin.py"
    module.write_text(module.read_text().replace(old, new, 1))
    # -S leaves out the site-packages with the intact plugin; base.pth is read in this folder instead.
    start = f"import site, runpy; site.addsitedir({str(folder)!r}); runpy.run_module('envcraft', run_name='__main__')"
    done = subprocess.run(
        [installed.python, "-S", "-c", start, "plugins"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (broken,) = [line for line in done.stdout.splitlines() if "broken" in line]
    assert broken.split()[0] == "lantern"
    assert words in broken
    assert "envcraft_checks.reward" in done.stdout


def test_nothing_is_left_after_uninstalling(tmp_path: Path) -> None:
    gone = make(tmp_path)
    gone.pip("uninstall", "--yes", "envcraft-lantern")
    assert "lantern" not in gone.listed("plugins")
    assert "LN001" not in gone.listed("checks")
    assert "arcade-large" not in gone.listed("contracts")
    assert "census" not in gone.listed("--help")
    assert gone.run("explain", "LN001").returncode == 2
    assert gone.run("validate", GAMES, "--format", "jsonl", *SANDBOX).returncode == 2
