"""Runs that a fault ends, and resumed runs: the same bytes, and no finished step is done again."""

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from neoworld_mjx.config import load_config
from neoworld_mjx.errors import NeoWorldError
from neoworld_mjx.io import files
from neoworld_mjx.mllm.replay import Replay
from neoworld_mjx.pipeline import reconstruct

PHOTO = Path(__file__).parents[1] / "examples" / "coffee.png"
SMALL = {
    "render": {"width": 96, "supersample": 1},
    "verify": {"duration_s": 0.5},
    "refine": {"cem": {"population": 16, "iterations": 2}, "rollout": {"duration_s": 0.3}},
}
TIMED = {"run.json", "report.html", ".lock"}
"""Files that contain times or process numbers."""
KILLED = """
import os, signal, sys
from tests import test_faults

replace, count = os.replace, [int(sys.argv[2])]

def replaced(*args, **options):
    replace(*args, **options)
    count[0] -= 1
    if count[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)

os.replace = replaced
test_faults.run(test_faults.Path(sys.argv[1]), until=sys.argv[3] or None)
"""
"""Program that runs the example until it has written a number of files."""


def run(out: Path, until: str | None = "verify") -> None:
    """Run or resume the example, by default up to the checks of its objects."""
    reconstruct(PHOTO, out, load_config(None, SMALL), resume=out.exists(), until=until)


def killed(out: Path, count: int, until: str = "verify") -> None:
    """Run the example until it has written a number of files; then it is killed."""
    words = [sys.executable, "-c", KILLED, str(out), str(count), until]
    root = Path(__file__).parents[1]
    done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr


def contents(out: Path) -> dict[str, bytes]:
    found = [path for path in out.rglob("*") if path.is_file() and path.name not in TIMED]
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in found}


def finished(out: Path) -> dict[str, int]:
    """Return when the files of finished steps were written, by path [ns]."""
    path = out / "run.json"
    steps = json.loads(path.read_text())["steps"] if path.exists() else {}
    return {
        name: (out / name).stat().st_mtime_ns for step in steps.values() for name in step["outputs"]
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, bytes]:
    """The files of a run without a fault."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run(out)
    return contents(out)


def full_disk(monkeypatch, count: int) -> None:
    """Let every write after the first `count` writes fail as on a full disk."""
    write, left = files.os.fsync, [count]

    def fsync(handle: int) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(handle)

    monkeypatch.setattr(files.os, "fsync", fsync)


def lost_provider(monkeypatch, count: int) -> None:
    """Let every request after the first `count` requests fail."""
    reply, left = Replay.reply, [count]

    async def replied(self, *args):
        left[0] -= 1
        if left[0] < 0:
            raise ConnectionError("the server is gone")
        return await reply(self, *args)

    monkeypatch.setattr(Replay, "reply", replied)


@pytest.mark.parametrize(
    ("fault", "count"),
    [
        ("killed", 3),
        pytest.param("killed", 25, marks=pytest.mark.slow),
        (full_disk, 12),
        (lost_provider, 0),
    ],
)
def test_a_run_resumes_after_a_fault_with_the_same_files(
    tmp_path, monkeypatch, whole, fault, count
):
    out = tmp_path / "out"
    if fault == "killed":
        killed(out, count)
    else:
        with monkeypatch.context() as patched:
            fault(patched, count)
            with pytest.raises(NeoWorldError, match=r"space|server is gone|No space left"):
                run(out)
    done_before = finished(out)
    run(out)
    assert contents(out) == whole
    assert {name: finished(out)[name] for name in done_before} == done_before


@pytest.mark.slow
def test_a_run_killed_at_many_moments_ends_with_the_same_files(tmp_path):
    run(tmp_path / "whole", until=None)
    out = tmp_path / "out"
    for count in (1, 10, 20, 20, 20):
        killed(out, count, until="")
    run(out, until=None)
    assert contents(out) == contents(tmp_path / "whole")
