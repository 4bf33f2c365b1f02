"""What a job cannot reach. The kernel's own layers protect in every driver, if the kernel has them."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from envcraft.judging.driver import Driver, Isolation, Worker

Environment = Callable[..., str]


class TestIsolation:
    def test_no_network_is_reached(
        self, worker: Worker, environment: Environment, play: Any, token: str, tmp_path: Path
    ) -> None:
        path = str(tmp_path / "socket")
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as abstract,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as named,
        ):
            abstract.bind(f"\0{token}")
            named.bind(path)
            for each in (server, abstract, named):
                each.setblocking(False)
            addresses = [server.getsockname(), ("192.0.2.1", 80), f"\0{token}", path]
            source = environment(
                top=f"""
                import json, socket
                reached = []
                for address in {addresses!r}:
                    family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
                    for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
                        try:
                            with socket.socket(family, kind) as client:
                                client.settimeout(0.5)
                                client.connect(address)
                            reached.append(address)
                        except OSError:
                            pass
                    # A socket that needs no address of its own may still send to one.
                    for end in socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM):
                        try:
                            end.sendto(b"hello", address)
                            reached.append(address)
                        except (OSError, TypeError):
                            pass
                print(json.dumps(reached))
                """
            )
            assert play(worker, source).facts == []
            for each in (abstract, named):
                with pytest.raises(BlockingIOError):
                    each.recv(16)
            with pytest.raises(BlockingIOError):
                server.accept()

    def test_files_of_the_host_cannot_be_read(
        self, worker: Worker, environment: Environment, play: Any, tmp_path: Path
    ) -> None:
        secret = tmp_path / "secret"
        secret.write_text("canary")
        tmp_path.chmod(0o755)
        paths = [
            str(secret),
            "/etc/shadow",
            "/etc/passwd",
            "/var/run/docker.sock",
            "/run/docker.sock",
            "/proc/1/environ",
        ]
        paths += [str(path) for path in Path.home().iterdir() if path.is_file()]
        source = environment(
            top=f"""
            import json, os
            readable = []
            for path in {paths!r}:
                try:
                    os.close(os.open(path, os.O_RDONLY))
                    readable.append(path)
                except OSError:
                    pass
            print(json.dumps(readable))
            """
        )
        assert play(worker, source).facts == []

    def test_only_the_own_folder_is_writable(
        self, worker: Worker, environment: Environment, play: Any, tmp_path: Path
    ) -> None:
        source = environment(
            top=f"""
            import json, os, sys
            import numpy
            written = []
            folders = ["/", "/usr", "/etc", "/var", "/run", "/run/envcraft", "/opt", "/opt/envcraft", "/home", "/root"]
            folders += ["/proc", "/proc/sys/kernel", "/sys", "/tmp", "/var/tmp", "/dev/shm", "/dev/mqueue"]
            folders += [{str(tmp_path)!r}, sys.prefix, *sys.path, os.path.dirname(numpy.__file__)]
            for folder in [*folders, "."]:
                for attempt in (
                    lambda: open(os.path.join(folder, "envcraft-test"), "x").close(),
                    lambda: os.mkdir(os.path.join(folder, "envcraft-folder")),
                    lambda: os.chmod(folder, 0o755),
                    lambda: os.utime(folder),
                ):
                    try:
                        attempt()
                        written.append(folder)
                    except OSError:
                        pass
            print(json.dumps(written))
            """
        )
        assert play(worker, source).facts == [".", "."]

    def test_tmp_is_bounded(self, isolating: Driver, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            size = os.statvfs(".")
            print(json.dumps(size.f_blocks * size.f_frsize))
            """
        )
        assert play(worker, source).facts == 64 * 1024**2

    def test_the_job_has_no_privileges(
        self, driver: Driver, worker: Worker, environment: Environment, play: Any
    ) -> None:
        source = environment(
            top="""
            import ctypes, json, os, struct
            libc = ctypes.CDLL(None, use_errno=True)
            held = ctypes.create_string_buffer(24)
            libc.capget(struct.pack("<Ii", 0x20080522, 0), held)
            print(json.dumps({
                "ids": [os.getuid(), os.geteuid(), os.getgid(), *os.getgroups()],
                "capabilities": list(struct.unpack("<6I", held)),
                "no new privileges": libc.prctl(39, 0, 0, 0, 0),
                "mount": libc.mount(b"none", b"/tmp", b"tmpfs", 0, None),
                "user namespace": libc.unshare(0x10000000),
                "chroot": libc.chroot(b"/tmp"),
                "setuid": libc.setuid(12345),
                "ptrace": libc.ptrace(16, os.getppid(), 0, 0),
                "io_uring": libc.syscall(425, 1, ctypes.create_string_buffer(120)),
                "memfd": libc.syscall(319, b"x", 0),
                "limits of another": libc.prlimit(os.getppid(), 7, ctypes.create_string_buffer(16), None),
            }))
            """
        )
        found = play(worker, source).facts
        ids = set(found.pop("ids"))
        assert ids == {65534} or driver.isolation is Isolation.PROCESS
        assert set(found.pop("capabilities")) == {0}
        assert found.pop("no new privileges") == 1
        assert set(found.values()) == {-1}

    def test_other_processes_cannot_be_seen(self, worker: Worker, environment: Environment, play: Any) -> None:
        source = environment(
            top="""
            import json, os
            opened = []
            for who in ("self", "1", str(os.getppid()), str(os.getpid())):
                own = who in ("self", str(os.getpid()))
                for name in ("", "mem", "environ", "maps", "cmdline", "root/tmp", *(() if own else ("fd/0", "cwd/."))):
                    try:
                        os.close(os.open(f"/proc/{who}/{name}", os.O_RDONLY))
                        opened.append(name)
                    except OSError:
                        pass
            print(json.dumps(opened))
            """
        )
        assert play(worker, source).facts == []
