"""The docker sandbox under gVisor: what a job does there costs that job its end, and nothing else."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from envcraft_sandbox import launch
from envcraft_sandbox.commands import examine
from envcraft_sandbox.docker import DockerDriver

from envcraft.errors import SandboxUnavailable
from envcraft.judging.driver import Limits, Worker
from envcraft.model.job import ExitReason
from envcraft.model.verdict import SandboxReport

pytestmark = pytest.mark.gvisor

Environment = Callable[..., str]


@pytest.fixture(scope="module")
def driver() -> DockerDriver:
    made = DockerDriver("runsc")
    found = examine(made)
    if not found.works:
        pytest.skip(f"{found.reason}; {found.fix}")
    return made


@pytest.fixture(scope="module")
def worker(driver: DockerDriver, limits: Limits) -> Iterator[Worker]:
    """One for all tests: it must outlive all that the jobs do."""
    made = driver.launch(hash_seed=0, limits=limits)
    yield made
    made.close()


def test_a_trace_is_the_same_as_under_the_default_runtime(
    worker: Worker, limits: Limits, environment: Environment, play: Any
) -> None:
    other = DockerDriver().launch(hash_seed=0, limits=limits)
    try:
        wanted = play(other, environment(), seed=3).trace
    finally:
        other.close()
    found = play(worker, environment(), seed=3).trace
    assert found.observations == wanted.observations
    assert found.rewards == wanted.rewards


def test_another_kernel_answers(worker: Worker, environment: Environment, play: Any) -> None:
    source = environment(top="import json, os; print(json.dumps(os.uname().release))")
    assert play(worker, source).facts != platform.release()


def test_the_report_names_it_and_what_it_lacks(driver: DockerDriver, worker: Worker) -> None:
    available = driver.probe()
    told = SandboxReport.of(driver.name, available.layers, available.missing, worker.about)
    assert "runtime runsc" in told.layers
    assert "system call filter" in told.layers
    # The engine's profiles are for its default runtime, and gVisor's kernel has no Landlock.
    assert not [layer for layer in told.layers if "profile" in layer]
    assert "Landlock" in told.missing
    assert told.image
    assert told.image.startswith("sha256:")


@pytest.mark.parametrize(
    ("step", "ends"),
    [
        pytest.param("import os; os._exit(0)", {ExitReason.DIED}, id="exit"),
        pytest.param("import ctypes; ctypes.string_at(0)", {ExitReason.DIED}, id="crash"),
        pytest.param("while True: pass", {ExitReason.TIMEOUT}, id="hang"),
        pytest.param("while True: print('x' * 999)", {ExitReason.FLOOD}, id="flood"),
        pytest.param(
            "kept = [b'x' * (1 << 20) for _ in range(4096)]",
            # On a busy machine filling it takes longer than a step may.
            {ExitReason.DONE, ExitReason.MEMORY, ExitReason.DIED, ExitReason.TIMEOUT},
            id="memory",
        ),
        pytest.param(
            "import os\nfor victim in (1, -1, os.getppid()):\n    os.kill(victim, 9)",
            {ExitReason.DONE, ExitReason.DIED},
            id="kill",
        ),
        pytest.param(
            "import os\nwhile True: os.fork()",
            {ExitReason.DONE, ExitReason.DIED, ExitReason.TIMEOUT, ExitReason.FORGED},
            id="fork",
        ),
        pytest.param("import socket; socket.create_connection(('1.1.1.1', 53))", {ExitReason.DONE}, id="network"),
        pytest.param("open('/opt/envcraft/x', 'w')", {ExitReason.DONE}, id="root"),
        pytest.param(
            "from pathlib import Path\nfor n in range(10**6): Path(f'/tmp/{n}').write_bytes(b'x' * (1 << 20))",
            {ExitReason.DONE, ExitReason.DIED, ExitReason.MEMORY, ExitReason.TIMEOUT},
            id="disk",
        ),
    ],
)
def test_it_costs_the_job_alone(
    worker: Worker, environment: Environment, play: Any, step: str, ends: set[ExitReason]
) -> None:
    ran = play(worker, environment(step=step))
    assert ran.end.reason in ends
    # Whatever was refused shows as an exception of the job's own.
    assert ran.trace.fault is not None or ran.end.reason is not ExitReason.DONE
    after = play(worker, environment())
    assert after.end.reason is ExitReason.DONE
    assert after.trace.steps == 8


def test_nothing_of_the_host_can_be_read(worker: Worker, environment: Environment, play: Any, tmp_path: Path) -> None:
    (tmp_path / "canary").write_text("")
    source = environment(
        top=f"""
        import json, os
        found = []
        for path in ("/run/docker.sock", "/etc/shadow", "{tmp_path}/canary"):
            if os.path.lexists(path):
                found.append(path)
        try:
            open("/proc/1/mem", "rb").read(1)
            found.append("the memory of the fork server")
        except OSError:
            pass
        print(json.dumps(found))
        """
    )
    assert play(worker, source).facts == []


def test_a_launch_that_fails_says_what_gvisor_needs(
    driver: DockerDriver, limits: Limits, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launch, "environment", lambda _: {"PYTHONPATH": "/nowhere"})
    with pytest.raises(SandboxUnavailable, match="--host-uds=open"):
        driver.launch(hash_seed=0, limits=limits)
