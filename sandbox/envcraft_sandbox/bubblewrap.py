"""The ``bubblewrap`` driver: namespaces for users, mounts, processes, network, IPC and host name; no engine."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable
from pathlib import Path

from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.installed import Installed

from . import launch
from .zygote import Started, ZygoteDriver

_LAYERS = [
    "user, mount, pid, network, ipc and uts namespaces",
    "no capabilities",
    "read-only root",
    "sized tmpfs",
    "scrubbed environment",
]
_SYSTEM = ("/usr", "/lib", "/lib64", "/lib32", "/bin", "/etc/ld.so.cache", "/etc/localtime")
#: Set once a worker of this process has started: then a probe has nothing to try.
_has_started = threading.Event()
_TMPFS_BYTES = 64 * 1024**2
#: The devices that ``bwrap --dev`` makes, but read-only and without new terminals, which the workers of one zygote
#: would share. With ``--dev``, bwrap also covers parts of /proc, and then nested namespaces cannot mount their own.
_DEVICES = [
    *("--tmpfs", "/dev"),
    *(
        word
        for name in ("null", "zero", "full", "random", "urandom", "tty")
        for word in ("--dev-bind-try", f"/dev/{name}", f"/dev/{name}")
    ),
    *("--symlink", "/proc/self/fd", "/dev/fd", "--symlink", "/proc/kcore", "/dev/core"),
    *(
        word
        for number, name in enumerate(("stdin", "stdout", "stderr"))
        for word in ("--symlink", f"/proc/self/fd/{number}", f"/dev/{name}")
    ),
    *("--dir", "/dev/shm", "--dir", "/dev/pts", "--symlink", "pts/ptmx", "/dev/ptmx", "--remount-ro", "/dev"),
]


class BubblewrapDriver(Driver):
    name = "bubblewrap"
    isolation = Isolation.NAMESPACE
    rank = 20
    packages = ("envcraft_sandbox.worker",)

    def __init__(self, found: Installed = Installed()) -> None:  # noqa: B008 (it is immutable)
        self._found = found

    def with_installed(self, packages: Installed) -> BubblewrapDriver:
        return BubblewrapDriver(packages)

    def probe(self) -> Availability:
        return Availability(True, layers=_LAYERS) if _has_started.is_set() else _probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.start(hash_seed=hash_seed, limits=limits)()

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        started = launch.start(self._argv(isolate(self._found), hash_seed), {}, limits, self.name)

        def wait() -> Worker:
            worker = started()
            _has_started.set()
            return worker

        return wait

    def shared_layout(self) -> Driver:
        return ZygoteDriver(self, self._zygote, launch.JOB_FOLDER)

    def _zygote(self, hash_seed: int) -> Started:
        argv = [*self._argv(isolate(self._found, nested=True), hash_seed), "--zygote", str(_TMPFS_BYTES)]
        return Started(*launch.spawn(argv, {}, self.name))

    def _argv(self, isolated: list[str], hash_seed: int) -> list[str]:
        variables = launch.environment(hash_seed)
        variables["PYTHONPATH"] = os.pathsep.join(launch.module_paths(self._found))
        options = [word for name in variables for word in ("--setenv", name, variables[name])]
        return [*isolated, *options, "--", *launch.command(read=self._found.folders)]


@functools.cache
def _probe() -> Availability:
    if sys.platform != "linux":
        return Availability(False, "it needs Linux", "run EnvCraft in a Linux container or virtual machine")
    if shutil.which("bwrap") is None:
        return Availability(False, "bwrap is not installed", "install the package bubblewrap")
    try:
        tried = subprocess.run(
            [*isolate(), "--", sys.executable, "-S", "-c", "pass"], capture_output=True, timeout=20, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Availability(False, f"bwrap does not run: {error}", "allow unprivileged user namespaces")
    if tried.returncode:
        words = tried.stderr.decode(errors="replace").strip().splitlines()
        return Availability(False, words[-1] if words else "bwrap failed", "allow unprivileged user namespaces")
    return Availability(True, layers=_LAYERS)


def isolate(found: Installed = Installed(), nested: bool = False) -> list[str]:  # noqa: B008 (it is immutable)
    """The bwrap command line up to the program.

    The worker sees the system, the interpreter, the libraries and what is installed elsewhere.

    Args:
        found: what is installed outside the interpreter's libraries.
        nested: the program makes such namespaces inside its own.
    """
    argv = [shutil.which("bwrap") or "bwrap", "--unshare-all", "--die-with-parent", "--new-session", "--as-pid-1"]
    if nested:
        argv += ["--unshare-user"]
    elif _knows("--disable-userns"):
        # In a user namespace of its own the job would have capabilities again.
        argv += ["--unshare-user", "--disable-userns"]
    argv += ["--cap-drop", "ALL", "--clearenv", "--hostname", "sandbox", "--uid", "65534", "--gid", "65534"]
    for path in _SYSTEM:
        if os.path.islink(path):
            argv += ["--symlink", os.readlink(path), path]
        else:
            argv += ["--ro-bind-try", path, path]
    argv += ["--proc", "/proc", *(_DEVICES if nested else ("--dev", "/dev"))]
    argv += ["--size", str(_TMPFS_BYTES), "--tmpfs", "/tmp"]
    # These follow the empty /tmp, which would hide an interpreter below it.
    for path in _python_paths(found):
        argv += ["--ro-bind", path, path]
    if nested:
        # Each fork server mounts its own file system here.
        argv += ["--dir", launch.JOB_FOLDER, "--remount-ro", "/tmp"]
    return [*argv, "--remount-ro", "/", "--chdir", "/tmp"]


@functools.cache
def _knows(option: str) -> bool:
    """Whether this version of bwrap has an option."""
    with contextlib.suppress(OSError):
        # The program contains the text of its options, and reading it takes less time than running it.
        if option.encode() in Path(shutil.which("bwrap") or "bwrap").read_bytes():
            return True
    help_text = subprocess.run(["bwrap", "--help"], capture_output=True, timeout=20, check=False)
    return option.encode() in help_text.stdout + help_text.stderr


def _python_paths(more: Installed) -> list[str]:
    """The folders of the interpreter and its libraries that the system folders do not contain."""
    wanted = [sys.prefix, sys.base_prefix, sys.exec_prefix, str(Path(sys.executable).resolve().parent)]
    wanted += [
        sysconfig.get_path("stdlib"),
        sysconfig.get_path("platstdlib"),
        *launch.module_paths(more),
        *more.folders,
    ]
    found: list[str] = []
    for path in sorted({os.path.abspath(path) for path in wanted}, key=len):
        if path == "/" or any(Path(path).is_relative_to(parent) for parent in [*_SYSTEM, *found]):
            continue
        found.append(path)
    return found
