"""EnvCraft on a system that is not Linux: `envcraft doctor`, and the process sandbox without the kernel's help.

The platform is faked: `sys.platform` says macOS, in this process and in the worker. Other differences stay untested.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from click.testing import CliRunner
from envcraft_sandbox import bubblewrap, launch
from envcraft_sandbox.commands import doctor
from envcraft_sandbox.docker import DockerDriver
from envcraft_sandbox.process import ProcessDriver

from envcraft import plugins
from envcraft.cli.group import cli

#: A worker's program. The libraries come first: they were built for this system.
_WORKER = """
import ctypes, gymnasium, numpy, os, platform, resource, runpy, subprocess, sys, xxhash
sys.platform = "darwin"
del os.pidfd_open
runpy.run_module("envcraft_sandbox.worker", run_name="__main__", alter_sys=True)
"""


@pytest.fixture
def macos(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make this process and its workers believe that they run on macOS."""

    def command(folder: str = launch.JOB_FOLDER, read: Iterable[str] = ()) -> list[str]:
        argv = [sys.executable, "-B", "-s", "-P", "-c", _WORKER, "--folder", folder]
        return argv + [word for path in read for word in ("--read", path)]

    monkeypatch.setattr(launch, "command", command)
    monkeypatch.setattr(sys, "platform", "darwin")
    bubblewrap._probe.cache_clear()
    bubblewrap._has_started.clear()


@pytest.fixture(autouse=True)
def _probe_again() -> Iterable[None]:
    yield
    bubblewrap._probe.cache_clear()


@pytest.mark.usefixtures("macos")
def test_doctor_says_what_works_and_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    drivers = [DockerDriver(), bubblewrap.BubblewrapDriver(), ProcessDriver()]
    loaded = plugins.Plugins(plugins.plugins().manager)
    monkeypatch.setattr(loaded, "collect", lambda hook: drivers)
    monkeypatch.setattr(plugins, "plugins", lambda: loaded)
    result = CliRunner().invoke(doctor, ["--format", "json"])
    report = json.loads(result.stdout)
    assert result.exit_code == 0
    assert set(report["platform"]) == {"system", "release", "python"}
    docker, bubble, process = report["sandboxes"]
    assert (docker["works"], bubble["works"], process["works"], report["auto"]) == (False, False, True, "process")
    assert "Linux container" in docker["fix"]
    assert bubble["reason"] == "it needs Linux"
    assert {"Landlock", "system call filter", "no capabilities"} <= set(process["missing"])
    assert "rlimits" in process["layers"]
    shown = CliRunner().invoke(doctor, env={"COLUMNS": "200"}).stdout
    assert "exist only on Linux" in shown


@pytest.mark.usefixtures("macos")
def test_the_process_sandbox_judges_several_files(root: Path) -> None:
    files = [str(root / "examples" / name) for name in ("snake.py", "broken_invaders_nan_reward.py")]
    options = ["--sandbox", "process", "--budget", "quick", "--checks", "source,reward", "--format", "json"]
    result = CliRunner().invoke(cli, ["validate", *options, *files])
    assert result.exit_code == 1, result.output
    reports = json.loads(result.stdout)["reports"]
    assert [report["verdict"] for report in reports] == ["pass", "fail"]
    assert {found["code"] for check in reports[1]["checks"] for found in check["findings"]} == {"EC301"}


@pytest.mark.usefixtures("macos")
def test_no_worker_is_forked_where_none_can_be_ended() -> None:
    driver = ProcessDriver()
    assert driver.shared_layout() is driver


def test_doctor_on_linux_has_no_such_warning() -> None:
    shown = CliRunner().invoke(doctor, env={"COLUMNS": "200"}).stdout
    assert "exist only on Linux" not in shown
    assert "Linux" in shown.splitlines()[0]
