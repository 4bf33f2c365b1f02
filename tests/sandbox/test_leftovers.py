"""The cleanup after a killed process: it removes everything of that process and nothing of others."""

from __future__ import annotations

import ctypes
import fcntl
import os
import random
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from envcraft_sandbox import engine, leftovers
from envcraft_sandbox.bubblewrap import BubblewrapDriver
from envcraft_sandbox.docker import OWNER_LABEL, DockerDriver
from envcraft_sandbox.process import ProcessDriver

from envcraft.errors import SandboxUnavailable
from envcraft.judging.driver import Driver
from envcraft.judging.selection import driver_named

_HOLD = """
import sys, time
from envcraft_sandbox import leftovers
made = leftovers.folder()
(made / "job").mkdir()
print(made, flush=True)
if sys.argv[1:]:
    import subprocess
    subprocess.Popen(["sleep", sys.argv[1]], pass_fds=[leftovers.lifeline()], stdout=subprocess.DEVNULL)
    print("started", flush=True)
time.sleep(60)
"""
#: Writes files for as long as it is let.
_BUSY = """
import time
import gymnasium as gym

for number in range(2000):
    with open(str(number), "w") as stream:
        stream.write("x")
    time.sleep(0.004)

class Busy(gym.Env): ...
"""
_PR_SET_CHILD_SUBREAPER = 36
Hold = Callable[..., tuple[subprocess.Popen[str], Path]]
DRIVERS = [
    pytest.param(DockerDriver, marks=pytest.mark.docker, id="docker"),
    pytest.param(BubblewrapDriver, marks=pytest.mark.bubblewrap, id="bubblewrap"),
    pytest.param(ProcessDriver, id="process"),
]


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary directory of the test's own, for this process and those that it starts."""
    path = tmp_path / "t"
    path.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(path))
    monkeypatch.setattr(leftovers, "_own", None)
    monkeypatch.setenv("TMPDIR", str(path))
    return path


@pytest.fixture
def hold() -> Iterator[Hold]:
    """Start a process that has a folder, and maybe a program that outlives it by some seconds."""
    started = []

    def start(*arguments: str) -> tuple[subprocess.Popen[str], Path]:
        process = subprocess.Popen([sys.executable, "-c", _HOLD, *arguments], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout
        path = Path(process.stdout.readline().strip())
        if arguments:
            assert process.stdout.readline() == "started\n"
        return process, path

    yield start
    for process in started:
        process.kill()
        process.wait()
        assert process.stdout
        process.stdout.close()


def _kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()


class TestFolder:
    def test_it_is_this_users_alone_and_one_for_the_process(self, temporary: Path) -> None:
        path = leftovers.folder()
        assert path == leftovers.folder()
        assert path.is_relative_to(temporary)
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(path.parent.stat().st_mode) == 0o700

    def test_a_folder_that_others_can_enter_is_refused(self, temporary: Path) -> None:
        (temporary / f"envcraft-{os.geteuid()}").mkdir(mode=0o755)
        with pytest.raises(SandboxUnavailable, match="set TMPDIR"):
            leftovers.folder()
        leftovers.sweep()

    def test_a_link_in_its_place_is_refused(self, temporary: Path, tmp_path: Path) -> None:
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        (temporary / f"envcraft-{os.geteuid()}").symlink_to(tmp_path / "elsewhere")
        with pytest.raises(SandboxUnavailable, match="set TMPDIR"):
            leftovers.folder()

    def test_no_room_is_a_sentence(self, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tempfile, "tempdir", str(temporary / "missing"))
        with pytest.raises(SandboxUnavailable, match="set TMPDIR"):
            leftovers.folder()

    def test_leaving_removes_it(self, temporary: Path) -> None:
        code = "from envcraft_sandbox import leftovers; (leftovers.folder() / 'x').mkdir(); print(leftovers.folder())"
        completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert Path(completed.stdout.strip()).parent.is_relative_to(temporary)
        assert not Path(completed.stdout.strip()).exists()


class TestSweep:
    def test_the_folder_of_a_killed_process_goes(self, temporary: Path, hold: Hold) -> None:
        process, path = hold()
        _kill(process)
        assert path.is_dir()
        leftovers.sweep()
        assert not path.exists()

    def test_the_folders_of_living_processes_stay(self, temporary: Path, hold: Hold) -> None:
        own = leftovers.folder()
        _, path = hold()
        leftovers.sweep()
        assert own.is_dir()
        assert (path / "job").is_dir()

    def test_it_waits_for_what_the_process_started(self, temporary: Path, hold: Hold) -> None:
        process, path = hold("1.5")
        _kill(process)
        started = time.monotonic()
        leftovers.sweep()
        assert 0.5 < time.monotonic() - started < 60
        assert not path.exists()

    def test_what_does_not_end_is_left_to_the_next_time(
        self, temporary: Path, hold: Hold, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(leftovers, "_END_SECONDS", 0.2)
        process, path = hold("2")
        _kill(process)
        leftovers.sweep()
        assert path.is_dir()
        monkeypatch.setattr(leftovers, "_END_SECONDS", 5.0)
        leftovers_of(temporary)
        assert not path.exists()

    def test_two_at_once_do_not_meet(self, temporary: Path, hold: Hold) -> None:
        process, path = hold()
        _kill(process)
        descriptor = os.open(path, os.O_RDONLY)
        # As another sweep holds it.
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        leftovers.sweep()
        assert path.is_dir()
        os.close(descriptor)
        leftovers.sweep()
        assert not path.exists()

    def test_with_nothing_to_do_it_runs_nothing_and_takes_no_time(
        self, temporary: Path, hold: Hold, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        hold()
        monkeypatch.setattr(subprocess, "Popen", None)
        started = time.monotonic()
        leftovers.sweep()
        assert time.monotonic() - started < 1

    def test_strange_things_beside_are_left_alone(self, temporary: Path, hold: Hold) -> None:
        process, path = hold()
        (path.parent / "file").write_text("")
        (path.parent / "link").symlink_to("/etc")
        _kill(process)
        leftovers.sweep()
        assert sorted(each.name for each in path.parent.iterdir()) == ["file", "link"]

    def test_an_engine_that_does_not_answer_keeps_the_record(
        self, temporary: Path, hold: Hold, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        process, path = hold()
        (path / "containers" / "envcraft-x").mkdir(parents=True)
        _kill(process)
        monkeypatch.setenv("DOCKER_HOST", "unix:///nonexistent/engine.sock")
        leftovers.sweep()
        assert path.is_dir()


class TestRemove:
    def test_removes_what_untrusted_code_made(self, tmp_path: Path) -> None:
        kept = tmp_path / "kept"
        (kept / "inner").mkdir(parents=True)
        (kept / "file").write_text("")
        top = tmp_path / "top"
        top.mkdir()
        for name in ("closed", "closed/below", "closed/below/further"):
            (top / name).mkdir()
        (top / "closed/below/file").write_text("x")
        (top / "link").symlink_to(kept)
        (top / "closed/link").symlink_to(kept)
        os.mkfifo(top / "pipe")
        here = os.open(top, os.O_RDONLY)
        for _ in range(1500):
            os.mkdir("deep", dir_fd=here)
            below = os.open("deep", os.O_RDONLY, dir_fd=here)
            os.close(here)
            here = below
        os.close(here)
        for name in ("closed/below/further", "closed/below", "closed"):
            (top / name).chmod(0)
        leftovers.remove(top)
        assert not top.exists()
        assert sorted(each.name for each in kept.iterdir()) == ["file", "inner"]
        leftovers.remove(top)


def leftovers_of(temporary: Path) -> list[str]:
    """Start the next command, and give the folders and files that are still there of the ones before."""
    driver_named("process")
    return [str(path) for path in (temporary / f"envcraft-{os.geteuid()}").rglob("*")]


@pytest.fixture
def orphans() -> Iterator[Callable[[], list[int]]]:
    """Adopt the orphans of this test, and list those that still run."""
    libc = ctypes.CDLL(None)
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    before = _children(os.getpid())

    def living() -> list[int]:
        deadline = time.monotonic() + 30
        while True:
            found = [child for child in _children(os.getpid()) - before if os.waitpid(child, os.WNOHANG) == (0, 0)]
            # One that has closed its files may still be on its way out.
            if not found or time.monotonic() > deadline:
                return found
            time.sleep(0.01)

    yield living
    libc.prctl(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def _children(process: int) -> set[int]:
    """Those of all its threads."""
    listed = Path(f"/proc/{process}/task").glob("*/children")
    return {int(child) for children in listed for child in children.read_text().split()}


def _has_worker(process: int, temporary: Path) -> bool:
    """Whether a process has started a program or a container."""
    records = (temporary / f"envcraft-{os.geteuid()}").glob(f"{process}-*/containers/*")
    return bool(_children(process)) or any(records)


@pytest.mark.parametrize(
    ("kind", "games"),
    [
        pytest.param(*case.values, number, marks=case.marks, id=f"{case.id}-{number}")
        for case in DRIVERS
        # Workers for several are forked, where the driver has a way to.
        for number in ((1,) if case.id == "docker" else (1, 2))
    ],
)
def test_kill_9_at_any_moment_leaves_nothing(
    kind: type[Driver], games: int, temporary: Path, orphans: Callable[[], list[int]]
) -> None:
    available = kind().probe()
    if not available.works:
        pytest.skip(f"{available.reason}; {available.fix}")
    files = [f"game{number}.py" for number in range(games)]
    for file in files:
        (temporary / file).write_text(_BUSY)
    command = [sys.executable, "-m", "envcraft", "validate", *files, "--sandbox", kind.name]
    generator = random.Random(0)
    busy = 0
    moments = 10 if games == 1 else 6
    for number, moment in enumerate(generator.uniform(0, 1.2) for _ in range(moments)):
        checker = subprocess.Popen(command, cwd=temporary, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # Half of the moments count from the first worker, however long a busy machine takes to start it.
        while number % 2 and checker.poll() is None and not _has_worker(checker.pid, temporary):
            time.sleep(0.01)
        time.sleep(moment)
        busy += _has_worker(checker.pid, temporary)
        owners = [path.name for path in (temporary / f"envcraft-{os.geteuid()}").glob(f"{checker.pid}-*")]
        checker.kill()
        checker.wait()
        assert leftovers_of(temporary) == [], moment
        assert orphans() == [], moment
        if kind is DockerDriver:
            for owner in owners:
                label = f"{OWNER_LABEL}={owner}"
                assert engine.client().containers(all=True, filters={"label": label}) == [], moment
    assert busy >= moments // 2
