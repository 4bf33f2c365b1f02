"""A seccomp filter that allows the system calls that an environment needs; the kernel refuses all others.

Single-process numerical code may use its own files, memory, threads, clocks and open descriptors. The filter refuses
new processes, programs, sockets, other processes' memory, signals to other processes, mounts, keys, io_uring, BPF, and
every call that it does not list. The errors are those that callers know: ``EAGAIN`` for a process, as at the limit of
processes; ``ENETUNREACH`` for a socket, as without a network; ``ENOSYS`` for calls newer than the list, so that the C
library uses older ones; and ``EPERM`` for the rest.

Numbers are those of the kernel's ``unistd.h`` for x86-64 and for the generic table that 64-bit ARM uses.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
import sys
from collections.abc import Iterable
from functools import cache

#: By machine: the architecture as audit.h names it, and the column of the numbers below.
_MACHINES = {"x86_64": (0xC000003E, 0), "aarch64": (0xC00000B7, 1)}

#: Call, its number on x86-64, its number on 64-bit ARM.
_ALLOWED = """
read 0 63, write 1 64, readv 19 65, writev 20 66, pread64 17 67, pwrite64 18 68, preadv 295 69, pwritev 296 70,
preadv2 327 286, pwritev2 328 287, lseek 8 62, close 3 57, close_range 436 436, dup 32 23, dup2 33 -, dup3 292 24,
flock 73 32, poll 7 -, ppoll 271 73, select 23 -, pselect6 270 72, epoll_create 213 -, epoll_create1 291 20,
epoll_ctl 233 21, epoll_wait 232 -, epoll_pwait 281 22, epoll_pwait2 441 441, eventfd 284 -, eventfd2 290 19, pipe 22 -,
pipe2 293 59, fsync 74 82, fdatasync 75 83, ftruncate 77 46, fallocate 285 47, copy_file_range 326 285, sendfile 40 71,
fadvise64 221 223,

open 2 -, openat 257 56, creat 85 -, stat 4 -, fstat 5 80, lstat 6 -, newfstatat 262 79, statx 332 291, access 21 -,
faccessat 269 48, faccessat2 439 439, getcwd 79 17, chdir 80 49, fchdir 81 50, getdents 78 -, getdents64 217 61,
umask 95 166, statfs 137 43, fstatfs 138 44, rename 82 -, renameat 264 38, renameat2 316 276, mkdir 83 -,
mkdirat 258 34, rmdir 84 -, unlink 87 -, unlinkat 263 35, link 86 -, linkat 265 37, symlink 88 -, symlinkat 266 36,
readlink 89 -, readlinkat 267 78, getxattr 191 8, lgetxattr 192 9, fgetxattr 193 10, listxattr 194 11,
llistxattr 195 12, flistxattr 196 13,

mmap 9 222, munmap 11 215, mremap 25 216, mprotect 10 226, madvise 28 233, brk 12 214, msync 26 227, mincore 27 232,
membarrier 324 283, get_mempolicy 239 236,

futex 202 98, set_robust_list 273 99, get_robust_list 274 100, rseq 334 293, set_tid_address 218 96, sched_yield 24 124,
sched_getaffinity 204 123, sched_getparam 143 121, sched_getscheduler 145 120, sched_get_priority_max 146 125,
sched_get_priority_min 147 126, getpriority 140 141, getcpu 309 168, arch_prctl 158 -,

rt_sigaction 13 134, rt_sigprocmask 14 135, rt_sigreturn 15 139, rt_sigpending 127 136, rt_sigtimedwait 128 137,
rt_sigsuspend 130 133, sigaltstack 131 132, restart_syscall 219 128, pause 34 -, alarm 37 -, setitimer 38 103,
getitimer 36 102,

getpid 39 172, gettid 186 178, getppid 110 173, getpgid 121 155, getpgrp 111 -, getsid 124 156, getuid 102 174,
geteuid 107 175, getgid 104 176, getegid 108 177, getgroups 115 158, getresuid 118 148, getresgid 120 150,
capget 125 90, uname 63 160, sysinfo 99 179, times 100 153, getrusage 98 165, getrlimit 97 163, getrandom 318 278,
time 201 -, gettimeofday 96 169, clock_gettime 228 113, clock_getres 229 114, nanosleep 35 101, clock_nanosleep 230 115,
wait4 61 260, waitid 247 95, exit 60 93, exit_group 231 94,

recvfrom 45 207, shutdown 48 210, getsockopt 55 209, setsockopt 54 208, getsockname 51 204, getpeername 52 205
"""
_NEWER_THAN = 451

#: Calls that depend on an argument.
_CONDITIONAL = """
kill 62 129, tgkill 234 131, prlimit64 302 261, clone 56 220, ioctl 16 29, fcntl 72 25, prctl 157 167, sendto 44 206,
socketpair 53 199
"""

#: Calls with an error of their own.
_REFUSED = {
    "fork 57 -, vfork 58 -": errno.EAGAIN,
    "clone3 435 435": errno.ENOSYS,
    "socket 41 198": errno.ENETUNREACH,
}

_CLONE_THREAD = 0x10000
_AF_UNIX = 1
#: TCGETS (is it a terminal?), TIOCGWINSZ, FIONREAD, FIONBIO, FIONCLEX, FIOCLEX.
_IOCTLS = (0x5401, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)
#: F_SETOWN, F_SETSIG, F_SETOWN_EX, F_SETLEASE, F_NOTIFY: with each the kernel sends signals.
_NOT_FCNTLS = (8, 10, 15, 1024, 1026)
#: PR_GET_DUMPABLE, PR_SET_NAME, PR_GET_NAME, PR_GET_NO_NEW_PRIVS, PR_SET_VMA.
_PRCTLS = (3, 15, 16, 39, 0x53564D41)

# struct seccomp_data: nr, arch, instruction pointer, six 64-bit arguments.
_NR, _ARCH, _ARGS = 0, 4, 16
_LOAD, _JEQ, _JGT, _JGE, _JSET, _RET = 0x20, 0x15, 0x25, 0x35, 0x45, 0x06
_ALLOW, _KILL, _ERRNO = 0x7FFF0000, 0x80000000, 0x00050000
_X32 = 0x40000000

_PR_SET_SECCOMP = 22
_PR_GET_SECCOMP = 21
_MODE_FILTER = 2

Instruction = tuple[int, int, int, int]
_INSTRUCTION = struct.Struct("<HBBI")


def available() -> bool:
    """Whether this kernel and this machine support the filter."""
    if sys.platform != "linux" or platform.machine() not in _MACHINES:
        return False
    return int(ctypes.CDLL(None).prctl(_PR_GET_SECCOMP, 0, 0, 0, 0)) >= 0


def prepare() -> None:
    """Build the filter's common part, so that forked processes need not build it."""
    _listed(*_MACHINES[platform.machine()])


def restrict() -> None:
    """Apply the filter for good to this process and all that it starts. Raises OSError.

    No new privileges must have been set. The process may signal itself by its current id.
    """
    architecture, column = _MACHINES[platform.machine()]
    code = _listed(architecture, column) + _encode(_judged(column, os.getpid()))
    instructions = ctypes.create_string_buffer(code, len(code))

    class Program(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.c_void_p)]

    given = Program(len(code) // _INSTRUCTION.size, ctypes.addressof(instructions))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(given), 0, 0):
        raise OSError(ctypes.get_errno(), "no seccomp filter can be set")


def program(architecture: int, column: int, pid: int) -> list[Instruction]:
    """The filter in classic BPF, for a machine's `architecture` and `column` of numbers, and the process `pid`."""
    code = _listed(architecture, column) + _encode(_judged(column, pid))
    return list(_INSTRUCTION.iter_unpack(code))


@cache
def _listed(architecture: int, column: int) -> bytes:
    """The first part: calls whose arguments do not matter."""
    code: list[Instruction] = [
        *((_LOAD, 0, 0, _ARCH), (_JEQ, 1, 0, architecture), _return(_KILL)),
        *((_LOAD, 0, 0, _NR), (_JGE, 0, 1, _X32), _return(_KILL)),
    ]
    for _, allowed in _numbers(_ALLOWED, column):
        code += [(_JEQ, 0, 1, allowed), _return(_ALLOW)]
    for names, error in _REFUSED.items():
        for _, refused in _numbers(names, column):
            code += [(_JEQ, 0, 1, refused), _return(_ERRNO | error)]
    return _encode(code)


def _judged(column: int, pid: int) -> list[Instruction]:
    """The second part: calls that depend on an argument, and all others."""
    number = dict(_numbers(_CONDITIONAL, column))
    denied = _return(_ERRNO | errno.EPERM)
    judged = {
        "kill": _argument(0, [pid], denied),
        "tgkill": _argument(0, [pid], denied),
        "prlimit64": _argument(0, [0, pid], denied),
        "clone": [(_LOAD, 0, 0, _ARGS), (_JSET, 0, 1, _CLONE_THREAD), _return(_ALLOW), _return(_ERRNO | errno.EAGAIN)],
        "ioctl": _argument(1, _IOCTLS, _return(_ERRNO | errno.ENOTTY)),
        "fcntl": _argument(1, _NOT_FCNTLS, _return(_ALLOW), found=denied),
        "prctl": _argument(0, _PRCTLS, denied),
        # With an address it could reach a socket that it did not inherit.
        "sendto": [
            *((_LOAD, 0, 0, _ARGS + 8 * 4), (_JEQ, 1, 0, 0), denied),
            *((_LOAD, 0, 0, _ARGS + 8 * 4 + 4), (_JEQ, 1, 0, 0), denied, _return(_ALLOW)),
        ],
        "socketpair": _argument(0, [_AF_UNIX], _return(_ERRNO | errno.ENETUNREACH)),
    }
    code: list[Instruction] = []
    for name, instructions in judged.items():
        code += [(_JEQ, 0, len(instructions), number[name]), *instructions]
    return [*code, (_JGT, 0, 1, _NEWER_THAN), _return(_ERRNO | errno.ENOSYS), denied]


def _encode(code: Iterable[Instruction]) -> bytes:
    return b"".join(_INSTRUCTION.pack(*instruction) for instruction in code)


def _numbers(text: str, column: int) -> Iterable[tuple[str, int]]:
    for entry in text.split(","):
        name, *numbers = entry.split()
        if numbers[column] != "-":
            yield name, int(numbers[column])


def _return(action: int) -> Instruction:
    return (_RET, 0, 0, action)


def _argument(
    index: int, values: Iterable[int], otherwise: Instruction, found: Instruction = (_RET, 0, 0, _ALLOW)
) -> list[Instruction]:
    """Answer `found` when the low half of an argument is one of `values`."""
    code: list[Instruction] = [(_LOAD, 0, 0, _ARGS + 8 * index)]
    for value in values:
        code += [(_JEQ, 0, 1, value), found]
    return [*code, otherwise]
