"""The invariants that every hostile program must leave intact, independent of its verdict.

A :class:`Machine` is the set of traps of one pool process: files that no program may read or change, ports that none
may reach, and the adoption of every process that a run leaves behind.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sysconfig
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from envcraft_sandbox import engine
from envcraft_sandbox.docker import LABEL

ROOT = Path(__file__).resolve().parents[2]
_PR_SET_CHILD_SUBREAPER = 36
#: Time in which the processes of an ended run must end, in seconds.
_GRACE = 3.0
#: Prefix of the name of every file that a program tries to leave behind.
_MARK = "envcraft-hostile"
_SYSTEM = ("/", "/usr", "/usr/lib", "/etc", "/var/lib", "/var/tmp", "/tmp", "/run", "/run/lock", "/dev", "/dev/shm")


class Machine:
    """Traps for the programs and their untouched state. Use as a context manager.

    `values` fill the programs' placeholders. The checker of a run keeps its temporary files in `temporary`.
    """

    def __enter__(self) -> Machine:
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        # A sandbox may replace the system's folder for temporary files.
        self._canaries = [Path(tempfile.mkdtemp(prefix=".canary-", dir=where)) for where in (Path.home(), "/tmp")]
        for folder in self._canaries:
            (folder / "secret").write_text(secrets.token_hex())
        self.temporary = Path(tempfile.mkdtemp(prefix="ec-", dir="/tmp"))
        self._tcp = socket.create_server(("127.0.0.1", 0))
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        self._abstract = socket.socket(socket.AF_UNIX)
        name = f"envcraft-{secrets.token_hex(8)}"
        self._abstract.bind(f"\0{name}")
        self._abstract.listen()
        self._listeners = {"TCP": self._tcp, "UDP": self._udp, "the abstract socket": self._abstract}
        for listener in self._listeners.values():
            listener.setblocking(False)
        self.values = {
            "home": str(Path.home()),
            "canary": str(self._canaries[0]),
            "canary_tmp": str(self._canaries[1]),
            "secret": secrets.token_hex(),
            "passwd": hashlib.sha256(Path("/etc/passwd").read_bytes()).hexdigest(),
            "repository": str(ROOT),
            "tcp": str(self._tcp.getsockname()[1]),
            "udp": str(self._udp.getsockname()[1]),
            "abstract": name,
        }
        self._before = self._files()
        return self

    def __exit__(self, *_: object) -> None:
        for listener in self._listeners.values():
            listener.close()
        for folder in [*self._canaries, self.temporary]:
            shutil.rmtree(folder, ignore_errors=True)

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables of a run."""
        return os.environ | {"TMPDIR": str(self.temporary), "ENVCRAFT_HOSTILE_SECRET": self.values["secret"]}

    def broken(self, driver: str) -> list[str]:
        """Changes since before the run that has just ended. Restores the machine as far as possible."""
        found = [f"a process is left: {words}" for words in self._end_processes()]
        if driver == "docker":
            found += [f"a container is left: {name}" for name in self._end_containers()]
        found += [f"{name} was reached" for name, listener in self._listeners.items() if _reached(listener)]
        now = self._files()
        for path in sorted({*self._before, *now}, key=str):
            if self._before.get(path) != now.get(path):
                how = "new" if path not in self._before else "gone" if path not in now else "changed"
                found.append(f"{path} is {how}")
        self._before = now
        # The folder of all of a user's checkers may stay.
        base = self.temporary / f"envcraft-{os.geteuid()}"
        left = [str(path) for path in [*self.temporary.iterdir(), *_named(base)] if path != base]
        if left:
            found.append(f"a temporary file is left: {left[0]}")
            subprocess.run(["chmod", "-R", "u+rwx", *left], check=False, capture_output=True)
            subprocess.run(["rm", "-rf", "--", *left], check=False)
        return found

    def _files(self) -> dict[Path, object]:
        """The state of every file that a program could try to change, as far as that is cheap to determine."""
        found: dict[Path, object] = {}
        for folder in self._canaries:
            for path in [folder, *folder.rglob("*")]:
                found[path] = (_stamp(path), path.read_bytes() if path.is_file() else b"")
        libraries = Path(sysconfig.get_path("purelib"))
        for folder in (ROOT / "sandbox", ROOT / "envcraft"):
            found |= {path: path.read_bytes() for path in folder.rglob("*.py")}
        for path in (ROOT, libraries, libraries / "numpy", libraries / "gymnasium", *map(Path, _SYSTEM), Path.home()):
            found |= {each: "there" for each in _named(path) if each.name.startswith(_MARK)}
        found |= {path: _stamp(path) for path in [libraries, *libraries.glob("*.pth"), *libraries.glob("*custom*.py")]}
        found |= {Path(path): Path(path).stat().st_mtime for path in ("/dev/null", "/dev/zero", "/etc/passwd")}
        return found

    def _end_processes(self) -> list[str]:
        """End the processes that the run has left, and return their names."""
        deadline = time.monotonic() + _GRACE
        while (left := _descendants(os.getpid())) and time.monotonic() < deadline:
            _reap()
            time.sleep(0.02)
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        _reap()
        return sorted(left.values())

    def _end_containers(self) -> list[str]:
        """Remove the containers that the run has left, known by the folder of their socket."""
        client = engine.client()
        left = [
            container["Id"]
            for container in client.containers(all=True, filters={"label": LABEL})
            if any(str(self.temporary) in mount["Source"] for mount in container["Mounts"])
        ]
        for container in left:
            client.remove_container(container, force=True)
        return left


def _reached(listener: socket.socket) -> bool:
    try:
        if listener.type == socket.SOCK_DGRAM:
            listener.recv(1)
        else:
            listener.accept()[0].close()
    except BlockingIOError:
        return False
    return True


def _stamp(path: Path) -> tuple[int, ...]:
    told = path.lstat()
    return told.st_ino, told.st_mode, told.st_uid, told.st_size, told.st_mtime_ns, told.st_nlink


def _named(folder: Path) -> Iterator[Path]:
    with suppress(OSError):
        yield from folder.iterdir()


def _descendants(ancestor: int) -> dict[int, str]:
    """Processes that descend from one, which as their adopter keeps those that lost their parent: id and command."""
    parents: dict[int, int] = {}
    names: dict[int, str] = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        with suppress(OSError):
            name, _, rest = (entry / "stat").read_text().partition("(")[2].rpartition(")")
            state, parent = rest.split()[:2]
            if state != "Z" or int(parent) == ancestor:
                parents[int(entry.name)] = int(parent)
                names[int(entry.name)] = name
    found: dict[int, str] = {}
    for pid in parents:
        line = pid
        while line in parents and line != ancestor:
            line = parents[line]
        if line == ancestor and pid != ancestor:
            found[pid] = names[pid]
    return found


def _reap() -> None:
    """Reap adopted processes that have ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
