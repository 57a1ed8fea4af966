"""Foreign programs: what each needs and reads, and probes of them in environments of their own.

`uv` makes the environments, of wheels that it keeps; nothing is left in this package's.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.probe import MARK

PROBE = Path(__file__).with_name("probe.py")
PATIENCE_S = 1800.0
"""Of a program for all of its jobs [s]; some compile for minutes."""


class Program(NamedTuple):
    """A foreign program."""

    probe: str
    """Its functions in reader_probe and motion_probe."""
    package: str
    """What it is called where it is installed; its version is told."""
    requirements: tuple[str, ...]
    """Of its environment; none is this one."""
    objects: tuple[str, ...]
    """Files of an object that it reads."""
    scenes: tuple[str, ...] = ()
    """Files of a scene that it reads."""
    moves: bool = False
    """True if it simulates."""
    known: tuple[str, ...] = ()
    """Differences of its own, from the words of `readers.KNOWN`."""


PROGRAMS: dict[str, Program] = {
    "mujoco": Program("mujoco", "mujoco", (), ("object.xml", "object.urdf"), ("scene.xml",), True),
    "mujoco_4": Program(
        "mujoco", "mujoco", ("mujoco>=4,<5",), ("object.xml", "object.urdf"), ("scene.xml",), True
    ),
    "dm_control": Program(
        "dm_control", "dm_control", ("dm_control", "mujoco<4"), ("object.xml",), ("scene.xml",)
    ),
    "yourdfpy": Program("yourdfpy", "yourdfpy", (), ("object.urdf",)),
    "pinocchio": Program("pinocchio", "pin", ("pin>=4.1,<5",), ("object.urdf",)),
    "drake": Program(
        "drake", "drake", ("drake>=1.51",), ("object.urdf", "object.sdf", "object.xml"),
        ("scene.sdf", "scene.dmd.yaml", "scene.xml"), True, ("dry",),
    ),
    "pybullet": Program(
        "pybullet", "pybullet", ("pybullet>=3.2.7,<4",), ("object.urdf",), (), True
    ),
    "sapien": Program(
        "sapien", "sapien", ("sapien>=3,<4",), ("object.urdf",), (), True, ("coefficient",)
    ),
    "newton": Program(
        "newton", "newton", ("newton[importers,sim]>=1.8,<2",),
        ("object.xml", "object.urdf", "object.usda", "newton.usda"),
        ("scene.xml", "scene.usda", "newton.usda"), True,
    ),
    "genesis": Program(
        "genesis", "genesis-world", ("genesis-world>=1.4,<2", "torch"),
        ("object.xml", "object.urdf"), ("scene.xml",), True,
    ),
    "usd": Program("usd", "usd-core", (), ("object.usda",), ("scene.usda",)),
    "nvidia": Program(
        "nvidia", "usd-validation-nvidia",
        ("usd-validation-nvidia", "physx-usd-schemas", "newton-usd-schemas", "usd-core"),
        ("object.usdc",), ("scene.usdc", "isaac.usda", "newton.usda"),
    ),
    "mujoco_usd_converter": Program(
        "mujoco_usd_converter", "mujoco-usd-converter", ("mujoco-usd-converter",), ("object.xml",),
        ("scene.xml",),
    ),
    "urdf_usd_converter": Program(
        "urdf_usd_converter", "urdf-usd-converter", ("urdf-usd-converter",), ("object.urdf",)
    ),
}  # fmt: skip
"""Programs by the name that `--reader` takes."""


def probe(name: str, jobs: list[dict[str, Any]]) -> tuple[str, list[dict[str, Any]]]:
    """Let a program do jobs, and return its version and a result for each job.

    A job on which the program dies has an `error`; the others are done by a new process. What
    cannot be started gives that error for every job that is left.
    """
    program, results, version = PROGRAMS[name], [], ""
    while len(results) < len(jobs):
        lines, error = _run(program, jobs[len(results) :])
        if not lines:
            return version, results + [{"error": error}] * (len(jobs) - len(results))
        version = str(lines[0]["version"])
        results += lines[1:]
        if len(results) < len(jobs):
            results.append({"error": error})
    return version, results


def _run(program: Program, jobs: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], str]:
    python = [sys.executable]
    if program.requirements:
        wanted = [flag for one in program.requirements for flag in ("--with", one)]
        own = f"{sys.version_info.major}.{sys.version_info.minor}"
        python = ["uv", "run", "--quiet", "--no-project", "--python", own, *wanted, "python"]
    command = [*python, str(PROBE), program.probe, program.package]
    try:
        done = subprocess.run(
            command, input=json.dumps(jobs), capture_output=True, text=True, check=False,
            timeout=PATIENCE_S,
        )  # fmt: skip
    except FileNotFoundError:
        return [], "uv is not installed"
    except subprocess.TimeoutExpired as late:
        out = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        return _results(out), f"took more than {PATIENCE_S:g} s"
    error = " ".join(done.stderr.split())[-200:]
    return _results(done.stdout), f"ended with {done.returncode}: {error}"


def _results(text: str) -> list[dict[str, Any]]:
    marked = [line for line in text.splitlines() if line.startswith(MARK)]
    return [json.loads(line.removeprefix(MARK)) for line in marked]
