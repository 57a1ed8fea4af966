"""Other simulators and readers: requirements, file formats, and probes in separate environments.

`uv` creates the environments from cached wheels; the environment of this package is not changed.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.probe import MARK

PROBE = Path(__file__).with_name("probe.py")
TIMEOUT_S = 1800.0
"""Time limit of a program for all of its jobs [s]; some compile for minutes."""


class Program(NamedTuple):
    """A simulator or reader by others."""

    probe: str
    """Key of its functions in reader_probe and motion_probe."""
    package: str
    """Name of its installed package, whose version is reported."""
    requirements: tuple[str, ...]
    """Requirements of its environment; none for this package's own environment."""
    objects: tuple[str, ...]
    """Object files that it reads."""
    scenes: tuple[str, ...] = ()
    """Scene files that it reads."""
    moves: bool = False
    """True if it simulates."""
    known: tuple[str, ...] = ()
    """Known differences, as keys of `readers.KNOWN`."""


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
"""Programs by their names for `--reader`."""


def probe(name: str, jobs: list[dict[str, Any]]) -> tuple[str, list[dict[str, Any]]]:
    """Run jobs in a program; return its version and a result for each job.

    A job that crashes the program has an `error`; a new process does the remaining jobs. If the
    program does not start, all remaining jobs have that error.
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
        with_flags = [flag for one in program.requirements for flag in ("--with", one)]
        python_version = f"{sys.version_info.major}.{sys.version_info.minor}"
        python = [
            "uv",
            "run",
            "--quiet",
            "--no-project",
            "--python",
            python_version,
            *with_flags,
            "python",
        ]
    command = [*python, str(PROBE), program.probe, program.package]
    try:
        done = subprocess.run(
            command, input=json.dumps(jobs), capture_output=True, text=True, check=False,
            timeout=TIMEOUT_S,
        )  # fmt: skip
    except FileNotFoundError:
        return [], "uv is not installed"
    except subprocess.TimeoutExpired as late:
        out = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        return _results(out), f"took more than {TIMEOUT_S:g} s"
    error = " ".join(done.stderr.split())[-200:]
    return _results(done.stdout), f"ended with {done.returncode}: {error}"


def _results(text: str) -> list[dict[str, Any]]:
    marked = [line for line in text.splitlines() if line.startswith(MARK)]
    return [json.loads(line.removeprefix(MARK)) for line in marked]
