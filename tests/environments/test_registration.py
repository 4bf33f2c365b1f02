"""Gymnasium's ids: each name has one of its own, and registering runs nothing."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest
from gymnasium.envs.registration import EnvSpec

import envcraft
from envcraft.cli.configured import configuration
from envcraft.corpus.ids import identifier
from envcraft.corpus.store import Store
from envcraft.environments.sources import default_corpus
from envcraft.errors import UsageError


@pytest.fixture(autouse=True)
def registry() -> Iterator[None]:
    before = dict(gymnasium.registry)
    yield
    gymnasium.registry.clear()
    gymnasium.registry.update(before)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("snake.py", "EnvCraft/snake-v0"),
        ("Fox-2_b.v3.py", "EnvCraft/Fox-2_b.v3-v0"),
        ("games/level 1/snake.py", "EnvCraft/games..level..x20..1..snake-v0"),
        ("games/xenon.py", "EnvCraft/games..x2f..xenon-v0"),
        ("snake.py@0a1b2c3d", "EnvCraft/snake.py..x40..0a1b2c3d..x..-v0"),
        ("a:b.py", "EnvCraft/a..x3a..b-v0"),
        ("schlange_ü.py", "EnvCraft/schlange_ü-v0"),
    ],
)
def test_ids(name: str, wanted: str) -> None:
    assert identifier(name) == wanted
    spec = EnvSpec(identifier(name, "My-Games"))
    assert (spec.namespace, spec.version) == ("My-Games", 0)


def test_no_two_names_have_the_same_id() -> None:
    names = {
        "".join(letters) + end
        for length in range(1, 7)
        for letters in itertools.product("ax2./ ", repeat=length)
        for end in ("", ".py")
    }
    names |= {"a..x20..b", "a b", "a..xb", "a/b", "a/xb", "a..x2f..b"}
    assert len({identifier(name) for name in names}) == len(names)


def test_registering_imports_nothing_and_making_one_does(corpus: Path) -> None:
    ids = envcraft.register(corpus, "Games")
    assert "Games/deep..dog-v0" in ids
    assert "Games/new-v0" in ids
    assert not (corpus.parent / "imported").exists()
    env = gymnasium.make("Games/deep..dog-v0")
    assert env.reset(seed=0)[0].shape == (84, 84, 3)
    assert env.spec is not None
    assert env.spec.id == "Games/deep..dog-v0"
    with pytest.raises(UsageError, match="trust=True"):
        gymnasium.make("Games/new-v0")
    gymnasium.make("Games/new-v0", trust=True)
    assert envcraft.register(corpus, "Games") == ids


def test_names_by_a_pattern(corpus: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = envcraft.names(corpus)
    assert {"ant.py", "deep/dog.py"} <= set(every) == {*every}
    assert every == sorted(every)
    assert envcraft.names(corpus, "a*t") == envcraft.names(corpus, "ant.py") == ["ant.py"]
    assert envcraft.names(corpus, "none") == []
    monkeypatch.setenv("ENVCRAFT_CORPUS", str(corpus))
    assert envcraft.names() == every
    monkeypatch.delenv("ENVCRAFT_CORPUS")
    monkeypatch.chdir(corpus)
    with pytest.raises(UsageError, match="no corpus is named"):
        envcraft.names()


def test_an_id_of_another_corpus_is_not_taken_over(corpus: Path, tmp_path: Path) -> None:
    envcraft.register(corpus)
    with Store.create(tmp_path / "other") as store:
        store.add("ant.py", b"1")
    with pytest.raises(UsageError, match=r"EnvCraft/ant-v0 is taken by .*games.*another namespace"):
        envcraft.register(tmp_path / "other")
    with pytest.raises(UsageError, match="not a namespace"):
        envcraft.register(corpus, "a/b")


def test_twenty_thousand_are_registered_in_about_a_second(tmp_path: Path) -> None:
    with Store.create(tmp_path / "large") as store, store.transaction():
        sha256 = store.put(b"raise SystemExit")
        store.db.executemany(
            "INSERT INTO environments (name, source, class, origin, added, changed) VALUES (?, ?, '', '{}', '', 1)",
            ((f"games/{number % 100}/env{number}.py", sha256) for number in range(20_000)),
        )
    started = time.process_time()
    assert len(envcraft.register(tmp_path / "large", "Large")) == 20_000
    assert time.process_time() - started < 2.5


def test_the_module_registers_the_corpus_that_is_named(corpus: Path, tmp_path: Path) -> None:
    code = (
        "import gymnasium\n"
        "env = gymnasium.make('envcraft.envs:EnvCraft/ant-v0')\n"
        "print(type(env.unwrapped).__name__, env.reset(seed=3)[0].sum())\n"
    )
    run = [sys.executable, "-c", code]
    variables = {**os.environ, "ENVCRAFT_CORPUS": str(corpus)}
    told = subprocess.run(run, env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=240, check=True)
    assert told.stdout == f"Ant {envcraft.make(corpus, 'ant').reset(seed=3)[0].sum()}\n"


def test_the_module_says_where_no_corpus_is_named(tmp_path: Path) -> None:
    run = [sys.executable, "-c", "import gymnasium\ngymnasium.make('envcraft.envs:EnvCraft/ant-v0')"]
    variables = {name: value for name, value in os.environ.items() if name != "ENVCRAFT_CORPUS"}
    told = subprocess.run(run, env=variables, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert re.search(
        r"^<string>:2: UserWarning: .* no corpus is named\. Set ENVCRAFT_CORPUS", told.stderr, re.MULTILINE
    )


def test_where_the_corpus_is_named(corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ENVCRAFT_CORPUS", raising=False)
    monkeypatch.chdir(tmp_path)
    assert default_corpus() is None
    with pytest.raises(UsageError, match="ENVCRAFT_CORPUS"):
        envcraft.register()
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\ncorpus = "games"\n')
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    assert default_corpus() == tmp_path / "games"
    # Commands that read their settings there pass it over.
    assert configuration(Path.cwd(), {}) == {}
    assert "EnvCraft/ant-v0" in envcraft.register()
    monkeypatch.setenv("ENVCRAFT_CORPUS", "elsewhere")
    assert default_corpus() == Path("elsewhere")
