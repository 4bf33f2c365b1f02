"""The ``docker`` driver: a container without network, capabilities, shell or a writable root, for each worker.

The worker is the container's first process. It connects to a socket that is mounted into the container and that nobody
else can reach; jobs are forked inside, and get their own sockets over that one. When the host hangs up, or is killed, the
worker ends, and the container with it.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import platform
import secrets
import shutil
import socket
import subprocess
import tempfile
import time
import weakref
from pathlib import Path
from typing import Any

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from . import build, engine, launch
from .engine import EngineError

LABEL = "envcraft=worker"

_CONTROL = "/run/envcraft/control.sock"
_START_SECONDS = 60.0
_END_SECONDS = 3.0
#: What the fork server and the tmpfs need beside a job's own memory.
_OVERHEAD = 256 * 1024**2
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
            return Availability(True, layers=self._layers())
        except EngineError as error:
            return Availability(False, error.reason, error.fix)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        name = f"envcraft-{secrets.token_hex(8)}"
        folder = Path(tempfile.mkdtemp(prefix="envcraft-"))
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
                path = folder / "control.sock"
                listener.bind(str(path))
                # The folder lets nobody else in, and only the socket is mounted: its own mode is for the container's user.
                path.chmod(0o666)
                listener.listen(1)
                client = self._run(name, path, launch.environment(hash_seed), limits)
                try:
                    control = _accept(listener, client)
                except BaseException:
                    listener.close()
                    _remove(client, name)
                    raise
        except OSError as error:
            raise SandboxUnavailable(f"the docker sandbox did not start: {error}") from None
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        try:
            return DockerWorker(client, name, control, limits)
        except WorkerLost as error:
            control.close()
            words = _last_words(client, name)
            raise SandboxUnavailable(f"the docker sandbox did not start: {words or error}") from None

    def _layers(self) -> list[str]:
        """The layers in force. Raises EngineError when a container cannot be launched."""
        told = self._info
        if told.get("OSType") != "linux" or told.get("KernelVersion") != platform.release():
            raise EngineError("the Docker engine runs on another machine than this one", "use an engine on this machine")
        if self._runtime is not None and self._runtime not in told.get("Runtimes", {}):
            raise EngineError(f"the engine has no runtime {self._runtime}", "add it to the engine's daemon.json")
        rebuild = "run `envcraft sandbox build`"
        try:
            labels = json.loads(engine.docker("image", "inspect", "--format", "{{json .Config.Labels}}", build.TAG)) or {}
        except EngineError:
            raise EngineError(f"the image {build.TAG} is not built", rebuild) from None
        if labels.get(build.LABEL) != build.digest():
            raise EngineError(f"the image {build.TAG} was built from other sources than these", rebuild)
        layers = [*_OWN_LAYERS, *([self._runtime] if self._runtime else [])]
        for option in told.get("SecurityOptions") or []:
            if option.startswith(("name=seccomp", "name=apparmor", "name=selinux")) and "unconfined" not in option:
                layers.append(option.removeprefix("name=").partition(",")[0])
        for key, layer in {"MemoryLimit": "memory limit", "PidsLimit": "process limit", "CpuCfsQuota": "one CPU"}.items():
            if told.get(key):
                layers.append(layer)
        return layers

    @functools.cached_property
    def _info(self) -> dict[str, Any]:
        return engine.info()

    def _run(self, name: str, path: Path, variables: dict[str, str], limits: Limits) -> subprocess.Popen[bytes]:
        """Start ``docker run``; it stays until the container is removed, and its standard error is the container's."""
        memory = str(limits.memory + _OVERHEAD)
        # The image knows where its interpreter is.
        variables = {key: value for key, value in variables.items() if key != "PATH"}
        variables |= {key: "" for proxy in _PROXIES for key in (proxy, proxy.lower())}
        argv = ["docker", "run", "--rm", "--attach", "stderr", "--sig-proxy=false", "--pull", "never", "--init=false"]
        argv += ["--name", name, "--hostname", "sandbox", "--label", LABEL, "--log-driver", "none"]
        argv += ["--network", "none", "--ipc", "private", "--shm-size", "1m", "--read-only", "--workdir", "/tmp"]  # noqa: S108
        argv += ["--tmpfs", "/tmp:rw,noexec,nosuid,nodev,size=64m,mode=1777"]
        argv += ["--mount", f"type=bind,source={path},target={_CONTROL}"]
        argv += ["--user", "65534:65534", "--cap-drop", "ALL", "--security-opt", "no-new-privileges"]
        argv += ["--memory", memory, "--memory-swap", memory, "--pids-limit", str(limits.processes + 1)]
        argv += ["--ulimit", "core=0", "--ulimit", f"nofile={max(limits.descriptors, 256)}"]
        if self._info.get("CpuCfsQuota"):
            argv += ["--cpus", "1"]
        if self._runtime is not None:
            argv += ["--runtime", self._runtime]
        for key, value in variables.items():
            argv += ["--env", f"{key}={value}"]
        return subprocess.Popen(  # noqa: S603
            [*argv, build.TAG, "--connect", _CONTROL],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            # Ctrl-C is for this process to answer, by hanging up.
            start_new_session=True,
        )


class DockerWorker(launch.ChildWorker):
    """A fork server in a container; the child is ``docker run``."""

    def __init__(self, client: subprocess.Popen[bytes], name: str, control: socket.socket, limits: Limits) -> None:
        super().__init__(client, control, limits)
        self._finalizer = weakref.finalize(self, _remove, client, name)
        control

    def close(self) -> None:
        super(launch.ChildWorker, self).close()
        self._finalizer()
