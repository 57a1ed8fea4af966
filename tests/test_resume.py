"""Killed and resumed runs end with the same files as an uninterrupted run."""

import contextlib
import json
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

PHOTO = Path(__file__).parents[1] / "examples" / "coffee.png"
SMALL = (
    *("refine.cem.population=16", "refine.cem.iterations=2", "refine.rollout.duration_s=0.3"),
    *("render.width=96", "render.supersample=1", "verify.duration_s=0.5"),
)
TIMED = {"run.json", "report.html", "run.log", ".lock"}
"""Files with times or process numbers, which differ between runs."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """An uninterrupted run."""
    out = tmp_path_factory.mktemp("whole") / "out"
    _finish(out)
    return out


@pytest.fixture(scope="module")
def seconds(whole) -> float:
    """Duration of the steps of a run with compiled programs [s]."""
    process = _start(whole.with_name("again"))
    assert process.stderr is not None
    process.stderr.readline()
    begun = time.perf_counter()
    process.communicate()
    seconds = time.perf_counter() - begun
    assert _contents(whole) == _contents(whole.with_name("again"))
    return seconds


# tests/test_faults.py kills runs.
@pytest.mark.slow
def test_a_run_killed_in_verification_and_in_the_search_ends_with_the_same_files(whole, tmp_path):
    out = tmp_path / "out"
    for begun in ("verify/", "refine"):
        process = _start(out)
        assert process.stderr is not None
        assert any(line.startswith(begun) for line in process.stderr), f"{begun} never began"
        process.kill()
        process.communicate()
        completed = _steps(out)
    assert len(completed) >= 10
    _resume(out, completed)
    assert _contents(out) == _contents(whole)


@pytest.mark.slow
def test_runs_killed_at_twenty_moments_end_with_the_same_files(whole, seconds, tmp_path):
    draw = random.Random(20)
    expected = _contents(whole)
    at = []
    for i in range(20):
        out = tmp_path / f"out{i}"
        moment = draw.uniform(0, seconds)
        _kill(out, moment)
        completed = _steps(out)
        at.append(f"killed after {moment:.1f} s with {len(completed)} parts of steps done")
        _resume(out, completed)
        assert _contents(out) == expected, at[-1]
    print(*at, sep="\n")
    # The moments cover the whole run, not only its start.
    assert len({text.split(" with ")[1] for text in at}) >= 5


def _start(out: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "neoworld_mjx.cli", "reconstruct", str(PHOTO)]
    options = [word for setting in SMALL for word in ("--set", setting)]
    return subprocess.Popen(
        [*command, "--out", str(out), "--resume", "--json", "-v", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(out: Path) -> str:
    """Run to the end and return the log."""
    answer, log = _start(out).communicate()
    assert "scene" in json.loads(answer), log
    return log


def _kill(out: Path, after: float) -> None:
    """Kill a run a time [s] after its first step started."""
    process = _start(out)
    assert process.stderr is not None
    process.stderr.readline()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.communicate(timeout=after)
    process.kill()
    process.communicate()


def _resume(out: Path, done: dict[str, dict[str, int]]) -> None:
    """Resume, and check that finished steps are neither started nor written again."""
    log = _finish(out).splitlines()
    for name, written in done.items():
        assert f"{name}: started" not in log
        assert {path: (out / path).stat().st_mtime_ns for path in written} == written, name
    data = json.loads((out / "run.json").read_text())
    assert data["status"] == "finished"
    assert set(done) <= set(data["steps"])


def _steps(out: Path) -> dict[str, dict[str, int]]:
    """Return the modification times of all files of the finished steps."""
    path = out / "run.json"
    steps = json.loads(path.read_text())["steps"] if path.exists() else {}
    return {
        name: {file: (out / file).stat().st_mtime_ns for file in entry["outputs"]}
        for name, entry in steps.items()
    }


def _contents(out: Path) -> dict[str, bytes]:
    files = [path for path in out.rglob("*") if path.is_file()]
    result = {str(p.relative_to(out)): p.read_bytes() for p in files if p.name not in TIMED}
    assert {"scene.xml", "scene.usda", "scene.json", "tree.json", "refine/history.npz"} <= set(
        result
    )
    assert "objects/cup/object.usda" in result
    return result
