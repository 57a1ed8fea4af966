"""Ctrl-C during the refinement of a run, and what the resumed run makes.

    python -m tests.faults.interrupted_searches FIRST COUNT [PHOTO]

prints one JSON line for each seed. The command runs as a user starts it. A moment after the log
says that the refinement has begun, drawn from the seed, its process gets SIGINT. It must end with
exit code 130, within `LIMIT_S`, leave no process behind, and resume to the same scene.xml.
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
"""Time from the signal to the end of the process, less what others keep its cores busy."""


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
    """Finish a run; return its scene and the duration of the refinement [s]."""
    with started(out, photo) as run:
        began = refining(run)
        assert run.stderr is not None
        seconds = 0.0
        for line in run.stderr:
            if not seconds and line.startswith("refine: done"):
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


def strike(seed: int, home: Path, photo: str, expected: bytes, seconds: float) -> dict[str, Any]:
    """Interrupt a run at the moment of a seed, resume it, and tell how both ended."""
    out = Path(shutil.copytree(home / "composed", home / f"run{seed}"))
    after = random.Random(seed).uniform(0, seconds)
    with started(out, photo) as run:
        refining(run)
        lines: list[str] = []
        assert run.stderr is not None
        drain = threading.Thread(target=lines.extend, args=(run.stderr,))
        drain.start()
        time.sleep(after)
        at, used = time.monotonic(), processor_s(run.pid)
        if run.poll() is not None:
            raise RuntimeError("the refinement was over before the signal")
        run.send_signal(signal.SIGINT)
        while os.waitid(os.P_PID, run.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            time.sleep(0.01)
        wall_s = time.monotonic() - at
        # The ended process is a zombie until it is waited for, which keeps its times.
        own_s = processor_s(run.pid) - used
        code = run.wait()
        time.sleep(0.2)
        left = members(run.pid)
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        drain.join()
    said = [line for line in lines if line.startswith("error")]
    steps = json.loads((out / "run.json").read_text())["steps"]
    scene, _ = finished(out, photo) if "refine" not in steps else (b"", 0.0)
    wrong = ""
    if "refine" in steps:
        wrong = "the refinement was over before the signal"
    elif code != 130 or len(said) != 1 or any("Traceback" in line for line in lines):
        wrong = f"ended with {code}: {lines[-3:]}"
    elif wall_s > LIMIT_S and own_s > LIMIT_S:
        wrong = f"took {wall_s:.1f} s to end, {own_s:.1f} s of processor time"
    elif left:
        wrong = f"left processes behind: {left}"
    elif scene != expected:
        wrong = "the resumed run made another scene.xml"
    shutil.rmtree(out)
    times = {"after_s": round(after, 2), "wall_s": round(wall_s, 2), "own_s": round(own_s, 2)}
    return {"seed": seed, **times, "wrong": wrong}


def main(first: int, count: int, photo: str) -> None:
    """Print what the interruptions of some seeds did."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        os.environ[VARIABLE] = str(home / "cache")
        with started(home / "composed", photo, "--until", "compose") as run:
            error = run.communicate()[1]
        if run.returncode:
            raise RuntimeError(f"the undisturbed run ended with {run.returncode}: {error[-500:]}")
        shutil.copytree(home / "composed", home / "whole")
        expected, _ = finished(home / "whole", photo)
        # Compiled programs are in the cache now, so that the second run has the usual duration.
        shutil.copytree(home / "composed", home / "again")
        again, seconds = finished(home / "again", photo)
        assert again == expected
        for seed in range(first, first + count):
            print(json.dumps(strike(seed, home, photo, expected, seconds)), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), (*sys.argv[3:], "microwave.jpg")[0])
