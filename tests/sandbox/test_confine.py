"""The system call filter, run instruction by instruction for both machines, and what the kernel then answers."""

from __future__ import annotations

import errno
import struct
import subprocess
import sys
import textwrap

import pytest
from envcraft_sandbox.worker import landlock, seccomp

PID = 4321
ALLOW, KILL = 0x7FFF0000, 0x80000000
X86, ARM = (0xC000003E, 0), (0xC00000B7, 1)


def refused(error: int) -> int:
    return 0x00050000 | error


def answer(machine: tuple[int, int], number: int, *arguments: int, architecture: int | None = None) -> int:
    """What the filter says to one call, by the semantics of classic BPF."""
    given = [*arguments, 0, 0, 0, 0, 0, 0][:6]
    data = struct.pack("<IIQ6Q", number, architecture or machine[0], 0, *given)
    program = seccomp.program(*machine, PID)
    accumulator, position = 0, 0
    while True:
        code, when_true, when_false, operand = program[position]
        position += 1
        if code == 0x06:
            return operand
        if code == 0x20:
            (accumulator,) = struct.unpack_from("<I", data, operand)
            continue
        held = {
            0x15: accumulator == operand,
            0x25: accumulator > operand,
            0x35: accumulator >= operand,
            0x45: bool(accumulator & operand),
        }[code]
        position += when_true if held else when_false


@pytest.mark.parametrize(
    ("x86", "arm", "arguments", "expected"),
    [
        (0, 63, (), ALLOW),  # read
        (231, 94, (), ALLOW),  # exit_group
        (52, 205, (), ALLOW),  # getpeername, the last of the list
        (59, 221, (), refused(errno.EPERM)),  # execve
        (101, 117, (), refused(errno.EPERM)),  # ptrace
        (425, 425, (), refused(errno.EPERM)),  # io_uring_setup
        (435, 435, (), refused(errno.ENOSYS)),  # clone3
        (9999, 9999, (), refused(errno.ENOSYS)),  # not yet known
        (41, 198, (1,), refused(errno.ENETUNREACH)),  # socket
        (53, 199, (1,), ALLOW),  # socketpair AF_UNIX
        (53, 199, (2,), refused(errno.ENETUNREACH)),
        (56, 220, (0x10000,), ALLOW),  # clone of a thread
        (56, 220, (17,), refused(errno.EAGAIN)),  # clone of a process
        (62, 129, (PID,), ALLOW),  # kill
        (62, 129, (1,), refused(errno.EPERM)),
        (62, 129, (2**64 - 1,), refused(errno.EPERM)),
        (234, 131, (PID,), ALLOW),  # tgkill
        (234, 131, (PID + 1,), refused(errno.EPERM)),
        (302, 261, (0,), ALLOW),  # prlimit64
        (302, 261, (1,), refused(errno.EPERM)),
        (16, 29, (1, 0x5401), ALLOW),  # ioctl TCGETS
        (16, 29, (1, 0x5412), refused(errno.ENOTTY)),  # TIOCSTI
        (72, 25, (1, 3), ALLOW),  # fcntl F_GETFL
        (72, 25, (1, 8), refused(errno.EPERM)),  # F_SETOWN
        (157, 167, (15,), ALLOW),  # prctl PR_SET_NAME
        (157, 167, (22,), refused(errno.EPERM)),  # PR_SET_SECCOMP
        (44, 206, (3, 1, 1, 0, 0), ALLOW),  # sendto, no address
        (44, 206, (3, 1, 1, 0, 0x7FFF), refused(errno.EPERM)),
        (44, 206, (3, 1, 1, 0, 0x7FFF00000000), refused(errno.EPERM)),
    ],
)
def test_the_filter(x86: int, arm: int, arguments: tuple[int, ...], expected: int) -> None:
    assert answer(X86, x86, *arguments) == expected
    assert answer(ARM, arm, *arguments) == expected


def test_calls_of_another_architecture_end_the_process() -> None:
    assert answer(X86, 0, architecture=0x40000003) == KILL
    assert answer(X86, 0x40000000) == KILL


def test_a_process_alone_is_refused_on_x86() -> None:
    assert answer(X86, 57) == answer(X86, 58) == refused(errno.EAGAIN)


def run(program: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=240, check=True
    )
    return ran.stdout.strip()


@pytest.mark.skipif(not seccomp.available(), reason="this kernel has no seccomp filter")
def test_the_kernel_takes_the_filter() -> None:
    output = run(
        """
        import ctypes, os, socket, threading
        from envcraft_sandbox.worker import seccomp
        ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)
        seccomp.restrict()
        for attempt, *arguments in (
            (os.fork,), (socket.socket,), (os.kill, os.getppid(), 0), (os.execv, "/bin/true", ["true"])
        ):
            try:
                attempt(*arguments)
            except OSError as error:
                print(error.errno, end=" ")
        os.kill(os.getpid(), 0)
        thread = threading.Thread(target=print, args=("thread",))
        thread.start()
        thread.join()
        """
    )
    assert output == f"{errno.EAGAIN} {errno.ENETUNREACH} {errno.EPERM} {errno.EPERM} thread"


@pytest.mark.skipif(not landlock.version(), reason="this kernel has no Landlock")
def test_landlock_leaves_what_it_was_shown(tmp_path_factory: pytest.TempPathFactory) -> None:
    shown, own, hidden = (tmp_path_factory.mktemp(name) for name in ("shown", "own", "hidden"))
    for folder in (shown, hidden):
        (folder / "file").write_text("x")
    output = run(
        f"""
        import ctypes, os
        from envcraft_sandbox.worker import landlock
        ctypes.CDLL(None).prctl(38, 1, 0, 0, 0)
        landlock.restrict(landlock.ruleset([{str(shown)!r}, "/no/such/path"], [{str(own)!r}]))
        for path, mode in (
            ({str(shown / "file")!r}, "r"), ({str(shown / "file")!r}, "w"), ({str(hidden / "file")!r}, "r"),
            ({str(own / "new")!r}, "w"), ({str(own / "new")!r}, "r"),
        ):
            try:
                open(path, mode).close()
                print("yes", end=" ")
            except PermissionError:
                print("no", end=" ")
        """
    )
    assert output == "yes no no yes yes"
