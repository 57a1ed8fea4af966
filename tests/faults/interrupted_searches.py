"""Ctrl-C during the refinement of a run, and what the resumed run makes.

    python -m tests.faults.interrupted_searches FIRST COUNT [PHOTO]

prints one JSON line for each seed. The command runs as a user starts it. A moment after the log
says that the refinement has begun, drawn from the seed, its process gets SIGINT. It must end with
exit code 130, within `LIMIT_S`, leave no process behind, and resume to the same scene.xml. Up to
three runs are interrupted in the same folder before it is finished.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from neoworld_mjx.cache import VARIABLE
from tests.faults.strikes import EXAMPLES
from tests.support.processor_time import processor_s

SETTINGS = (
    *("refine.cem.population=16", "refine.cem.iterations=6", "refine.rollout.duration_s=0.3"),
    *("render.width=96", "render.supersample=1", "verify.duration_s=0.5"),
)
LIMIT_S = 2.0
"""Time from the signal to the end of the process, on a machine that is not busy."""


def started(out: Path, photo: str, *words: str) -> subprocess.Popen[str]:
    """Start or resume a run in a session of its own."""
    options = [word for setting in SETTINGS for word in ("--set", setting)]
    return subprocess.Popen(
        [sys.executable, "-m", "neoworld_mjx.cli", "reconstruct", str(EXAMPLES / photo)]
        + ["--out", str(out), "--resume", "-v", *options, *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def refining(run: "subprocess.Popen[str]") -> float:
    """Wait until a run refines, and return when that was."""
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("refine: started"):
            return time.monotonic()
    raise RuntimeError(f"the run never refined: it ended with {run.wait()}")


def finished(out: Path, photo: str) -> tuple[bytes, float]:
    """Finish a run; return its scene and the duration of the refinement [s], 0 if it was over."""
    began = seconds = 0.0
    with started(out, photo) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if line.startswith("refine: started"):
                began = time.monotonic()
            elif line.startswith("refine: done"):
                seconds = time.monotonic() - began
    if run.returncode not in (0, 1):  # 1: the scene does not pass its check.
        raise RuntimeError(f"a run ended with {run.returncode}")
    return (out / "scene.xml").read_bytes(), seconds


def members(session: int) -> list[int]:
    """Return the processes of a session that have not ended."""
    alive = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] not in "ZX":
            alive.append(int(folder.name))
    return alive


def strike(out: Path, photo: str, after: float) -> dict[str, Any]:
    """Interrupt a run a time [s] after its refinement began, and tell how it ended."""
    with started(out, photo) as run:
        refining(run)
        lines: list[str] = []
        assert run.stderr is not None
        drain = threading.Thread(target=lines.extend, args=(run.stderr,))
        drain.start()
        time.sleep(after)
        at, used = time.monotonic(), processor_s(run.pid)
        run.send_signal(signal.SIGINT)
        while os.waitid(os.P_PID, run.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            time.sleep(0.01)
        wall_s = time.monotonic() - at
        # The ended process keeps its times until it is waited for.
        own_s = processor_s(run.pid) - used
        code = run.wait()
        left = members(run.pid)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        drain.join()
    times = {"after_s": round(after, 2), "wall_s": round(wall_s, 2), "own_s": round(own_s, 2)}
    if any(line.startswith("refine: done") for line in lines):
        return times | {"moment": "after the refinement", "wrong": ""}
    wrong = ""
    if code != 130 or sum(line.startswith("error: interrupted") for line in lines) != 1:
        wrong = f"ended with {code}: {lines[-3:]}"
    elif any("Traceback" in line for line in lines):
        first = next(k for k, line in enumerate(lines) if "Traceback" in line)
        wrong = f"printed a traceback: {''.join(lines[max(first - 2, 0) :])}"
    elif wall_s > LIMIT_S:
        wrong = "took too long to end"
    elif left:
        wrong = f"left processes behind: {left}"
    return times | {"moment": "in the refinement", "wrong": wrong}


def main(first: int, count: int, photo: str) -> None:
    """Print what the interruptions of some seeds did, up to three in a folder."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        os.environ[VARIABLE] = str(home / "cache")
        with started(home / "composed", photo, "--until", "compose") as run:
            error = run.communicate()[1]
        if run.returncode:
            raise RuntimeError(f"the undisturbed run ended with {run.returncode}: {error[-500:]}")
        shutil.copytree(home / "composed", home / "whole")
        expected, seconds = finished(home / "whole", photo)
        out, waiting = home / "struck", list[dict[str, Any]]()
        for seed in range(first, first + count):
            if not out.exists():
                shutil.copytree(home / "composed", out)
            row = strike(out, photo, random.Random(seed).uniform(0, seconds))
            waiting.append({"seed": seed, **row})
            if len(waiting) < 3 and seed + 1 < first + count and "in the" in row["moment"]:
                continue
            scene, lasted = finished(out, photo)
            # With compiled programs in the cache, or less load, the refinement is shorter.
            seconds = lasted or 0.7 * seconds
            for waited in waiting:
                if scene != expected:
                    waited["wrong"] = waited["wrong"] or "the resumed run made another scene.xml"
                print(json.dumps(waited), flush=True)
            waiting.clear()
            shutil.rmtree(out)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), (*sys.argv[3:], "microwave.jpg")[0])
