"""The ``docker`` driver: a container without network, capabilities, shell or a writable root, for each worker.

The worker is the container's first process. It connects to a socket that is mounted into the container and that nobody
else can reach; jobs are forked inside, and get their own sockets over that one. When the host hangs up, or is killed,
the worker ends, and the container with it.
"""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import socket
import subprocess
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from . import build, engine, launch, leftovers
from .client import ForkServerWorker, hang_up
from .engine import EngineError

LABEL = "envcraft=worker"
#: Its value is the name of the folder of the process that started the container.
OWNER_LABEL = "envcraft.owner"

_CONTROL = "/run/envcraft/control.sock"
_START_SECONDS = 60.0
_END_SECONDS = 3.0
#: What the fork server and the tmpfs need beside a job's own memory.
_OVERHEAD = 256 * 1024**2
#: What a kernel in user space (gVisor's) needs beside a job's own processes; the fork server alone needs one.
_SENTRY_THREADS = 1024
_OWN_LAYERS = [
    "container",
    "no network",
    "read-only root",
    "sized tmpfs",
    "no capabilities",
    "no new privileges",
    "user 65534",
    "scrubbed environment",
    "rlimits",
]
_ENGINE_LAYERS = {
    "MemoryLimit": "memory limit",
    "SwapLimit": "swap limit",
    "PidsLimit": "process limit",
    "CpuCfsQuota": "one CPU",
}
#: What another runtime need not heed; each is `name` or `name=value` among the engine's security options.
_DEFAULT_RUNTIME_LAYERS = ("seccomp", "apparmor", "selinux")
#: Lines for daemon.json: unless it is told to, gVisor opens no socket of the host, and wants a network.
_RUNSC = '{"runtimes": {"runsc": {"path": "/usr/bin/runsc", "runtimeArgs": ["--host-uds=open", "--network=none"]}}}'
#: What docker's own configuration may put into a container's environment, credentials included.
_PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "FTP_PROXY", "ALL_PROXY", "NO_PROXY")


class DockerDriver(Driver):
    """`runtime` is one that the engine knows: None for its default, ``runsc`` for gVisor."""

    name = "docker"
    isolation = Isolation.CONTAINER
    rank = 30

    def __init__(self, runtime: str | None = None) -> None:
        self._runtime = runtime

    def probe(self) -> Availability:
        try:
            self._check()
        except EngineError as error:
            return Availability(False, error.reason, error.fix)
        layers, missing = self._layers()
        return Availability(True, layers=layers, missing=missing)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.begin(hash_seed=hash_seed, limits=limits)()

    def begin(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        name = f"envcraft-{os.urandom(8).hex()}"
        try:
            self._ask()
            listener, client = self._start(name, hash_seed, limits)
        except OSError as error:
            raise _unavailable(str(error)) from None
        except EngineError as error:
            raise _unavailable(error.reason) from None

        def wait() -> Worker:
            try:
                control = self._accept(listener, client, name)
            except OSError as error:
                raise _unavailable(str(error)) from None
            try:
                return DockerWorker(client, name, control, limits, self._image.id)
            except WorkerLost as error:
                raise self._refusal(_end(client, name, control) or str(error)) from None

        return wait

    def under(self, runtime: str) -> DockerDriver:
        return DockerDriver(runtime)

    def image(self) -> str | None:
        try:
            return self._image.id
        except EngineError as error:
            raise _unavailable(error.reason) from None

    def sweep(self) -> None:
        # For the other drivers of this package, too: there is one folder for all of them.
        leftovers.sweep()

    def _ask(self) -> None:
        """Ask the engine both questions at once: each starts a command. Raises EngineError."""
        asked = threading.Thread(target=self._tell)
        asked.start()
        try:
            _ = self._image
        finally:
            asked.join()
        _ = self._info

    def _tell(self) -> None:
        with contextlib.suppress(EngineError):
            # Asked again, and refused again, by whoever needs the answer.
            _ = self._info

    def _start(self, name: str, hash_seed: int, limits: Limits) -> tuple[socket.socket, subprocess.Popen[bytes]]:
        """Start a container; give the socket that its worker will connect to, and its client. Raises OSError."""
        path = leftovers.containers() / name / "control.sock"
        path.parent.mkdir(mode=0o700)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _bind(listener, path)
            # For the container's user: only the socket is mounted, and nobody else can enter the folder.
            path.chmod(0o666)
            listener.listen(1)
            return listener, self._run(name, path, hash_seed, limits)
        except BaseException:
            listener.close()
            leftovers.remove(path.parent)
            raise

    def _accept(self, listener: socket.socket, client: subprocess.Popen[bytes], name: str) -> socket.socket:
        """The socket to the container's worker, which is waited for. Raises SandboxUnavailable."""
        with listener:
            try:
                control = _accept(listener, client)
            except BaseException:
                listener.close()
                _end(client, name)
                raise
        if control is None:
            raise self._refusal(_end(client, name) or f"nothing connected within {_START_SECONDS:.0f} s")
        return control

    def _refusal(self, words: str) -> SandboxUnavailable:
        """Why no container started, and for a runtime that is known to want arguments which ones."""
        if self._runtime is not None and "runsc" in self._runtime:
            words += f"; under gVisor this needs these lines in the engine's daemon.json: {_RUNSC}"
        return _unavailable(words)

    def _check(self) -> None:
        """Raises EngineError when a container cannot be launched."""
        told = self._info
        if told.get("OSType") != "linux" or told.get("KernelVersion") != platform.release():
            raise EngineError("the Docker engine runs on another machine", "use an engine that runs on this one")
        known = told.get("Runtimes") or {}
        if self._runtime is not None and self._runtime not in known:
            reason = f"the engine has no runtime {self._runtime}, only {', '.join(sorted(known))}"
            lines = f" {_RUNSC}" if self._runtime == "runsc" else " it"
            raise EngineError(reason, f"install it, add{lines} to the engine's daemon.json, and restart the engine")
        self._image.check()

    def _layers(self) -> tuple[list[str], list[str]]:
        """The layers in force, and those that this engine cannot give."""
        told = self._info
        layers, missing = list(_OWN_LAYERS), []
        if self._runtime is not None:
            layers.append(f"runtime {self._runtime}")
        else:
            options = told.get("SecurityOptions") or []
            names = {option.removeprefix("name=").partition(",")[0] for option in options if "unconfined" not in option}
            layers += [f"engine's {name} profile" for name in _DEFAULT_RUNTIME_LAYERS if name in names]
            if "seccomp" not in names:
                missing.append("engine's seccomp profile")
        for key, layer in _ENGINE_LAYERS.items():
            (layers if told.get(key) else missing).append(layer)
        return layers, missing

    @functools.cached_property
    def _info(self) -> dict[str, Any]:
        return engine.info()

    @functools.cached_property
    def _image(self) -> build.Built:
        # Once: what was looked at is what runs, even if the tag moves on.
        return build.find()

    def command(self, name: str, hash_seed: int, limits: Limits) -> list[str]:
        """The ``docker run`` of a worker's container, up to its image, but for the socket that is mounted.

        Raises EngineError.
        """
        memory = str(limits.memory + _OVERHEAD)
        # The image knows where its interpreter is.
        variables = {key: value for key, value in launch.environment(hash_seed).items() if key != "PATH"}
        variables |= {key: "" for proxy in _PROXIES for key in (proxy, proxy.lower())}
        argv = ["docker", "run", "--rm", "--attach", "stderr", "--sig-proxy=false", "--pull", "never", "--init=false"]
        argv += ["--name", name, "--hostname", "sandbox", "--label", LABEL]
        argv += ["--label", f"{OWNER_LABEL}={leftovers.folder().name}", "--log-driver", "none"]
        argv += ["--network", "none", "--ipc", "private", "--shm-size", "1m", "--read-only", "--workdir", "/tmp"]
        argv += ["--tmpfs", "/tmp:rw,noexec,nosuid,nodev,size=64m,mode=1777"]
        argv += ["--user", "65534:65534", "--cap-drop", "ALL", "--security-opt", "no-new-privileges"]
        processes = limits.processes + (_SENTRY_THREADS if self._runtime else 1)
        argv += ["--memory", memory, "--memory-swap", memory, "--pids-limit", str(processes)]
        argv += ["--ulimit", "core=0", "--ulimit", f"nofile={max(limits.descriptors, 256)}"]
        if self._info.get("CpuCfsQuota"):
            argv += ["--cpus", "1"]
        if self._runtime is not None:
            argv += ["--runtime", self._runtime]
        for key, value in variables.items():
            argv += ["--env", f"{key}={value}"]
        return argv

    def _run(self, name: str, path: Path, hash_seed: int, limits: Limits) -> subprocess.Popen[bytes]:
        """Start ``docker run``; it stays until the container is removed, and its standard error is the container's."""
        argv = [*self.command(name, hash_seed, limits), "--mount", f"type=bind,source={path},target={_CONTROL}"]
        return subprocess.Popen(
            [*argv, self._image.id, "--connect", _CONTROL],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            pass_fds=[leftovers.lifeline()],
            # Ctrl-C is for this process to answer, by hanging up.
            start_new_session=True,
        )


class DockerWorker(ForkServerWorker):
    """A fork server in a container. `client` is its ``docker run``, which ends when the container has been removed."""

    def __init__(
        self, client: subprocess.Popen[bytes], name: str, control: socket.socket, limits: Limits, image: str
    ) -> None:
        self._end = weakref.finalize(self, _end, client, name, control)
        super().__init__(control, limits)
        self.about = {**self.about, "image": image}

    def close(self) -> None:
        super().close()
        self._end()


def _bind(listener: socket.socket, path: Path) -> None:
    """Bind however long the path is: a socket's own address has room for about a hundred characters only."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        listener.bind(f"/proc/self/fd/{folder}/{path.name}")
    finally:
        os.close(folder)


def _accept(listener: socket.socket, client: subprocess.Popen[bytes]) -> socket.socket | None:
    """Wait for the worker to connect; None when the container has ended, or nothing happens."""
    listener.settimeout(0.1)
    deadline = time.monotonic() + _START_SECONDS
    while time.monotonic() < deadline and client.poll() is None:
        with contextlib.suppress(TimeoutError):
            return listener.accept()[0]
    return None


def _end(client: subprocess.Popen[bytes], name: str, control: socket.socket | None = None) -> str:
    """Hang up, see to it that the container is gone, and give the last words of its standard error."""
    if control is not None:
        hang_up(control)
    try:
        _, said = client.communicate(timeout=_END_SECONDS)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(EngineError):
            engine.docker("rm", "--force", name, timeout=_END_SECONDS)
        try:
            _, said = client.communicate(timeout=_END_SECONDS)
        except subprocess.TimeoutExpired:
            client.kill()
            _, said = client.communicate()
            # Not known to be gone: the next sweep sees to it.
            return engine.last_words(said)
    with contextlib.suppress(OSError):
        leftovers.remove(leftovers.containers() / name)
    return engine.last_words(said)


def _unavailable(words: str) -> SandboxUnavailable:
    return SandboxUnavailable(f"the docker sandbox did not start: {words}; see `envcraft doctor`")
