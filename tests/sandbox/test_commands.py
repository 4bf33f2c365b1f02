"""``envcraft doctor`` and ``envcraft sandbox build``, with drivers and a docker command of the tests' own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from envcraft_sandbox import build, engine
from envcraft_sandbox.commands import doctor, sandbox

from envcraft import plugins
from envcraft.errors import EnvCraftError
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker


class Fake(Driver):
    isolation = Isolation.NAMESPACE

    def __init__(self, name: str, rank: int, available: Availability | None) -> None:
        self.name, self.rank, self._available = name, rank, available

    def probe(self) -> Availability:
        if self._available is None:
            raise RuntimeError("it broke")
        return self._available

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        raise NotImplementedError


WORKS = Availability(True, layers=["a wall", "a moat [deep]"])
FAILS = Availability(False, "it is not there", "install it")


def _offer(monkeypatch: pytest.MonkeyPatch, *drivers: Driver) -> None:
    loaded = plugins.Plugins(plugins.plugins().manager)
    monkeypatch.setattr(loaded, "collect", lambda hook: list(drivers))
    monkeypatch.setattr(plugins, "plugins", lambda: loaded)


@pytest.fixture
def docker_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Put a docker command on the path that fails with the words in a file."""
    words = tmp_path / "words"
    command = tmp_path / "docker"
    command.write_text(f"#!{sys.executable}\nimport sys\nsys.exit(open({str(words)!r}).read())\n")
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    return words


class TestDoctor:
    def test_it_shows_every_driver_and_what_auto_takes(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS), Fake("strong", 2, FAILS))
        result = CliRunner().invoke(doctor, env={"COLUMNS": "200"})
        assert result.exit_code == 0
        assert "it is not there: install it" in result.stdout
        assert "a moat [deep]" in result.stdout
        assert "takes weak" in result.stdout

    def test_json_says_the_same(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS), Fake("strong", 2, FAILS), Fake("broken", 3, None))
        result = CliRunner().invoke(doctor, ["--format", "json"])
        told = json.loads(result.stdout)
        assert result.exit_code == 0
        assert [(each["name"], each["works"]) for each in told["sandboxes"]] == [("strong", False), ("weak", True)]
        assert told["auto"] == "weak"
        assert told["broken"] == [{"plugin": "sandbox broken", "error": "RuntimeError: it broke"}]

    @pytest.mark.parametrize("arguments", [[], ["--format", "json"]])
    def test_without_a_sandbox_the_status_is_3(self, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
        _offer(monkeypatch, Fake("strong", 2, FAILS))
        assert CliRunner().invoke(doctor, arguments).exit_code == 3

    def test_importing_the_commands_is_cheap(self) -> None:
        program = "import envcraft_sandbox.commands, sys; print(sorted({'numpy', 'rich'} & sys.modules.keys()))"
        told = subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}; {program}"],
            capture_output=True,
            text=True,
        )
        assert told.stdout == "[]\n", told.stderr


class TestEngine:
    @pytest.mark.parametrize(
        ("words", "reason"),
        [
            (
                "Cannot connect to the Docker daemon at unix:///x. Is the docker daemon running?",
                "no Docker engine answers",
            ),
            ("permission denied while trying to connect to the docker API at unix:///x.sock", "may not use"),
            ("docker: Error response from daemon: it is full.\nSee 'docker run --help'.", "docker refused: it is full"),
            ("", "it gave no reason"),
        ],
    )
    def test_its_words_become_one_sentence(self, docker_says: Path, words: str, reason: str) -> None:
        docker_says.write_text(words or "\n")
        with pytest.raises(engine.EngineError, match=reason) as raised:
            engine.docker("version")
        assert "\n" not in str(raised.value)

    def test_an_engine_that_only_reports_its_absence_is_absent(self, docker_says: Path) -> None:
        command = docker_says.parent / "docker"
        command.write_text(f'#!{sys.executable}\nprint(\'{{"ServerErrors": ["Cannot connect"]}}\')\n')
        with pytest.raises(engine.EngineError, match="no Docker engine answers"):
            engine.info()

    def test_building_without_docker_says_what_to_install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("PATH", "")
        result = CliRunner().invoke(sandbox, ["build", "--base", "host"])
        assert isinstance(result.exception, EnvCraftError)
        assert "install Docker" in str(result.exception)
        assert result.exception.exit_code == 3


class TestDigest:
    def test_it_covers_all_that_the_image_is_made_of(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        names = [name for name, _ in build.worker_sources()]
        assert "envcraft_sandbox/wire.py" in names
        assert "envcraft_sandbox/worker/server.py" in names
        assert not [name for name in names if name.endswith(("client.py", ".pyc"))]
        before = build.digest()
        for name in ("Dockerfile", "requirements.txt"):
            (tmp_path / name).write_bytes((build._IMAGE / name).read_bytes() + b"\n")
        monkeypatch.setattr(build, "_IMAGE", tmp_path)
        assert build.digest() != before
