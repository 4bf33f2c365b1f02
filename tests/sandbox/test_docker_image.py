"""The docker sandbox alone: its image, its containers' configuration, and limits on all processes of a container."""

from __future__ import annotations

import gc
import json
import secrets
import signal
import textwrap
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from envcraft_sandbox import build, docker, engine, launch, leftovers
from envcraft_sandbox.docker import DockerDriver

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.driver import Limits, Worker
from envcraft.model.job import ExitReason

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
    """A label that only this test's containers have."""
    own = f"envcraft-test-{secrets.token_hex(6)}"
    monkeypatch.setattr(docker, "LABEL", own)
    return own


def _containers(label: str) -> list[str]:
    return [each["Id"] for each in engine.client().containers(all=True, filters={"label": label})]


def _inside(driver: DockerDriver, limits: Limits, label: str, program: str) -> Any:
    """Run a program beside the worker, outside the layers of a job, and return the JSON that it prints."""
    client = engine.client()
    worker = driver.launch(hash_seed=0, limits=limits)
    try:
        (container,) = _containers(label)
        python = client.inspect_container(container)["Config"]["Entrypoint"][0]
        made = client.exec_create(container, [python, "-S", "-c", textwrap.dedent(program)])
        printed = client.exec_start(made["Id"])
        assert worker.find(["numpy"]) == ([], [])
        return json.loads(printed)
    finally:
        worker.close()


class TestImage:
    @pytest.fixture
    def config(self, driver: DockerDriver) -> Any:
        return engine.client().inspect_image(build.TAG)["Config"]

    def test_its_label_is_the_digest_of_the_sources(self, config: Any) -> None:
        assert config["Labels"][build.LABEL] == build.digest(config["Labels"][build.PACKAGES_LABEL])
        assert config["Labels"][build.BASE_LABEL]

    def test_the_worker_tells_which_one_it_runs(self, worker: Worker) -> None:
        assert worker.about["image"] == engine.client().inspect_image(build.TAG)["Id"]

    def test_it_runs_the_worker_as_nobody(self, config: Any) -> None:
        assert config["User"] == "65534:65534"
        assert config["Entrypoint"][1:] == ["-B", "-s", "-P", "-m", "envcraft_sandbox.worker"]

    def test_it_has_no_program_but_the_interpreter(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        observed = _inside(
            driver,
            limits,
            label,
            """
            import json, os, stat, sys
            programs, elevating = set(), []
            for parent, _, names in os.walk("/"):
                if parent.startswith(("/proc", "/sys")):
                    continue
                for path in (os.path.join(parent, name) for name in names):
                    if os.path.isfile(path):
                        if os.stat(path).st_mode & (stat.S_ISUID | stat.S_ISGID):
                            elevating.append(path)
                        if os.path.basename(parent) in ("bin", "sbin") and os.access(path, os.X_OK):
                            programs.add(os.path.realpath(path))
            print(json.dumps([sorted(programs), os.path.realpath(sys.executable), elevating]))
            """,
        )
        programs, interpreter, elevating = observed
        assert interpreter in programs
        assert [program for program in programs if not Path(program).name.startswith("python3")] == []
        assert elevating == []

    def test_games_find_their_libraries(self, worker: Worker) -> None:
        missing, _ = worker.find(["numpy", "gymnasium"])
        assert missing == []


class TestContainer:
    def test_it_is_configured_as_promised(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        try:
            (container,) = _containers(label)
            inspected = engine.client().inspect_container(container)
            host, mounts = inspected["HostConfig"], inspected["Mounts"]
        finally:
            worker.close()
        assert host["NetworkMode"] == "none"
        assert host["ReadonlyRootfs"] is True
        assert host["Privileged"] is False
        assert host["CapDrop"] == ["ALL"]
        assert not host["CapAdd"]
        assert host["SecurityOpt"] == ["no-new-privileges"]
        assert host["Runtime"] == driver._info["DefaultRuntime"]
        assert host["Memory"] == host["MemorySwap"] == limits.memory + 256 * 1024**2
        assert host["PidsLimit"] == limits.processes + 1
        assert host["IpcMode"] == "private"
        assert host["ShmSize"] <= 1024**2
        assert host["LogConfig"]["Type"] == "none"
        assert host["AutoRemove"] is True
        assert not host["Init"]
        assert not host["Devices"]
        assert [mount["Destination"] for mount in mounts] == ["/run/envcraft/control.sock"]

    def test_the_kernel_agrees(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        observed = _inside(
            driver,
            limits,
            label,
            """
            import json, os
            mounts = {line.split()[1]: line.split()[3].split(",") for line in open("/proc/mounts")}
            status = dict(line.rstrip().split(":\\t") for line in open("/proc/self/status") if ":\\t" in line)
            print(json.dumps({
                "root": "ro" in mounts["/"],
                "tmp": [option for option in ("noexec", "nosuid", "nodev") if option not in mounts["/tmp"]],
                "network": os.listdir("/sys/class/net"),
                "ids": [status["Uid"], status["Gid"]],
                "capabilities": int(status["CapBnd"], 16),
                "seccomp": status["Seccomp"] == "2",
            }))
            """,
        )
        assert observed == {
            "root": True,
            "tmp": [],
            "network": ["lo"],
            "ids": ["\t".join(["65534"] * 4)] * 2,
            "capabilities": 0,
            "seccomp": "engine's seccomp profile" in driver.probe().layers,
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
        assert ran.end.reason is ExitReason.DONE
        assert "canary" not in ran.end.output

    def test_processes_are_counted(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        """Even those of a job that got past its own filter."""
        forked = _inside(
            driver,
            limits,
            label,
            """
            import json, os, signal
            children = []
            try:
                while len(children) < 500:
                    child = os.fork()
                    if child == 0:
                        signal.pause()
                    children.append(child)
            except OSError:
                pass
            for child in children:
                os.kill(child, 9)
            print(json.dumps(len(children)))
            """,
        )
        # Beside the fork server and the program itself.
        assert forked == limits.processes - 1

    def test_the_memory_of_all_processes_is_added_up(self, driver: DockerDriver, limits: Limits, label: str) -> None:
        ended = _inside(
            driver,
            limits,
            label,
            """
            import json, os, signal
            children = []
            for _ in range(6):
                child = os.fork()
                if child == 0:
                    # As a job does: rather this one than the fork server.
                    open("/proc/self/oom_score_adj", "w").write("1000")
                    kept = [b"x" * (1 << 20) for _ in range(300)]
                    os._exit(0)
                children.append(child)
            print(json.dumps([os.waitpid(child, 0)[1] for child in children]))
            """,
        )
        assert signal.SIGKILL in ended


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
        engine.client().kill(*_containers(label))
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
        monkeypatch.setitem(vars(driver), "_image", build.Built("envcraft-worker:no-such-tag", "", ""))
        with pytest.raises(SandboxUnavailable, match="no-such-tag"):
            driver.launch(hash_seed=0, limits=limits)
        assert _containers(label) == []

    def test_an_interrupted_launch_leaves_nothing(
        self, driver: DockerDriver, limits: Limits, label: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(*_: object) -> None:
            raise KeyboardInterrupt

        monkeypatch.setattr(docker.Container, "accept", interrupt)
        with pytest.raises(KeyboardInterrupt):
            driver.launch(hash_seed=0, limits=limits)
        assert _containers(label) == []

    def test_nothing_is_recorded_once_the_container_is_gone(self, driver: DockerDriver, limits: Limits) -> None:
        worker = driver.launch(hash_seed=0, limits=limits)
        recorded = list(leftovers.containers().iterdir())
        worker.close()
        gone = set(recorded) - set(leftovers.containers().iterdir())
        assert len(gone) == 1

    def test_no_connection_of_a_worker_stays_open(self, driver: DockerDriver, limits: Limits) -> None:
        gc.collect()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ResourceWarning)
            driver.launch(hash_seed=0, limits=limits).close()
            gc.collect()
        assert [str(each.message) for each in caught] == []


class TestProbe:
    def test_a_stale_image_is_noticed(self, driver: DockerDriver, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(build, "digest", lambda packages: "of other sources")
        available = driver.probe()
        assert not available.works
        assert "other sources" in available.reason
        assert "envcraft sandbox build" in available.fix

    def test_an_image_that_is_not_built_is_noticed(self, driver: DockerDriver, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(build, "TAG", "envcraft-worker:no-such-tag")
        available = DockerDriver().probe()
        assert not available.works
        assert "not built" in available.reason

    def test_an_unknown_runtime_is_noticed(self, driver: DockerDriver) -> None:
        available = driver.with_runtime("no-such-runtime").probe()
        assert not available.works
        assert "no runtime no-such-runtime" in available.reason
        assert "daemon.json" in available.fix

    @pytest.mark.parametrize(
        ("info", "missing"),
        [
            ({"SecurityOptions": ["name=seccomp,profile=unconfined"]}, "engine's seccomp profile"),
            ({"SecurityOptions": None}, "engine's seccomp profile"),
            ({"MemoryLimit": False}, "memory limit"),
            ({"SwapLimit": False}, "swap limit"),
            ({"PidsLimit": False}, "process limit"),
            ({"CpuCfsQuota": False}, "one CPU"),
        ],
    )
    def test_missing_layers_are_reported(
        self, driver: DockerDriver, monkeypatch: pytest.MonkeyPatch, info: dict[str, Any], missing: str
    ) -> None:
        whole: dict[str, Any] = dict.fromkeys(("MemoryLimit", "SwapLimit", "PidsLimit", "CpuCfsQuota"), True)
        whole["SecurityOptions"] = ["name=seccomp,profile=default"]
        monkeypatch.setitem(vars(driver), "_info", {**driver._info, **whole})
        assert driver.probe().missing == []
        monkeypatch.setitem(vars(driver), "_info", {**driver._info, **whole, **info})
        available = driver.probe()
        assert available.works
        assert available.missing == [missing]
        assert missing not in available.layers
