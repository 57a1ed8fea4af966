"""Confinement of the current process on Linux: files, system calls, memory and time.

The Blender process runs this module first; it imports only the standard library. Afterwards, the
process can read only Python, Blender and system libraries (Landlock), and cannot open any file for
writing. It can make only the system calls that the filters allow (seccomp), so it cannot create
sockets or processes, or send signals to other processes. The confinement cannot be undone.
"""

import ctypes
import os
import platform
import resource
import struct
import sys
from collections.abc import Iterator, Sequence

MIB = 1 << 20
OPEN_FILES = 256
_ARCHITECTURE = 0xC000003E
"""Identifier of x86_64 in seccomp filters."""
_CALLS = {
    "read": 0, "write": 1, "close": 3, "stat": 4, "fstat": 5, "lstat": 6, "poll": 7, "lseek": 8,
    "mmap": 9, "mprotect": 10, "munmap": 11, "brk": 12, "rt_sigaction": 13, "rt_sigprocmask": 14,
    "rt_sigreturn": 15, "ioctl": 16, "pread64": 17, "readv": 19, "writev": 20, "access": 21,
    "pipe": 22, "select": 23, "sched_yield": 24, "mremap": 25, "madvise": 28, "dup": 32,
    "dup2": 33, "nanosleep": 35, "getpid": 39, "exit": 60, "uname": 63, "fcntl": 72,
    "getcwd": 79, "readlink": 89, "gettimeofday": 96, "getrlimit": 97, "getrusage": 98,
    "sysinfo": 99, "times": 100, "getuid": 102, "getgid": 104, "geteuid": 107, "getegid": 108,
    "getppid": 110, "sigaltstack": 131, "statfs": 137, "fstatfs": 138, "sched_getparam": 143,
    "sched_getscheduler": 145, "sched_get_priority_max": 146, "sched_get_priority_min": 147,
    "arch_prctl": 158, "gettid": 186, "futex": 202, "sched_getaffinity": 204, "getdents64": 217,
    "set_tid_address": 218, "restart_syscall": 219, "fadvise64": 221, "clock_gettime": 228,
    "clock_getres": 229, "clock_nanosleep": 230, "exit_group": 231, "epoll_wait": 232,
    "epoll_ctl": 233, "mbind": 237, "set_mempolicy": 238, "get_mempolicy": 239,
    "newfstatat": 262, "readlinkat": 267, "faccessat": 269, "pselect6": 270, "ppoll": 271,
    "set_robust_list": 273, "epoll_pwait": 281, "eventfd2": 290, "epoll_create1": 291,
    "dup3": 292, "pipe2": 293, "getcpu": 309, "getrandom": 318, "membarrier": 324, "statx": 332,
    "rseq": 334, "faccessat2": 439, "futex_waitv": 449,
}  # fmt: skip
"""Numbers of x86_64 system calls that are allowed with any arguments."""
_OPEN, _OPENAT, _CLONE, _CLONE3 = 2, 257, 56, 435
_KILL, _TGKILL, _PRCTL, _PRLIMIT64, _SECCOMP = 62, 234, 157, 302, 317
_CREATE_RULESET, _ADD_RULE, _RESTRICT = 444, 445, 446
"""Numbers of the system calls of Landlock."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CLONE_THREAD = 0x10000
_PR_SET_PDEATHSIG, _PR_SET_NAME, _PR_GET_NAME, _PR_SET_VMA = 1, 15, 16, 0x53564D41
_PR_SET_NO_NEW_PRIVS, _SET_FILTER, _TSYNC, _SIGKILL = 38, 1, 1, 9
_READ = 1 << 0 | 1 << 2 | 1 << 3
"""Rights in Landlock to execute a file, to read a file and to list a folder."""
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
"""Number of file access rights, by version of Landlock; versions above 5 have as many as 5."""


class Unavailable(Exception):
    """Raised if this machine cannot confine a process; the message names the missing feature."""


def confine(memory_mib: int, cpu_s: float, file_mib: int, readable: Sequence[str]) -> None:
    """Confine this process and all threads that it creates later.

    Args:
        memory_mib: limit on the address space [MiB].
        cpu_s: limit on processor time [s].
        file_mib: size limit of a file that the process writes through an open descriptor [MiB].
        readable: files and folders that the process may open for reading; missing paths are
            skipped.

    Raises:
        Unavailable: the system lacks a required feature.
    """
    _check_machine()
    _call("prctl", _libc().prctl(_PR_SET_PDEATHSIG, _SIGKILL, 0, 0, 0))
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[os.getpid() % len(cores)]})
    for kind, limit in (
        (resource.RLIMIT_AS, memory_mib * MIB),
        (resource.RLIMIT_CPU, max(1, round(cpu_s))),
        (resource.RLIMIT_FSIZE, file_mib * MIB),
        (resource.RLIMIT_NOFILE, OPEN_FILES),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(kind, (limit, limit))
    _call("prctl", _libc().prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
    _restrict_files(readable)
    _install(list(_first_filter()))


def end_threads() -> None:
    """Forbid new threads and new filters."""
    steps: list[_Step] = [(_LOAD, 0, 0, 0)]
    for number in (_CLONE, _SECCOMP):
        steps += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _EPERM)]
    _install([*steps, (_RETURN, 0, 0, _ALLOW)])


def _check_machine() -> None:
    machine = platform.machine()
    if sys.platform != "linux":
        raise Unavailable("Linux, for Landlock and seccomp")
    if machine != "x86_64":
        raise Unavailable(f"an x86_64 processor; this one is {machine}")


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _call(name: str, result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise Unavailable(f"{name} ({os.strerror(number)})")
    return result


def _restrict_files(readable: Sequence[str]) -> None:
    """Allow this process to open only the paths in `readable`, and only for reading."""
    call = _libc().syscall
    call.restype = ctypes.c_long
    version = call(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    if version < 1:
        raise Unavailable(
            "Landlock (Linux 5.13 or later, with 'landlock' among the kernel's lsm= modules, and a "
            "container that allows it)"
        )
    handled = (1 << _RIGHTS[min(version, max(_RIGHTS))]) - 1
    rules = struct.pack("=Q", handled)
    ruleset = _call("landlock_create_ruleset", call(_CREATE_RULESET, rules, ctypes.c_size_t(8), 0))
    for path in readable:
        try:
            handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue
        rights = _READ if os.path.isdir(path) else _READ & ~(1 << 3)
        rule = struct.pack("=Qi", rights, handle)
        _call(f"landlock_add_rule of {path}", call(_ADD_RULE, ruleset, 1, rule, 0))
        os.close(handle)
    _call("landlock_restrict_self", call(_RESTRICT, ruleset, 0))
    os.close(ruleset)


_Step = tuple[int, int, int, int]
"""Instruction of a BPF filter: code, jump if true, jump if false, and operand."""
_LOAD, _EQUAL, _ANY, _RETURN = 0x20, 0x15, 0x45, 0x06
_ALLOW, _KILL_ALL, _EPERM, _ENOSYS = 0x7FFF0000, 0x80000000, 0x50001, 0x50026


def _argument(k: int, high: bool = False) -> _Step:
    return (_LOAD, 0, 0, 16 + 8 * k + 4 * high)


def _first_filter() -> Iterator[_Step]:
    """Yield a filter that allows the calls in `_CALLS`, and a few others with certain arguments."""
    pid = os.getpid()
    yield from ((_LOAD, 0, 0, 4), (_EQUAL, 1, 0, _ARCHITECTURE), (_RETURN, 0, 0, _KILL_ALL))
    yield (_LOAD, 0, 0, 0)
    allowed: list[tuple[int, list[_Step]]] = [
        (_OPEN, _unless_any(1, _WRITES)),
        (_OPENAT, _unless_any(2, _WRITES)),
        (_CLONE, _if_any(0, _CLONE_THREAD)),
        (_KILL, _if_equal(0, pid)),
        (_TGKILL, _if_equal(0, pid)),
        (_PRCTL, _if_equal(0, _PR_SET_NAME, _PR_GET_NAME, _PR_SET_VMA)),
        (_PRLIMIT64, [*_null(2)]),
        (_CLONE3, [(_RETURN, 0, 0, _ENOSYS)]),
        (_SECCOMP, [(_RETURN, 0, 0, _ALLOW)]),
    ]
    for number, steps in allowed:
        yield (_EQUAL, 0, len(steps), number)
        yield from steps
    for number in _CALLS.values():
        yield from ((_EQUAL, 0, 1, number), (_RETURN, 0, 0, _ALLOW))
    yield (_RETURN, 0, 0, _EPERM)


def _unless_any(k: int, bits: int) -> list[_Step]:
    return [_argument(k), (_ANY, 0, 1, bits), (_RETURN, 0, 0, _EPERM), (_RETURN, 0, 0, _ALLOW)]


def _if_any(k: int, bits: int) -> list[_Step]:
    return [_argument(k), (_ANY, 0, 1, bits), (_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _EPERM)]


def _if_equal(k: int, *values: int) -> list[_Step]:
    tests = [(_EQUAL, len(values) - n, 0, value) for n, value in enumerate(values)]
    return [_argument(k), *tests, (_RETURN, 0, 0, _EPERM), (_RETURN, 0, 0, _ALLOW)]


def _null(k: int) -> list[_Step]:
    """Return steps that allow a call if the pointer argument `k` is null."""
    test = ((_EQUAL, 1, 0, 0), (_RETURN, 0, 0, _EPERM))
    return [_argument(k), *test, _argument(k, True), *test, (_RETURN, 0, 0, _ALLOW)]


def _install(steps: Sequence[_Step]) -> None:
    """Install a filter for system calls of all threads."""
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    program = struct.pack("@HP", len(steps), ctypes.addressof(code))
    call = _libc().syscall
    call.restype = ctypes.c_long
    result = call(_SECCOMP, _SET_FILTER, ctypes.c_ulong(_TSYNC), program)
    _call(
        "seccomp filters (CONFIG_SECCOMP_FILTER, and a container that allows them)",
        -1 if result else 0,
    )
