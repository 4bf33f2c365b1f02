"""``envcraft export --to package``: built, installed without EnvCraft, and played."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import envcraft
from envcraft.cli.group import cli
from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.export.exporter import Order
from envcraft.corpus.export.package import _Names, package_name
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
from envcraft.model.verdict import Verdict

from .conftest import game, judged

PLAY = """
import hashlib, importlib.util, json, sys
import gymnasium, numpy as np
assert importlib.util.find_spec("envcraft") is None
assert importlib.util.find_spec("envcraft_protocol") is None
name, seed, actions = json.loads(sys.argv[1])
env = gymnasium.make(name, render_mode=None)
import my_games
assert "my_games.sources.ant" not in sys.modules
digest = hashlib.sha256(env.reset(seed=seed)[0].tobytes())
for action in actions:
    observation, reward, *flags, info = env.step(np.array(action))
    digest.update(observation.tobytes() + repr((reward, flags, info["score"])).encode())
print(digest.hexdigest(), len(my_games.ENVIRONMENTS))
"""


def export(*arguments: Any) -> Result:
    return CliRunner().invoke(cli, ["export", *map(str, arguments)])


def test_a_package_is_built_installed_and_played(corpus: Path, tmp_path: Path) -> None:
    folder, fresh = tmp_path / "package", tmp_path / "fresh"
    result = export(corpus, "--to", "package", "--output", folder, "--name", "my_games")
    assert result.exit_code == 0, result.output
    assert 'gymnasium.make("my_games:my_games/ant-v0")' in result.output
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    offline = ["--no-deps", "--no-index"]
    wheels = tmp_path / "wheels"
    for command in (
        [sys.executable, "-m", "venv", "--without-pip", str(fresh)],
        [*pip, "wheel", "--no-build-isolation", *offline, "--wheel-dir", str(wheels), str(folder)],
        [*pip, f"--python={fresh}/bin/python", "install", *offline, str(wheels / "my_games-0.1.0-py3-none-any.whl")],
    ):
        done = subprocess.run(command, capture_output=True, text=True, timeout=480, check=False)
        assert done.returncode == 0, done.stderr
    # NumPy and Gymnasium of this interpreter; of what is installed as editable there, nothing is found this way.
    variables = {"PYTHONPATH": sysconfig.get_path("purelib"), "PATH": "/usr/bin:/bin"}
    actions = np.random.default_rng(0).integers(0, [5, 2, 2], (20, 3)).tolist()
    asked = json.dumps(["my_games:my_games/native-v0", 3, actions])
    run = [f"{fresh}/bin/python", "-c", PLAY, asked]
    done = subprocess.run(run, capture_output=True, text=True, timeout=240, check=False, env=variables, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    env = envcraft.make(corpus, "native")
    digest = hashlib.sha256(env.reset(seed=3)[0].tobytes())
    for action in actions:
        observation, reward, *flags, info = env.step(np.array(action))
        digest.update(observation.tobytes() + repr((reward, flags, info["score"])).encode())
    assert done.stdout.split() == [digest.hexdigest(), "6"]


def test_what_a_package_says_of_itself(corpus: Path, tmp_path: Path) -> None:
    with Store(corpus, write=True) as store:
        text = "import pygame, json, lunar\nfrom scipy import ndimage\n" + game("Moon")
        judged(store, "moon.py", text, "Moon", ARCADE, Verdict.PASS)
        store.db.execute("""UPDATE environments SET origin = '{"file": "/home/me/moon.py", "model": "m"}'""")
    folder = tmp_path / "package"
    written = export(corpus, "--to", "package", "--output", folder)
    assert written.exit_code == 0
    assert "the sources also import lunar, which the package does not require" in written.output
    assert f"`pip install {folder}`" in written.output
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["name"] == "games"
    assert project["dependencies"] == ["gymnasium>=1.0", "numpy>=1.26", "pillow>=10", "pygame-ce>=2.5", "scipy>=1.11"]
    told = {
        one["name"]: one for one in json.loads((folder / "games" / "environments.json").read_text())["environments"]
    }
    assert set(told) == {"ant.py", "bee.py", "cat.py", "deep/dog.py", "moon.py", "native.py", "point.py"}
    moon = told["moon.py"]
    assert moon["origin"] == {"model": "m"}
    assert (moon["class"], moon["contract"], moon["verdict"], moon["budget"]) == ("Moon", "arcade", "pass", "quick")
    source = (folder / "games" / "sources" / f"{moon['module']}.py").read_bytes()
    assert hashlib.sha256(source).hexdigest() == moon["sha256"]
    readme = (folder / "README.md").read_text()
    assert "@" not in readme.replace("gymnasium.make", "")
    assert "`games/deep..dog-v0`" in readme


def test_only_what_has_passed_unless_all_is_wanted(corpus: Path, tmp_path: Path) -> None:
    with Store(corpus, write=True) as store:
        store.db.execute("DELETE FROM environments WHERE name NOT IN ('failed.py', 'new.py')")
    options = ["--to", "package", "--output", tmp_path / "package"]
    result = export(corpus, *options)
    assert result.exit_code == 2
    assert "has passed all checks" in result.output
    assert not (tmp_path / "package").exists()
    assert export(corpus, *options, "--all").exit_code == 0
    entries = json.loads((tmp_path / "package" / "games" / "environments.json").read_text())["environments"]
    assert [(one["name"], one["verdict"]) for one in entries] == [("failed.py", "fail"), ("new.py", None)]
    assert "0 passed, 1 failed, 0 undecided" in (tmp_path / "package" / "README.md").read_text()


def test_an_environment_is_made_of_a_row_as_the_card_says(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pyarrow import parquet

    assert export(corpus, "--to", "hf", "--output", tmp_path / "set").exit_code == 0
    rows = [row for file in (tmp_path / "set" / "data").iterdir() for row in parquet.read_table(file).to_pylist()]
    assert len(rows) == 6
    _, code = re.findall(r"```python\n(.*?)```", (tmp_path / "set" / "README.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    told = {"row": next(row for row in rows if row["name"] == "native.py")}
    exec(code.replace('"auto"', '"process"'), told)
    told["env"].close()
    np.testing.assert_array_equal(told["observation"], envcraft.make(corpus, "native").reset(seed=0)[0])


def test_usage_errors(corpus: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    for arguments, words in (
        (["--to", "packag", "--output", tmp_path / "x"], "no export format 'packag'; did you mean package?"),
        (["--to", "package", "--output", tmp_path / "full"], "is not empty"),
        (["--to", "package", "--output", tmp_path / "x", "--name", "json"], "'json' is not a valid package name"),
        (["--to", "package", "--output", tmp_path / "x", "--name", "a-b"], "'a-b' is not a valid package name"),
    ):
        result = export(corpus, *arguments)
        assert result.exit_code == 2, result.output
        assert words in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full", "games"]


def test_the_names_of_packages_and_of_modules(tmp_path: Path) -> None:
    with Store.create(tmp_path / "My 2 Games" / ".envcraft", folder=True) as store:
        assert package_name(Order(store, tmp_path)) == "my_2_games"
        with pytest.raises(UsageError, match="--name my_games"):
            package_name(Order(store, tmp_path, "gymnasium"))
        for name in (
            "snake.py",
            "Snake.py",
            "deep/snake.py",
            "deep_snake.py",
            "class.py",
            "1.py",
            "__init__.py",
            "ü.py",
        ):
            store.add(name, name.encode())
        names = _Names()
        modules = [names.module(environment) for environment in Order(store, tmp_path, everything=True).environments()]
    assert len({module.lower() for module in modules}) == 8
    assert all(module.isidentifier() for module in modules)
    assert {"env_1", "env_class", "Snake", "_"} <= set(modules)


def test_what_was_judged_under_another_contract_of_that_name_is_not_exported(corpus: Path, tmp_path: Path) -> None:
    with Store(corpus, write=True) as store:
        store.db.execute("UPDATE settings SET contract_sha256 = ?", ("0" * 64,))
    result = export(corpus, "--to", "package", "--output", tmp_path / "package")
    assert result.exit_code == 2
    assert "was judged under another version of the contract" in result.output
    assert not (tmp_path / "package").exists()
