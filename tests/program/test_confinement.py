"""The confinement of Blender's process, around plain Python."""

import subprocess
import sys
from pathlib import Path

import pytest

from neoworld_mjx.program.blender import confinement

FOLDER = Path(confinement.__file__).parent
BEGIN = f"""
import ctypes, os, socket, sys, threading
sys.path.insert(0, {str(FOLDER)!r})
import confinement
{{before}}
confinement.confine(1024, 20, 1, [sys.prefix, sys.base_prefix, "/lib", "/lib64", "/usr/lib"])
"""


def confined(code, before=""):
    command = [sys.executable, "-I", "-c", BEGIN.format(before=before) + code]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.fixture(scope="module", autouse=True)
def possible():
    done = confined("")
    if "confinement.Unavailable" in done.stderr:
        pytest.skip(done.stderr.splitlines()[-1])


@pytest.mark.parametrize(
    "code",
    [
        "open('/etc/passwd')",
        "os.listdir('/')",
        "open(os.__file__, 'a')",
        "os.open('/tmp', os.O_TMPFILE | os.O_RDWR)",
        "os.mkdir('/tmp/made_by_a_test')",
        "os.chmod('/tmp', 0o777)",
        "os.utime('/tmp')",
        "socket.socket()",
        "socket.socketpair()",
        "os.fork()",
        "os.execv('/bin/true', ['true'])",
        "os.kill(os.getppid(), 0)",
        "os.kill(0, 0)",
        "os.setsid()",
        "os.memfd_create('x')",
        "__import__('resource').setrlimit(7, (9, 9))",
        "os.sched_setaffinity(0, {0, 1})",
    ],
)
def test_access_outside_the_sandbox_is_denied(code):
    done = confined(code)
    assert done.returncode == 1
    assert "PermissionError" in done.stderr or "not allowed to raise" in done.stderr


def test_blender_s_own_needs_are_allowed():
    done = confined(
        "os.kill(os.getpid(), 0)\n"
        "assert open(os.__file__).read(1)\n"
        "import decimal\n"
        "thread = threading.Thread(target=print, args=('in a thread',))\n"
        "thread.start(); thread.join()\n"
        "confinement.end_threads()\n"
        "threading.Thread(target=print).start()\n"
    )
    assert done.stdout == "in a thread\n"
    assert "can't start new thread" in done.stderr


def test_a_kernel_without_landlock_is_refused():
    # A filter that is there first, as in a container that does not know the calls.
    done = confined("", "confinement._CREATE_RULESET = 9999")
    assert "Unavailable: Landlock (Linux 5.13 or later" in done.stderr
