"""The ``docker`` driver: a container without network, capabilities, shell or a writable root, for each worker.

The worker is the container's first process. It connects to a socket that is mounted into the container and that no
other process can reach. The fork server forks jobs inside the container; each job gets its own socket over that one.
The worker ends when the host closes the socket or is killed, and the container ends with the worker.
"""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import select
import socket
import sys
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker

from . import build, engine, launch, leftovers
from .client import ForkServerWorker, hang_up
from .engine import EngineError

LABEL = "envcraft"
#: Its value is the name of the folder of the process that started the container.
OWNER_LABEL = "envcraft.owner"

_CONTROL = "/run/envcraft/control.sock"
_START_SECONDS = 60.0
_END_SECONDS = 3.0
#: Memory for the fork server and the tmpfs besides a job's own.
_OVERHEAD = 256 * 1024**2
#: Threads of a kernel in user space (gVisor) besides a job's own. The fork server alone needs one.
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
#: Layers of the default runtime, which another runtime may ignore; each is `name` or `name=value` among the engine's
#: security options.
_DEFAULT_RUNTIME_LAYERS = ("seccomp", "apparmor", "selinux")
#: Lines for daemon.json: by default gVisor opens no socket of the host and requires a network.
_RUNSC = '{"runtimes": {"runsc": {"path": "/usr/bin/runsc", "runtimeArgs": ["--host-uds=open", "--network=none"]}}}'
#: Podman copies these into containers, credentials included.
_PROXIES = ("HTTP_PROXY", "HTTPS_PROXY", "FTP_PROXY", "ALL_PROXY", "NO_PROXY")


class DockerDriver(Driver):
    name = "docker"
    isolation = Isolation.CONTAINER
    rank = 30
    packages = ("envcraft_sandbox.worker",)

    def __init__(self, runtime: str | None = None) -> None:
        """Use a runtime of the engine: None for its default, ``runsc`` for gVisor."""
        self._runtime = runtime

    def probe(self) -> Availability:
        try:
            self._check()
        except EngineError as error:
            return Availability(False, error.reason, error.fix)
        layers, missing = self._layers()
        return Availability(True, layers=layers, missing=missing)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.start(hash_seed=hash_seed, limits=limits)()

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        started = _Start(lambda: self._start(hash_seed, limits))

        def wait() -> Worker:
            try:
                container = started.result()
            except OSError as error:
                raise _unavailable(str(error)) from None
            except EngineError as error:
                raise _unavailable(error.reason) from None
            try:
                control = container.accept()
            except BaseException:
                container.end()
                raise
            if control is None:
                raise self._refusal(container.end() or f"no connection within {_START_SECONDS:.0f} s")
            try:
                return DockerWorker(container, control, limits, self._image.id)
            except WorkerLost as error:
                raise self._refusal(container.end(control) or str(error)) from None

        return wait

    def with_runtime(self, runtime: str) -> DockerDriver:
        return DockerDriver(runtime)

    def image(self) -> str | None:
        try:
            return self._image.id
        except EngineError as error:
            raise _unavailable(error.reason) from None

    def sweep(self) -> None:
        # One folder holds what all drivers of this package leave behind.
        leftovers.sweep()

    def _start(self, hash_seed: int, limits: Limits) -> Container:
        return Container(self._image.id, self.options(hash_seed), self.host_options(limits))

    def _refusal(self, words: str) -> SandboxUnavailable:
        """The reason why no container started; for gVisor also the arguments that it needs."""
        if self._runtime is not None and "runsc" in self._runtime:
            words += f"; under gVisor this needs these lines in the engine's daemon.json: {_RUNSC}"
        return _unavailable(words)

    def _check(self) -> None:
        """Raises EngineError if no container can be launched."""
        if sys.platform != "linux":
            # An engine here runs in a virtual machine, and a worker's socket does not cross into one.
            fix = "run EnvCraft itself in a Linux container or virtual machine"
            raise EngineError("the sandbox needs an engine that shares this machine's kernel", fix)
        info = self._info
        if info.get("OSType") != "linux" or info.get("KernelVersion") != platform.release():
            raise EngineError("the container engine runs on another machine", "use an engine that runs on this one")
        known = info.get("Runtimes") or {}
        if self._runtime is not None and self._runtime not in known:
            reason = f"the engine has no runtime {self._runtime}, only {', '.join(sorted(known))}"
            lines = f" {_RUNSC}" if self._runtime == "runsc" else " it"
            raise EngineError(reason, f"install it, add{lines} to the engine's daemon.json, and restart the engine")
        self._image.check()

    def _layers(self) -> tuple[list[str], list[str]]:
        """The layers in force, and those that this engine cannot apply."""
        info = self._info
        layers, missing = list(_OWN_LAYERS), []
        if self._runtime is not None:
            layers.append(f"runtime {self._runtime}")
        else:
            options = info.get("SecurityOptions") or []
            names = {option.removeprefix("name=").partition(",")[0] for option in options if "unconfined" not in option}
            layers += [f"engine's {name} profile" for name in _DEFAULT_RUNTIME_LAYERS if name in names]
            if "seccomp" not in names:
                missing.append("engine's seccomp profile")
        for key, layer in _ENGINE_LAYERS.items():
            (layers if info.get(key) else missing).append(layer)
        return layers, missing

    @functools.cached_property
    def _info(self) -> dict[str, Any]:
        connection = engine.client()
        with engine.errors():
            info: dict[str, Any] = connection.info()
            return info

    @functools.cached_property
    def _image(self) -> build.Built:
        # Looked up once: the image that was checked is the one that runs, even if the tag moves.
        return build.find()

    def options(self, hash_seed: int) -> dict[str, Any]:
        """The arguments of the SDK's ``create_container`` for a worker, except for its host configuration."""
        # The image has the path of its interpreter.
        variables = {key: value for key, value in launch.environment(hash_seed).items() if key != "PATH"}
        variables |= {key: "" for proxy in _PROXIES for key in (proxy, proxy.lower())}
        return {
            "command": ["--connect", _CONTROL],
            "hostname": "sandbox",
            "user": "65534:65534",
            "working_dir": "/tmp",
            "environment": variables,
            "labels": {LABEL: "worker", OWNER_LABEL: leftovers.folder().name},
            "use_config_proxy": False,
            # The runtime makes an empty network namespace, in a fraction of the time that the engine takes for the
            # network `none`, which remains for engines that do not know this.
            "network_disabled": True,
        }

    def host_options(self, limits: Limits) -> dict[str, Any]:
        """The arguments of the SDK's ``create_host_config`` for a worker, except for its mounts. Raises EngineError."""
        memory = limits.memory + _OVERHEAD
        processes = limits.processes + (_SENTRY_THREADS if self._runtime else 1)
        ulimits = {"core": 0, "nofile": max(limits.descriptors, 256)}
        return {
            "runtime": self._runtime,
            "auto_remove": True,
            "init": False,
            "log_config": {"Type": "none", "Config": {}},
            "network_mode": "none",
            "ipc_mode": "private",
            "shm_size": 1024**2,
            "read_only": True,
            "tmpfs": {"/tmp": "rw,noexec,nosuid,nodev,size=64m,mode=1777"},
            "cap_drop": ["ALL"],
            "security_opt": ["no-new-privileges"],
            "mem_limit": memory,
            "memswap_limit": memory,
            "pids_limit": processes,
            "ulimits": [{"Name": name, "Soft": value, "Hard": value} for name, value in ulimits.items()],
            **({"nano_cpus": 10**9} if self._info.get("CpuCfsQuota") else {}),
        }


class _Start:
    """Starts a container in a thread, so that the host can import its own modules meanwhile."""

    def __init__(self, start: Callable[[], Container]) -> None:
        self._start = start
        self._container: Container | None = None
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="envcraft-container")
        self._thread.start()

    def _run(self) -> None:
        try:
            self._container = self._start()
        except Exception as error:
            self._error = error

    def result(self) -> Container:
        """Wait for the container. Raises what starting it raised."""
        try:
            self._thread.join()
        except BaseException:
            self._thread.join()
            if self._container is not None:
                self._container.end()
            raise
        if self._container is None:
            raise self._error or RuntimeError("the thread ended without a container")
        return self._container


class Container:
    """A worker's running container, and the socket that its worker connects to."""

    def __init__(self, image: str, options: dict[str, Any], host_options: dict[str, Any]) -> None:
        """Create and start it; it is removed when its first process ends.

        Args:
            image: id of the image.
            options: arguments of the SDK's ``create_container``.
            host_options: arguments of the SDK's ``create_host_config``.

        Raises:
            EngineError: the engine refused.
            OSError: the socket cannot be made.
        """
        self.name = f"envcraft-{os.urandom(8).hex()}"
        self._engine = engine.client()
        self._folder = leftovers.containers() / self.name
        self._folder.mkdir(mode=0o700)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._stderr: Any = None
        self._said = b""
        path = self._folder / "control.sock"
        try:
            _bind(self._listener, path)
            # The container's user may connect. Only the socket is mounted, and no other user can enter the folder.
            path.chmod(0o666)
            self._listener.listen(1)
            mount = {"Type": "bind", "Source": str(path), "Target": _CONTROL}
            with engine.errors():
                host = self._engine.create_host_config(**host_options, mounts=[mount])
                self._engine.create_container(image, name=self.name, host_config=host, detach=True, **options)
                self._stderr = self._engine.attach_socket(self.name, {"stderr": 1, "stream": 1})
                self._engine.start(self.name)
            leftovers.mark_started(self._folder)
        except BaseException:
            self.end()
            raise

    def accept(self) -> socket.socket | None:
        """Wait for the worker to connect; None if the container has ended or the time is up."""
        deadline = time.monotonic() + _START_SECONDS
        try:
            while (left := deadline - time.monotonic()) > 0:
                readable, _, _ = select.select([self._listener, self._stderr], [], [], left)
                if self._listener in readable:
                    return self._listener.accept()[0]
                if readable and not self._read():
                    return None
        finally:
            self._listener.close()
        return None

    def end(self, control: socket.socket | None = None) -> str:
        """Hang up on the worker, ensure that the container is removed, and return the last line of its stderr."""
        if control is not None:
            hang_up(control)
        self._listener.close()
        gone = control is not None and self._is_removed()
        if not gone:
            with contextlib.suppress(EngineError), engine.errors():
                self._engine.remove_container(self.name, force=True)
            gone = self._is_removed()
        if self._stderr is not None:
            while gone and self._read():
                pass
            # The SDK keeps the response, whose connection a closed stream leaves open.
            getattr(self._stderr, "_response", self._stderr).close()
            self._stderr = None
        if gone:
            # Otherwise the next sweep removes it.
            with contextlib.suppress(OSError):
                leftovers.remove(self._folder)
        return engine.one_line(_payloads(self._said).decode(errors="replace"))

    def _is_removed(self) -> bool:
        """Wait a while for the engine to remove the container."""
        try:
            with engine.errors():
                self._engine.wait(self.name, timeout=_END_SECONDS, condition="removed")
        except engine.NotFoundError:
            pass
        except EngineError:
            return False
        return True

    def _read(self) -> bool:
        """Read some of the container's stderr; False at its end."""
        data = b""
        with contextlib.suppress(OSError):
            if select.select([self._stderr], [], [], _END_SECONDS)[0]:
                data = os.read(self._stderr.fileno(), 1 << 16)
        self._said += data
        return bool(data)


class DockerWorker(ForkServerWorker):
    """A fork server in a container."""

    def __init__(self, container: Container, control: socket.socket, limits: Limits, image: str) -> None:
        self._end = weakref.finalize(self, container.end, control)
        super().__init__(control, limits)
        self.about = {**self.about, "image": image}

    def close(self) -> None:
        super().close()
        self._end()


def _bind(listener: socket.socket, path: Path) -> None:
    """Bind to a path of any length: the address of a socket has room for about a hundred characters."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        listener.bind(f"/proc/self/fd/{folder}/{path.name}")
    finally:
        os.close(folder)


def _payloads(frames: bytes) -> bytes:
    """The payloads of an attached stream: each has a header of 8 bytes, whose last four are its length."""
    found = b""
    while len(frames) >= 8:
        end = 8 + int.from_bytes(frames[4:8], "big")
        found, frames = found + frames[8:end], frames[end:]
    return found


def _unavailable(words: str) -> SandboxUnavailable:
    return SandboxUnavailable(f"the docker sandbox did not start: {words}; see `envcraft doctor`")
