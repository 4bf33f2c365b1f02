"""``envcraft doctor`` and ``envcraft sandbox build`` with fake drivers, and the errors of the container engine."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from envcraft_protocol.jobs import Job
from envcraft_sandbox import build, engine, packages, rootfs
from envcraft_sandbox.commands import doctor, sandbox
from envcraft_sandbox.docker import DockerDriver

from envcraft import plugins
from envcraft.errors import EnvCraftError, SandboxUnavailable, UsageError
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Player, Recorder, Worker
from envcraft.model.job import JobResult


class Fake(Driver):
    isolation = Isolation.NAMESPACE

    def __init__(self, name: str, rank: int, available: Availability | None, launches: bool = True) -> None:
        self.name, self.rank, self._available, self._launches = name, rank, available, launches
        self.swept = 0
        self.launched: list[FakeWorker] = []

    def probe(self) -> Availability:
        if self._available is None:
            raise RuntimeError("it broke")
        return self._available

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        if not self._launches:
            raise SandboxUnavailable("the drawbridge is up; let it down")
        self.launched.append(FakeWorker())
        return self.launched[-1]

    def sweep(self) -> None:
        self.swept += 1


class FakeWorker(Worker):
    """Says what it found inside, and is good for nothing else."""

    def __init__(self) -> None:
        self.about = {"layers": ["a wall", "a lock"], "missing": ["Landlock", "a moat [deep]"], "image": "sha256:1"}
        self.closed = False

    def preload(self, modules: list[str]) -> list[str]:
        raise NotImplementedError

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        raise NotImplementedError

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        raise NotImplementedError

    def close(self) -> None:
        self.closed = True


WORKS = Availability(True, layers=["a wall", "a moat [deep]"], missing=["swap limit"])
FAILS = Availability(False, "it is not there", "install it")


def _offer(monkeypatch: pytest.MonkeyPatch, *drivers: Driver) -> None:
    loaded = plugins.Plugins(plugins.plugins().manager)
    monkeypatch.setattr(loaded, "collect", lambda hook: list(drivers))
    monkeypatch.setattr(plugins, "plugins", lambda: loaded)


class TestDoctor:
    def test_it_shows_every_driver_and_what_auto_takes(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS), Fake("strong", 2, FAILS))
        result = CliRunner().invoke(doctor, env={"COLUMNS": "200"})
        assert result.exit_code == 0
        assert "it is not there: install it" in result.stdout
        assert "a moat [deep]" in result.stdout
        assert "takes weak" in result.stdout

    def test_nothing_is_bold_inside_a_version(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS))
        shown = CliRunner().invoke(doctor, env={"COLUMNS": "40", "NO_COLOR": "1", "FORCE_COLOR": "1"}, color=True)
        assert "\x1b[1m" not in shown.stdout.splitlines()[0]

    def test_a_narrow_terminal_shows_all_words(self, monkeypatch: pytest.MonkeyPatch) -> None:
        fails = Availability(
            False, "no engine answers", "install [it] in /usr/local/lib/some-directory-with-a-long-name"
        )
        _offer(monkeypatch, Fake("weak", 1, WORKS), Fake("strong", 2, fails))
        shown = CliRunner().invoke(doctor, env={"COLUMNS": "40"}).stdout
        assert max(map(len, shown.splitlines())) <= 40
        words = f"{fails.reason}: {fails.fix}"
        assert words.replace(" ", "") in "".join(shown.split())
        assert "…" not in shown

    def test_json_says_the_same(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS), Fake("strong", 2, FAILS), Fake("broken", 3, None))
        result = CliRunner().invoke(doctor, ["--format", "json"])
        report = json.loads(result.stdout)
        assert result.exit_code == 0
        assert [(each["name"], each["works"]) for each in report["sandboxes"]] == [("strong", False), ("weak", True)]
        assert report["auto"] == "weak"
        assert report["broken"] == [{"plugin": "sandbox broken", "error": "RuntimeError: it broke"}]

    def test_layers_are_the_drivers_and_those_found_inside(self, monkeypatch: pytest.MonkeyPatch) -> None:
        fake = Fake("weak", 1, WORKS)
        _offer(monkeypatch, fake)
        (report,) = json.loads(CliRunner().invoke(doctor, ["--format", "json"]).stdout)["sandboxes"]
        assert report["layers"] == ["a wall", "a moat [deep]", "a lock"]
        # What holds on either side of the boundary is not missing.
        assert report["missing"] == ["swap limit", "Landlock"]
        assert "swapaccount=1" in report["fix"]
        assert "Linux 5.13" in report["fix"]
        assert report["image"] == "sha256:1"
        assert [worker.closed for worker in fake.launched] == [True]
        assert fake.swept == 1
        shown = CliRunner().invoke(doctor, env={"COLUMNS": "250"}).stdout
        assert "missing: swap limit; Landlock" in shown
        assert "swapaccount=1" in shown

    def test_a_sandbox_that_does_not_launch_does_not_work(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS, launches=False))
        result = CliRunner().invoke(doctor, ["--format", "json"])
        (report,) = json.loads(result.stdout)["sandboxes"]
        assert (report["works"], report["reason"], report["fix"]) == (False, "the drawbridge is up", "let it down")
        assert report["layers"] == []
        assert result.exit_code == 3

    def test_a_runtime_shows_the_drivers_that_know_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(Fake, "with_runtime", lambda self, runtime: Fake(f"{self.name} under {runtime}", 1, WORKS))
        _offer(monkeypatch, Fake("weak", 1, WORKS))
        report = json.loads(CliRunner().invoke(doctor, ["--format", "json", "--runtime", "runsc"]).stdout)
        assert [each["name"] for each in report["sandboxes"]] == ["weak under runsc"]

    def test_a_runtime_that_fails_says_nothing_of_other_sandboxes(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(Fake, "with_runtime", lambda self, runtime: self)
        _offer(monkeypatch, Fake("strong", 2, FAILS))
        result = CliRunner().invoke(doctor, ["--runtime", "runsc"], env={"COLUMNS": "200"})
        assert result.exit_code == 3
        assert "No sandbox works with --runtime runsc; `envcraft doctor` checks all sandboxes." in result.stdout
        assert "cannot validate anything" not in result.stdout

    def test_a_runtime_that_no_driver_takes_is_a_usage_error(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _offer(monkeypatch, Fake("weak", 1, WORKS))
        result = CliRunner().invoke(doctor, ["--runtime", "runsc"])
        assert isinstance(result.exception, UsageError)
        assert "docker" in str(result.exception)

    @pytest.mark.parametrize("arguments", [[], ["--format", "json"]])
    def test_without_a_sandbox_the_status_is_3(self, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
        _offer(monkeypatch, Fake("strong", 2, FAILS))
        assert CliRunner().invoke(doctor, arguments).exit_code == 3

    def test_importing_the_commands_is_cheap(self) -> None:
        program = "import envcraft_sandbox.commands, sys; print(sorted({'numpy', 'rich'} & sys.modules.keys()))"
        report = subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}; {program}"],
            capture_output=True,
            text=True,
        )
        assert report.stdout == "[]\n", report.stderr


class Response:
    """An answer of the engine as the SDK's exceptions hold it."""

    url, reason = "http+docker://localhost/x", "no"

    def __init__(self, status_code: int) -> None:
        self.status_code = status_code


class TestEngine:
    @pytest.mark.parametrize(
        ("status", "explanation", "kind"),
        [
            (500, "it is full.", engine.EngineError),
            (404, "no such container", engine.NotFoundError),
            (409, "removal is already in progress", engine.ConflictError),
            (500, "", engine.EngineError),
        ],
    )
    def test_a_refusal_keeps_its_type_and_gives_one_line(self, status: int, explanation: str, kind: type) -> None:
        from docker.errors import APIError

        with pytest.raises(engine.EngineError) as raised, engine.errors():
            raise APIError("no", response=Response(status), explanation=f"first line\n{explanation}")
        assert type(raised.value) is kind
        assert (explanation.rstrip(".") or "first line") in raised.value.reason
        assert "\n" not in str(raised.value)

    @pytest.mark.parametrize(
        ("cause", "reason"),
        [
            (PermissionError(13, "Permission denied"), "this user may not use the container engine"),
            (TimeoutError("timed out"), "did not answer in time"),
            (FileNotFoundError(2, "No such file"), r"no container engine answers \(its socket does not exist\)"),
            (ConnectionRefusedError(111, "Connection refused"), r"no container engine answers \(Connection refused\)"),
        ],
    )
    def test_the_first_cause_decides_on_the_fix(self, cause: OSError, reason: str) -> None:
        from docker.errors import DockerException

        error = DockerException("the connection failed")
        error.__cause__ = cause
        with pytest.raises(engine.EngineError, match=reason), engine.errors():
            raise error

    def test_without_the_sdk_the_driver_names_the_extra(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "docker", None)
        available = DockerDriver().probe()
        assert not available.works
        assert "envcraft-rl[docker]" in available.fix

    def test_a_missing_engine_gives_the_next_step(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("DOCKER_HOST", "unix:///nonexistent/engine.sock")
        result = CliRunner().invoke(sandbox, ["build", "--base", "host"])
        assert isinstance(result.exception, EnvCraftError)
        assert "no container engine answers (its socket does not exist)" in str(result.exception)
        assert "install Docker" in str(result.exception)
        assert "correct DOCKER_HOST" in str(result.exception)
        assert "Errno" not in str(result.exception)
        assert result.exception.exit_code == 3

    def test_a_pull_reports_each_status_once_and_its_error(self) -> None:
        events: list[dict[str, Any]] = [
            {"status": "Pulling from x"},
            {"status": "Downloading", "progressDetail": {"current": 1}},
            {"stream": "Step 1\n\n"},
            {"error": "there is no x"},
        ]
        with pytest.raises(engine.EngineError, match="there is no x"):
            list(engine.progress(events))
        assert list(engine.progress(events[:-1])) == ["Pulling from x", "Step 1"]


class TestDigest:
    def test_it_covers_all_that_the_image_is_made_of(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        names = [name for name, _ in build.worker_sources()]
        assert "envcraft_protocol/wire.py" in names
        assert "envcraft_sandbox/worker/server.py" in names
        assert "envcraft_protocol/adapters.py" in names
        assert not [name for name in names if name.endswith(("client.py", ".pyc"))]
        before = build.digest()
        for name in ("Dockerfile", "requirements.txt"):
            (tmp_path / name).write_bytes((build._IMAGE / name).read_bytes() + b"\n")
        monkeypatch.setattr(build, "_IMAGE", tmp_path)
        assert build.digest() != before
        assert build.digest("attrs==25.1.0") != build.digest()

    def test_an_image_with_more_packages_is_not_stale(self) -> None:
        named = "attrs==25.1.0 networkx"
        build.Built("sha256:1", build.digest(named), named).check()
        with pytest.raises(engine.EngineError, match=r"--packages FILE`, FILE naming attrs==25\.1\.0 networkx"):
            build.Built("sha256:1", build.digest(), named).check()


class TestPackages:
    def test_names_versions_and_comments_are_read(self, tmp_path: Path) -> None:
        path = tmp_path / "packages.txt"
        path.write_text(
            "# for the maze games\nnetworkx == 3.4.2  # graphs\n\nPy_Yaml\npy-yaml\nzope.event==5.0+local\n"
        )
        assert [str(each) for each in packages.read(str(path))] == [
            "networkx==3.4.2",
            "Py_Yaml",
            "zope.event==5.0+local",
        ]

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("numpy\nnetworkx>=3\n", ":2: 'networkx>=3' is not NAME or NAME==VERSION"),
            ("-r other.txt\n", ":1: '-r other.txt' is not"),
            ("--index-url=x\n", ":1: "),
            ("x @ file:///x\n", ":1: "),
            ("./local\n", ":1: "),
            ("x==1; python_version<'3.12'\n", ":1: "),
            ("x==1.*\n", ":1: "),
            ("a==1\nb\nA==2\n", ":3: A==2 contradicts a==1 at "),
            ("# nothing\n", "names no package"),
        ],
    )
    def test_a_bad_file_is_a_usage_error_and_names_the_line(self, tmp_path: Path, text: str, words: str) -> None:
        path = tmp_path / "packages.txt"
        path.write_text(text)
        result = CliRunner().invoke(sandbox, ["build", "--base", "host", "--packages", str(path)])
        assert isinstance(result.exception, UsageError)
        assert words in str(result.exception)
        assert str(path) in str(result.exception)

    @pytest.mark.parametrize("name", ["missing.txt", "binary.txt"])
    def test_a_file_that_cannot_be_read_is_a_usage_error(self, tmp_path: Path, name: str) -> None:
        (tmp_path / "binary.txt").write_bytes(b"\xff\xfe")
        with pytest.raises(UsageError, match=name):
            packages.read(str(tmp_path / name))

    def test_the_base_host_names_all_that_is_not_installed(self, tmp_path: Path) -> None:
        path = tmp_path / "packages.txt"
        path.write_text("click\nno-such-library\npluggy==0.0.1\n")
        with pytest.raises(UsageError) as raised:
            rootfs.collect([], packages.read(str(path)))
        assert "no-such-library" in str(raised.value)
        assert f"pluggy==0.0.1 ({path}:3) is installed as {version('pluggy')}" in str(raised.value)
        assert "click" not in str(raised.value)

    def test_the_base_host_takes_them_with_what_they_need(self) -> None:
        root = rootfs.collect([], [packages.Package("jsonschema", version("jsonschema"))])
        names = set(root.names())
        assert f"{rootfs.LIBRARIES_ROOT}/jsonschema/__init__.py" in names
        assert f"{rootfs.LIBRARIES_ROOT}/referencing/__init__.py" in names
        assert f"{rootfs.LIBRARIES_ROOT}/pluggy/__init__.py" not in names
