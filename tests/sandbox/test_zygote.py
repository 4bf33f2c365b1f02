"""Workers of one zygote: as far from each other as any two, and none the worse when it dies or cannot fork."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from envcraft_sandbox import bubblewrap, client, launch
from envcraft_sandbox.bubblewrap import BubblewrapDriver
from envcraft_sandbox.process import ProcessDriver
from envcraft_sandbox.zygote import ForkedWorker, Started, ZygoteDriver

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Driver, Limits, Worker
from envcraft.judging.engine import Plan, validate
from envcraft.model.events import CheckStarted, SubjectFinished
from envcraft.model.target import Target, read_target
from envcraft.plugins import plugins

from .conftest import environment

BUBBLEWRAP = pytest.param(BubblewrapDriver, marks=pytest.mark.bubblewrap, id="bubblewrap")
PROCESS = pytest.param(ProcessDriver, id="process")
_NAMESPACES = ("user", "pid", "mnt", "ipc", "net", "uts", "cgroup")

#: A program that goes into a worker's namespaces as its user, under none of the layers that jobs have besides.
_INSIDE = """
import ctypes, json, os, socket, sys
libc = ctypes.CDLL(None, use_errno=True)
assert libc.setns(os.pidfd_open(int(sys.argv[1])), 0x7E020000) == 0, os.strerror(ctypes.get_errno())
if os.fork():
    sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
token = sys.argv[2]

def leave():
    for folder in ("/tmp/job", "/dev/shm"):
        open(f"{folder}/{token}", "w").close()
    libc.shmget(77, 4096, 0o1666)
    socket.sethostname(token)
    kept.bind("\\0" + token)

def look():
    client = socket.socket(socket.AF_UNIX)
    try:
        client.connect("\\0" + token)
        heard = True
    except OSError:
        heard = False
    return {
        "files": [folder for folder in ("/tmp/job", "/dev/shm") if os.path.exists(f"{folder}/{token}")],
        "memory": libc.shmget(77, 4096, 0) >= 0,
        "name": socket.gethostname() == token,
        "socket": heard,
        "interfaces": [name for _, name in socket.if_nameindex()],
        "processes": sorted(int(name) for name in os.listdir("/proc") if name.isdigit()),
    }

kept = socket.socket(socket.AF_UNIX)
if sys.argv[3] == "leave":
    leave()
    kept.listen()
print(json.dumps(look()), flush=True)
sys.stdin.read()
"""


def pid_of(worker: Worker) -> int:
    """A forked worker's process as this one sees it."""
    assert isinstance(worker, ForkedWorker)
    status = Path(f"/proc/self/fdinfo/{worker._pidfd}").read_text()
    return int(status.partition("Pid:")[2].split()[0])


def inside(worker: Worker, token: str, what: str) -> subprocess.Popen[str]:
    argv = [sys.executable, "-c", _INSIDE, str(pid_of(worker)), token, what]
    return subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def seen(worker: Worker, token: str, what: str = "look") -> dict[str, Any]:
    with inside(worker, token, what) as process:
        output, _ = process.communicate()
    found: dict[str, Any] = json.loads(output)
    return found


@pytest.fixture(scope="module")
def nested() -> Iterator[ZygoteDriver]:
    available = BubblewrapDriver().probe()
    if not available.works:
        pytest.skip(f"{available.reason}; {available.fix}")
    made = BubblewrapDriver().shared_layout()
    assert isinstance(made, ZygoteDriver)
    yield made
    made.close()


@pytest.fixture(scope="module")
def pair(nested: ZygoteDriver, limits: Limits) -> Iterator[list[Worker]]:
    """Two workers of one zygote."""
    made = [nested.launch(hash_seed=0, limits=limits) for _ in range(2)]
    assert nested.refusal == ""
    yield made
    for worker in made:
        worker.close()


@pytest.fixture
def zygotes(request: pytest.FixtureRequest) -> Iterator[ZygoteDriver]:
    """One of the driver that is the test's parameter, of its own."""
    driver: Driver = request.param()
    available = driver.probe()
    if not available.works:
        pytest.skip(f"{available.reason}; {available.fix}")
    made = driver.shared_layout()
    assert isinstance(made, ZygoteDriver)
    yield made
    made.close()


@pytest.mark.bubblewrap
class TestNamespaces:
    def test_each_worker_has_all_of_its_own(self, nested: ZygoteDriver, pair: list[Worker]) -> None:
        processes = ["self", zygote_of(nested), *map(pid_of, pair)]
        for kind in _NAMESPACES:
            assert len({os.readlink(f"/proc/{process}/ns/{kind}") for process in processes}) == len(processes), kind

    def test_nothing_that_one_leaves_is_seen_by_another(self, pair: list[Worker]) -> None:
        token = f"ec{random.randrange(10**9)}"
        with inside(pair[0], token, "leave") as left:
            assert left.stdout is not None
            own = json.loads(left.stdout.readline())
            assert own["files"] == ["/tmp/job", "/dev/shm"]
            assert own["memory"]
            assert own["name"]
            assert own["socket"]
            assert seen(pair[0], token)["socket"]
            # Its own two, and this one.
            assert seen(pair[1], token) == {
                "files": [], "memory": False, "name": False, "socket": False, "interfaces": ["lo"], "processes": [1, 2]
            }  # fmt: skip
            left.communicate()

    def test_it_has_no_rights_and_no_way_to_get_any(self, pair: list[Worker]) -> None:
        for worker in pair:
            lines = Path(f"/proc/{pid_of(worker)}/status").read_text().splitlines()
            status = {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}
            assert {int(status[kind], 16) for kind in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {0}
            assert status["NoNewPrivs"] == "1"
            assert status["NSpid"].split()[-1] == "1"

    def test_what_all_share_is_read_only(self, pair: list[Worker]) -> None:
        writable = {
            mount.split()[4]
            for mount in Path(f"/proc/{pid_of(pair[0])}/mountinfo").read_text().splitlines()
            if mount.split()[5].split(",")[0] == "rw"
        }
        # Devices that the host has for everybody, what each worker mounts for itself, and what that lies over.
        devices = {f"/dev/{name}" for name in ("null", "zero", "full", "random", "urandom", "tty")}
        assert writable - devices == {"/proc", "/dev/shm", "/tmp/job"}

    def test_a_user_namespace_more_is_refused(self, pair: list[Worker]) -> None:
        program = """
import ctypes, os, sys
libc = ctypes.CDLL(None, use_errno=True)
assert libc.setns(os.pidfd_open(int(sys.argv[1])), 0x7E020000) == 0
print(libc.unshare(0x10000000), os.strerror(ctypes.get_errno()))
try:
    print(open("/proc/sys/kernel/core_pattern", "w"))
except OSError as error:
    print(error.strerror)
"""
        status = subprocess.run(
            [sys.executable, "-c", program, str(pid_of(pair[0]))], capture_output=True, text=True, check=True
        )
        assert status.stdout == "-1 No space left on device\nRead-only file system\n"


@pytest.mark.parametrize("zygotes", [BUBBLEWRAP, PROCESS], indirect=True)
class TestWorkers:
    def test_each_ends_alone_and_for_good(self, zygotes: ZygoteDriver, limits: Limits, play: Any) -> None:
        first, second = (zygotes.launch(hash_seed=0, limits=limits) for _ in range(2))
        process = pid_of(first)
        first.close()
        first.close()
        # It is reaped, too.
        assert ends(process)
        assert play(second, environment()).trace.steps == 8
        # Deaf to its host.
        process = pid_of(second)
        os.kill(process, signal.SIGSTOP)
        second.close()
        assert ends(process)

    def test_addresses_are_alike_in_siblings_and_in_no_other(
        self, zygotes: ZygoteDriver, limits: Limits, play: Any
    ) -> None:
        source = environment(top="import numpy; print(id(numpy.random))")
        siblings = [zygotes.launch(hash_seed=0, limits=limits) for _ in range(2)]
        others = [
            zygotes.launch(hash_seed=1, limits=limits),
            zygotes._driver.launch(hash_seed=0, limits=limits),
        ]
        first, second, *rest = (play(worker, source).facts for worker in [*siblings, *others])
        assert first == second
        assert len({first, *rest}) == 3
        for worker in [*siblings, *others]:
            worker.close()

    def test_a_zygote_that_dies_is_replaced(self, zygotes: ZygoteDriver, limits: Limits, play: Any) -> None:
        worker = zygotes.launch(hash_seed=0, limits=limits)
        kill(zygotes, 0)
        # Only namespaces end with the process that made them.
        if zygotes.name == "process":
            assert play(worker, environment()).trace.steps == 8
        else:
            with pytest.raises(WorkerLost):
                play(worker, environment())
        worker.close()
        other = zygotes.launch(hash_seed=0, limits=limits)
        assert isinstance(other, ForkedWorker)
        assert play(other, environment()).trace.steps == 8
        other.close()

    def test_after_its_end_there_are_none(self, zygotes: ZygoteDriver, limits: Limits) -> None:
        zygotes.close()
        with pytest.raises(SandboxUnavailable):
            zygotes.launch(hash_seed=0, limits=limits)


class TestFallback:
    @pytest.mark.bubblewrap
    def test_where_namespaces_cannot_be_nested_workers_are_launched(
        self, nested: ZygoteDriver, limits: Limits, play: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        isolate = bubblewrap.isolate
        monkeypatch.setattr(bubblewrap, "isolate", lambda *arguments, nested=False: isolate(*arguments))
        zygotes = BubblewrapDriver().shared_layout()
        assert isinstance(zygotes, ZygoteDriver)
        for _ in range(2):
            worker = zygotes.launch(hash_seed=0, limits=limits)
            assert isinstance(worker, launch.ChildWorker)
            assert "unshare" in zygotes.refusal
        assert play(worker, environment()).trace.steps == 8
        zygotes.close()

    @pytest.mark.parametrize("program", ["import sys; sys.exit('no room')", "import os; os.closerange(3, 99)"])
    def test_where_none_starts_workers_are_launched(self, limits: Limits, program: str) -> None:
        started = []

        def start(hash_seed: int) -> Started:
            started.append(Started(*launch.spawn([sys.executable, "-S", "-c", program], {}, "process")))
            return started[-1]

        zygotes = ZygoteDriver(ProcessDriver(), start)
        for _ in range(2):
            worker = zygotes.launch(hash_seed=0, limits=limits)
            assert isinstance(worker, launch.ChildWorker)
            worker.close()
        zygotes.close()
        assert len(started) == 3
        assert all(each.process.poll() is not None for each in started)
        assert "has ended" in zygotes.refusal


_LINES = ("pass", "self.steps += hash('snow') % 2", "x = [self.steps]")
TINY = [Target(f"tiny{number}.py", environment(step=line).encode()) for number, line in enumerate(_LINES)]


def judged(driver: Driver, targets: list[Target], kill_in: list[ZygoteDriver] | None = None) -> list[Any]:
    """What some checks find; with `kill_in` a zygote is killed while each environment is judged."""
    checks = [check for check in plugins().collect("envcraft_checks") if check.name in ("source", "determinism")]
    found, killed = [], 0
    for event in validate(Plan(targets, ARCADE, driver, checks, BUDGETS["quick"], parallel_jobs=1), workers=1):
        if kill_in is not None and isinstance(event, CheckStarted) and event.check == "determinism":
            killed += kill(kill_in[-1], 0)
        if isinstance(event, SubjectFinished):
            found.append([(each.check, each.verdict, each.reason, each.findings) for each in event.report.checks])
    assert kill_in is None or killed == len(targets)
    return found


@pytest.fixture(scope="module")
def undisturbed() -> list[Any]:
    return judged(ProcessDriver(), TINY)


@pytest.mark.parametrize("kind", [BUBBLEWRAP, PROCESS])
def test_no_verdict_depends_on_a_zygote_s_life(kind: type[Driver], undisturbed: list[Any]) -> None:
    available = kind().probe()
    if not available.works:
        pytest.skip(f"{available.reason}; {available.fix}")
    forking: list[ZygoteDriver] = []

    class Noted(kind):  # type: ignore[misc, valid-type]
        def shared_layout(self) -> Driver:
            forking.append(super().shared_layout())
            return forking[-1]

    assert judged(Noted(), TINY, forking) == undisturbed
    assert {found.code for _, _, _, findings in undisturbed[1] for found in findings} == {"EC203"}


@pytest.mark.parametrize("zygotes", [BUBBLEWRAP], indirect=True)
def test_forked_workers_show_what_follows_addresses_or_process_ids(zygotes: ZygoteDriver, root: Path) -> None:
    folder = root / "tests" / "fixtures" / "determinism" / "bad"
    targets = [read_target(str(folder / name)) for name in ("set_of_objects.py", "process_id.py")]
    for checks in judged(zygotes._driver, targets):
        assert {found.code for _, _, _, findings in checks for found in findings} == {"EC202"}


def zygote_of(zygotes: ZygoteDriver, hash_seed: int = 0) -> int:
    """Its process: where it has namespaces, bwrap's only child."""
    started = zygotes._zygotes[hash_seed]._started
    assert started is not None
    children = Path(f"/proc/{started.process.pid}/task/{started.process.pid}/children").read_text().split()
    return int(children[0]) if zygotes.name == "bubblewrap" else started.process.pid


def kill(zygotes: ZygoteDriver, hash_seed: int) -> bool:
    """Kill a zygote that has forked at least once, and wait for its end."""
    zygote = zygotes._zygotes.get(hash_seed)
    if zygote is None or not zygote._ready or zygote._started is None:
        return False
    zygote._started.process.kill()
    zygote._started.process.wait()
    return True


def ends(process: int) -> bool:
    deadline = time.monotonic() + 60
    while Path(f"/proc/{process}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    return not Path(f"/proc/{process}").exists()


def test_slow_worker_is_reported_as_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "_SERVER_SECONDS", 0.2)
    late = "import socket, sys; socket.socket(fileno=int(sys.argv[2])).recv(1); sys.exit('Broken pipe')"
    begun = launch.start([sys.executable, "-c", late], dict(os.environ), Limits(), "process")
    with pytest.raises(SandboxUnavailable, match="did not start: the worker was silent"):
        begun()
