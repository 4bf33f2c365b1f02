"""What only the container has: its image, the configuration it runs under, and limits on all its processes together."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from envcraft_sandbox import build, docker, engine, launch
from envcraft_sandbox.docker import DockerDriver

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import How, Limits, Worker

pytestmark = pytest.mark.docker

Environment = Callable[..., str]


@pytest.fixture(scope="module")
def driver() -> DockerDriver:
    made = DockerDriver()
    available = made.probe()
    if not available.works:
        pytest.skip(f"{available.reason}; {available.fix}")
    return made


@pytest.fixture(scope="module")
def worker(driver: DockerDriver, limits: Limits) -> Iterator[Worker]:
    made = driver.launch(hash_seed=0, limits=limits)
    yield made
    made.close()


@pytest.fixture
def label(monkeypatch: pytest.MonkeyPatch) -> str:
    """A label that only this test's containers carry."""
    own = f"envcraft-test={secrets.token_hex(6)}"
    monkeypatch.setattr(docker, "LABEL", own)
    return own


def _containers(label: str) -> list[str]:
    return engine.docker("ps", "--all", "--quiet", "--no-trunc", "--filter", f"label={label}").split()


class TestImage:
    @pytest.fixture
    def config(self, driver: DockerDriver) -> Any:
        return json.loads(engine.docker("image", "inspect", "--format", "{{json .Config}}", build.TAG))

    def test_its_label_is_the_digest_of_the_sources(self, config: Any) -> None:
        assert config["Labels"][build.LABEL] == build.digest()
        assert config["Labels"][build.BASE_LABEL]

    def test_it_runs_the_worker_as_nobody(self, config: Any) -> None:
        assert config["User"] == "65534:65534"
        assert config["Entrypoint"][1:] == ["-B", "-s", "-P", "-m", "envcraft_sandbox.worker"]

    def test_it_has_no_shell_and_no_program_that_changes_the_user(
        self, worker: Worker, environment: Environment, play: Any
    ) -> None:
        source = environment(
            top="""
            import json, os, stat
            found = []
            for folder in ("/bin", "/sbin", "/usr/bin", "/usr/sbin", "/usr/local/bin", "/usr/lib"):
                for parent, _, names in os.walk(folder):
                    for name in names:
                        path = os.path.join(parent, name)
                        shell = name in ("sh", "bash", "dash", "rbash", "ash", "zsh", "ksh", "busybox", "perl", "su")
                        if os.path.exists(path) and (shell or os.stat(path).st_mode & (stat.S_ISUID | stat.S_ISGID)):
                            found.append(path)
            print(json.dumps(found))
            """
        )
        assert play(worker, source, limits=Limits(loading=20.0)).facts == []

    def test_games_find_their_libraries(self, worker: Worker) -> None:
        missing, _ = worker.find(["numpy", "gymnasium"])
        assert missing == []


class TestContainer:
    def test_it_is_configured_as_promised(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        try:
            (container,) = _containers(label)
            host = json.loads(engine.docker("inspect", "--format", "{{json .HostConfig}}", container))
            mounts = json.loads(engine.docker("inspect", "--format", "{{json .Mounts}}", container))
        finally:
            worker.close()
        assert host["NetworkMode"] == "none"
        assert host["ReadonlyRootfs"] is True
        assert host["Privileged"] is False
        assert host["CapDrop"] == ["ALL"]
        assert not host["CapAdd"]
        assert host["SecurityOpt"] == ["no-new-privileges"]
        assert host["Memory"] == host["MemorySwap"] == limits.memory + 256 * 1024**2
        assert host["PidsLimit"] == limits.processes + 1
        assert host["IpcMode"] == "private"
        assert host["ShmSize"] <= 1024**2
        assert host["LogConfig"]["Type"] == "none"
        assert host["AutoRemove"] is True
        assert not host["Init"]
        assert not host["Devices"]
        assert [mount["Destination"] for mount in mounts] == ["/run/envcraft/control.sock"]

    def test_the_kernel_agrees(self, driver: DockerDriver, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            mounts = {line.split()[1]: line.split()[3].split(",") for line in open("/proc/mounts")}
            status = dict(line.rstrip().split(":\\t") for line in open("/proc/self/status") if ":\\t" in line)
            print(json.dumps({
                "root": "ro" in mounts["/"],
                "tmp": [option for option in ("noexec", "nosuid", "nodev") if option not in mounts["/tmp"]],
                "network": os.listdir("/sys/class/net"),
                "ids": [status["Uid"], status["Gid"]],
                "seccomp": status["Seccomp"] == "2",
            }))
            """
        )
        assert play(worker, source).facts == {
            "root": True,
            "tmp": [],
            "network": ["lo"],
            "ids": ["\t".join(["65534"] * 4)] * 2,
            "seccomp": "seccomp" in driver.probe().layers,
        }

    def test_the_proxies_of_docker_stay_outside(
        self,
        driver: DockerDriver,
        limits: Limits,
        environment: Environment,
        play: Any,
        monkeypatch: pytest.MonkeyPatch,
        tmp_path: Path,
    ) -> None:
        proxies = {"httpProxy": "http://user:canary@proxy.invalid", "httpsProxy": "http://user:canary@proxy.invalid"}
        (tmp_path / "config.json").write_text(json.dumps({"proxies": {"default": proxies}}))
        monkeypatch.setenv("DOCKER_CONFIG", str(tmp_path))
        worker = driver.launch(hash_seed=0, limits=limits)
        try:
            ran = play(worker, environment(top="import os; print(dict(os.environ))"))
        finally:
            worker.close()
        assert ran.end.how is How.DONE
        assert "canary" not in ran.end.output

    def test_processes_are_counted(self, worker: Worker, environment: Environment, play: Any, limits: Limits) -> None:
        source = environment(
            top="""
            import json, os, time
            count = 0
            try:
                while count < 500:
                    if os.fork() == 0:
                        time.sleep(60)
                        os._exit(0)
                    count += 1
            except OSError:
                pass
            print(json.dumps(count))
            """
        )
        assert play(worker, source).facts == limits.processes - 1
        assert play(worker, environment()).trace.steps == 8

    def test_a_fork_bomb_hurts_nobody(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            step="""
            import os
            while True:
                try:
                    os.fork()
                    os.setsid()
                except OSError:
                    pass
            """
        )
        assert play(worker, source).end.how in (How.TIMEOUT, How.FORGED)
        assert play(worker, environment()).trace.steps == 8

    def test_the_memory_of_all_processes_is_added_up(
        self, worker: Worker, environment: Environment, play: Any, limits: Limits
    ) -> None:
        source = environment(
            step="""
            import os, time
            for _ in range(6):
                if os.fork() == 0:
                    break
            kept = [b"x" * (1 << 20) for _ in range(300)]
            time.sleep(60)
            """
        )
        ran = play(worker, source, limits=msgspec.structs.replace(limits, call=5.0))
        assert ran.end.how in (How.DIED, How.TIMEOUT)
        assert play(worker, environment()).trace.steps == 8


class TestLaunch:
    def test_no_container_remains(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        assert len(_containers(label)) == 1
        worker.close()
        assert _containers(label) == []
        worker.close()

    def test_a_container_that_is_killed_is_noticed(
        self, driver: DockerDriver, limits: Limits, label: str, environment: Environment, play: Any
    ) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        engine.docker("kill", *_containers(label))
        with pytest.raises(WorkerLost):
            play(worker, environment())
        worker.close()
        assert _containers(label) == []

    def test_a_container_that_ends_at_once_gives_its_reason(
        self, driver: DockerDriver, limits: Limits, label: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(launch, "environment", lambda _: {"PYTHONPATH": "/nowhere"})
        with pytest.raises(SandboxUnavailable, match="envcraft_sandbox"):
            driver.launch(hash_seed=0, limits=limits)
        assert _containers(label) == []

    def test_docker_refusing_gives_its_reason(
        self, driver: DockerDriver, limits: Limits, label: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(build, "TAG", "envcraft-worker:no-such-tag")
        with pytest.raises(SandboxUnavailable, match="no-such-tag"):
            driver.launch(hash_seed=0, limits=limits)
        assert _containers(label) == []

    def test_an_interrupted_launch_leaves_nothing(
        self, driver: DockerDriver, limits: Limits, label: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(docker, "_accept", interrupt)
        with pytest.raises(KeyboardInterrupt):
            driver.launch(hash_seed=0, limits=limits)
        assert _containers(label) == []


class TestProbe:
    def test_a_stale_image_is_noticed(self, driver: DockerDriver, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(build, "digest", lambda: "of other sources")
        available = driver.probe()
        assert not available.works
        assert "other sources" in available.reason
        assert "envcraft sandbox build" in available.fix

    def test_an_image_that_is_not_built_is_noticed(self, driver: DockerDriver, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(build, "TAG", "envcraft-worker:no-such-tag")
        available = driver.probe()
        assert not available.works
        assert "not built" in available.reason

    def test_an_unknown_runtime_is_noticed(self, driver: DockerDriver) -> None:
        assert "no-such-runtime" in DockerDriver(runtime="no-such-runtime").probe().reason
