"""Classes of installed packages and registered ids, from a package that the tests put on the path."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from envcraft_sandbox.bubblewrap import BubblewrapDriver

_CORRIDOR = """import gymnasium as gym
import numpy as np
from gymnasium import spaces
from corridors.doors import Door

class Corridor(gym.Env):
    metadata = {{"render_modes": []}}

    def __init__(self, length=5, reward=1.0):
        self.door = Door(length)
        self.reward = reward
        self.observation_space = spaces.Discrete(100)
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(0, 2))
        return self.at, {{}}

    def step(self, action):
        self.at = max(self.at + (1 if action else -1), 0)
        if self.at == 4:
            {defect}
        open_ = self.door.opens(self.at)
        return self.at, self.reward * open_, open_, False, {{}}

class NeedsSize(Corridor):
    def __init__(self, size):
        super().__init__(size)

class NoEnvironment:
    pass

class Old:
    def reset(self):
        return 0

    def step(self, action):
        return 0, 0.0, True, {{}}

def make_corridor(length=6):
    return Corridor(length)

def make_long(length):
    return Corridor(length)

def make_nothing():
    return 7

def shorter(env):
    return gym.wrappers.TimeLimit(env, 7)
"""
_DOORS = """
class Door:
    def __init__(self, at):
        self.at = at

    def opens(self, at):
        return at >= self.at
"""
_LIBRARY = "try:\n    import bullets.fast\nexcept ImportError:\n    raise ImportError('Run `pip install bullets`.')\n"
_LACKING = "raise gymnasium.error.DependencyNotInstalled('bullets is not installed.')"
_REGISTER = """
import gymnasium
def register():
    gymnasium.register("Corridors/Long-v0", "corridors.corridor:Corridor", max_episode_steps=50)
    gymnasium.register("Chance-v0", "corridors.corridor:Corridor", nondeterministic=True)
register()
"""

_FINDER = """
import importlib.util, sys
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "corridors":
            return importlib.util.spec_from_file_location(name, {init!r})
sys.meta_path.append(Finder)
"""


@pytest.fixture(params=["process", pytest.param("bubblewrap", marks=pytest.mark.bubblewrap)])
def sandbox(request: pytest.FixtureRequest) -> str:
    if request.param == "bubblewrap" and not BubblewrapDriver().probe().works:
        pytest.skip("bubblewrap does not work here")
    return str(request.param)


def package(folder: Path, defect: str = "pass") -> Path:
    """A package `corridors` in `folder`."""
    root = folder / "corridors"
    root.mkdir(parents=True, exist_ok=True)
    (root / "__init__.py").write_text(_REGISTER)
    (root / "doors.py").write_text(_DOORS)
    (root / "corridor.py").write_text(_CORRIDOR.format(defect=defect))
    (root / "lacking.py").write_text(f"import gymnasium\n{_LACKING}\n")
    (root / "misses.py").write_text("import bullets.fast\n")
    (root / "advises.py").write_text(_LIBRARY)
    (root / "misspells.py").write_text("import corridors.dors\n")
    (root / "broken.py").write_text("import corridors\nraise RuntimeError('out of order')\n")
    return folder


def envcraft(sandbox: str, path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a new process with `path` among its import paths."""
    paths = os.pathsep.join([str(path), *filter(None, sys.path)])
    return subprocess.run(
        [sys.executable, "-m", "envcraft", *arguments, "--sandbox", sandbox],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "PYTHONPATH": paths},
    )


def judged(sandbox: str, path: Path, target: str, *arguments: str, status: int = 0) -> dict[str, Any]:
    words = ("--contract", "gymnasium", "--budget", "quick", "--format", "json")
    done = envcraft(sandbox, path, "validate", target, *words, *arguments)
    assert done.returncode == status, done.stderr + done.stdout
    (report,) = json.loads(done.stdout)["reports"]
    assert isinstance(report, dict)
    return report


def findings(report: dict[str, Any]) -> list[dict[str, Any]]:
    return [finding for check in report["checks"] for finding in check["findings"]]


def test_class_of_a_package(sandbox: str, tmp_path: Path) -> None:
    report = judged(sandbox, package(tmp_path), "corridors.corridor:Corridor")
    assert (report["path"], report["kind"], report["env_class"]) == (
        "corridors.corridor:Corridor",
        "module",
        "Corridor",
    )
    assert report["module"] == "corridors.corridor"
    assert report["source_file"] == str(tmp_path / "corridors" / "corridor.py")
    assert report["source_sha256"] == _digest(tmp_path / "corridors" / "corridor.py")
    assert report["steps"] > 500


def test_registered_id_with_its_own_limit(sandbox: str, tmp_path: Path) -> None:
    for target in ("Corridors/Long-v0", "corridors:Long-v0", "corridors:Corridors/Long-v0"):
        report = judged(sandbox, package(tmp_path), target, "--checks", "api")
        assert (report["kind"], report["env_class"], report["module"]) == ("id", "Corridor", "corridors.corridor")


def test_nondeterministic_by_registration(tmp_path: Path) -> None:
    report = judged("process", package(tmp_path), "corridors:Chance-v0", "--checks", "determinism")
    (check,) = [check for check in report["checks"] if check["check"] == "determinism"]
    assert check["verdict"] == "skip"
    assert "nondeterministic" in check["reason"]


def test_finding_names_the_line_and_is_replayed_until_the_file_changes(sandbox: str, tmp_path: Path) -> None:
    package(tmp_path, defect="raise ValueError('the floor is wet')")
    report = judged(sandbox, tmp_path, "corridors.corridor:Corridor", "--checks", "api", status=1)
    (finding,) = findings(report)
    source = (tmp_path / "corridors" / "corridor.py").read_text().splitlines()
    assert finding["code"] == "EC107"
    assert "wet" in source[finding["line"] - 1]
    assert report["kwargs"] == {}
    path = tmp_path / "report.json"
    arguments = ("--contract", "gymnasium", "--budget", "quick", "--format", "json", "--output", str(path))
    envcraft(sandbox, tmp_path, "validate", "corridors.corridor:Corridor", "--checks", "api", *arguments)
    done = envcraft(sandbox, tmp_path, "replay", str(path))
    assert (done.returncode, "reproduced: step" in done.stdout) == (0, True), done.stdout + done.stderr
    package(tmp_path, defect="raise ValueError('the floor is very wet')")
    done = envcraft(sandbox, tmp_path, "replay", str(path))
    assert done.returncode == 3
    assert f"{tmp_path}/corridors/corridor.py has changed since the report" in done.stdout
    assert envcraft(sandbox, tmp_path, "replay", str(path), "--anyway").returncode == 0


def test_the_line_of_another_file_of_a_package_that_raises_is_named(tmp_path: Path) -> None:
    package(tmp_path)
    doors = tmp_path / "corridors" / "doors.py"
    doors.write_text(_DOORS.replace("return at >= self.at", "raise ValueError('locked')"))
    report = judged("process", tmp_path, "corridors.corridor:Corridor", "--checks", "api", status=1)
    (finding,) = findings(report)
    assert f"raises ValueError in {doors} line 7: locked" in finding["message"]
    source = (tmp_path / "corridors" / "corridor.py").read_text().splitlines()
    assert "self.door.opens" in source[finding["line"] - 1]


@pytest.mark.parametrize("missed", ["import bullets.fast", "raise ImportError('Install bullets.')"])
def test_a_library_that_is_missed_in_play_is_no_defect(missed: str, tmp_path: Path) -> None:
    package(tmp_path, defect=missed)
    report = judged("process", tmp_path, "corridors.corridor:Corridor", "--checks", "api", status=3)
    assert not findings(report)
    assert "bullets" in report["reason"]


def test_a_dependency_that_is_missed_in_play_is_no_defect(tmp_path: Path) -> None:
    package(tmp_path, defect=_LACKING.replace("gymnasium", "gym"))
    report = judged("process", tmp_path, "corridors.corridor:Corridor", "--checks", "api,instawin", status=3)
    assert not findings(report)
    assert "bullets is not installed; install the package beside EnvCraft" in report["reason"]
    advised = _LACKING.replace("gymnasium", "gym").replace("installed.", "installed, run `pip install bullets`.")
    package(tmp_path, defect=advised)
    report = judged("process", tmp_path, "corridors.corridor:Corridor", "--checks", "api,instawin", status=3)
    assert report["reason"].endswith("bullets is not installed, run `pip install bullets`, then validate again")


def test_arguments_and_wrappers(tmp_path: Path) -> None:
    """Constructor arguments and wrappers take effect in play and in a replay of the report."""
    wrap = ("--wrap", "corridors.corridor:shorter")
    report = judged("process", package(tmp_path), "corridors.corridor:Corridor", *wrap, "--kwargs", '{"length": 90}')
    assert report["kwargs"] == {"length": 90}
    assert report["wrappers"] == ["corridors.corridor:shorter"]
    nan = judged(
        "process", tmp_path, "corridors:Long-v0", "--checks", "reward", "--kwargs", '{"reward": "much"}', status=1
    )
    assert [finding["code"] for finding in findings(nan)] == ["EC302"]
    assert judged("process", tmp_path, "corridors.corridor:make_corridor", "--checks", "api")["env_class"] == "Corridor"


@pytest.mark.parametrize("target", ["CartPole-v1", "gymnasium.envs.classic_control:CartPoleEnv"])
def test_no_render_mode_is_as_good_as_none_named(target: str, tmp_path: Path) -> None:
    judged("process", tmp_path, target, "--checks", "source", "--kwargs", '{"render_mode": null}')


@pytest.mark.parametrize(
    ("target", "status", "words"),
    [
        ("corridors.corridor:Corridors", 2, "corridors.corridor has no class Corridors; did you mean Corridor?"),
        ("corridors.corridor:Cave", 2, "has no class Cave; its environments are Corridor, NeedsSize"),
        ("corridors.corridor:NeedsSize", 1, "NeedsSize() needs size"),
        ("corridors.corridor:Old", 1, "constructs a corridors.corridor.Old, which does not derive from gymnasium.Env"),
        ("corridors.corridor:NoEnvironment", 2, "NoEnvironment, which has no reset() and no step(); name a class that"),
        ("corridors.corridor:make_nothing", 2, "makes an int, which has no reset() and no step(); name a class that"),
        ("corridors.corridor:make_long", 2, "make_long is a function that needs arguments (length); name a class that"),
        ("os.path:join", 2, "os.path:join is a function that needs arguments (a); name a class that derives from"),
        ("corridors.broken:Corridor", 1, "importing raises RuntimeError: out of order"),
        (
            "corridors.lacking:Corridor",
            3,
            "bullets is not installed; install the package beside EnvCraft, then validate",
        ),
        (
            "corridors.misses:Corridor",
            3,
            "corridors.misses:Corridor needs bullets, which is not installed; install the package beside EnvCraft",
        ),
        ("corridors.advises:Corridor", 3, "Run `pip install bullets`, then validate again"),
        ("corridors.misspells:Corridor", 1, "importing raises ModuleNotFoundError: No module named 'corridors.dors'"),
        ("gymnasium:CartPole", 2, "gymnasium has no class CartPole; did you mean gymnasium:CartPole-v1?"),
        ("gymnasium:Foo", 2, "gymnasium has no class Foo; it registers CartPole-v1, MountainCar-v0"),
        ("gymnasiun:CartPole-v1", 2, "no installed package is named gymnasiun; did you mean gymnasium?"),
        ("gymnasiun.envs:CartPoleEnv", 2, "no installed package is named gymnasiun; did you mean gymnasium?"),
        ("nowhere.to.be:Found", 3, "No module named 'nowhere'; install the package beside EnvCraft"),
        ("Corridors/Longer-v0", 2, "registers Corridors/Longer-v0; did you mean Corridors/Long-v0?"),
        ("Xyzzy-v7", 3, "no installed package registers Xyzzy-v7; write MODULE:ID"),
        ("corridors.corider:Corridor", 2, "No module named 'corridors.corider'"),
        ("CartPol-v1", 2, "no installed package registers CartPol-v1; did you mean CartPole-v1?"),
        ("gymnasium:Foo-v0", 2, "the package gymnasium registers no Foo-v0; it registers CartPole-v1, MountainCar-v0"),
        ("gymnasium:CartPol-v1", 2, "gymnasium registers no CartPol-v1; did you mean CartPole-v1?"),
        ("nowhere:CartPole-v1", 3, "no installed package is named nowhere; install the package beside EnvCraft"),
    ],
)
def test_what_cannot_be_made(target: str, status: int, words: str, tmp_path: Path) -> None:
    report = judged("process", package(tmp_path), target, "--checks", "api", status=status)
    told = [check["reason"] for check in report["checks"]] + [finding["message"] for finding in findings(report)]
    assert any(words in line for line in told), told


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("Corridor",), "give a Python file, a folder with some, package.module:Class or an id"),
        (("CartPole-v1", "--kwargs", "[1]"), "--kwargs [1] is not a JSON object"),
        (("CartPole-v1", "--kwargs", "{1}"), "is not JSON"),
        (("CartPole-v1", "--wrap", "TimeLimit"), "--wrap TimeLimit must be MODULE:FUNC"),
        (("CartPole-v1", "--class", "CartPoleEnv"), "--class CartPoleEnv does not apply to CartPole-v1"),
    ],
)
def test_a_usage_error_is_a_sentence(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = envcraft("process", tmp_path, "validate", *arguments)
    assert done.returncode == 2
    assert words in done.stderr


def test_the_host_imports_nothing_of_a_package(tmp_path: Path) -> None:
    """The import of the package creates a file where the host can write and a worker cannot."""
    package(tmp_path)
    mark = tmp_path / "imported"
    source = (tmp_path / "corridors" / "__init__.py").read_text()
    lines = f"try:\n    open({str(mark)!r}, 'w').close()\nexcept OSError:\n    pass\n"
    (tmp_path / "corridors" / "__init__.py").write_text(lines + source)
    judged("process", tmp_path, "corridors:Long-v0", "--checks", "api")
    assert not mark.exists()


@pytest.mark.bubblewrap
def test_editable_projects_can_be_read(tmp_path: Path) -> None:
    """An editable installation whose finder names a folder that is not on the path."""
    if not BubblewrapDriver().probe().works:
        pytest.skip("bubblewrap does not work here")
    project, site = package(tmp_path / "project"), tmp_path / "site"
    told = site / "corridors-1.0.dist-info"
    told.mkdir(parents=True)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: corridors\nVersion: 1.0\n")
    (told / "direct_url.json").write_text(json.dumps({"url": project.as_uri(), "dir_info": {"editable": True}}))
    init = str(project / "corridors" / "__init__.py")
    (site / "finder_of_corridors.py").write_text(_FINDER.format(init=init))
    (site / "walk.py").write_text("import finder_of_corridors\nfrom corridors.corridor import Corridor\n")
    assert judged("bubblewrap", site, "walk:Corridor", "--checks", "api")["module"] == "corridors.corridor"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.docker
def test_a_finding_of_an_installed_class_names_the_line_of_this_machine(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "envcraft",
        "validate",
        "CartPole-v1",
        "--sandbox",
        "docker",
        "--format",
        "concise",
    ]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 1, result.stderr
    for code, words in (("EC101", "self.observation_space ="), ("EC102", "self.action_space =")):
        line = next(line for line in result.stdout.splitlines() if f": {code} " in line)
        file, number = line.partition(f": {code} ")[0].rsplit(":", 1)
        assert words in Path(file).read_text("utf-8").splitlines()[int(number) - 1]
