"""How exported objects move in foreign simulators beside MuJoCo: at rest, and pulled at a joint."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.motion_probe import MOVERS
from benchmarks.readers import interpreter
from benchmarks.suites import Motion
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.export import export_object
from neoworld_mjx.program import build
from neoworld_mjx.spec import JointSpec, ObjectSpec, bounds, inertial
from neoworld_mjx.spec.kinematics import carried
from neoworld_mjx.templates import template

PROBE = Path(__file__).with_name("motion_probe.py")
REST_MM, REST_DEGREES, PULLED = 5.0, 2.0, 0.1
"""How far an object at rest may end beside where it ends in MuJoCo, and a joint, over its value."""
NO_DRY_FRICTION = ("drake",)
"""Programs without dry friction in joints: they are held against MuJoCo without it."""
REST_S, PULL_S = 2.0, 0.5
ACCELERATION = 0.8
"""Force of a pull, over the weight of what it moves times g, besides its dry friction."""


def answer(o: Motion) -> dict[str, Any]:
    """Simulate templates in every program that is installed."""
    pythons = [*o.python, Path(sys.executable)]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in o.object:
            built = build(template(name).program(), ProgramOptions())
            if built.spec is None:
                raise ValueError(f"{name} does not build")
            home = Path(folder) / name
            export_object(built.spec, home)
            rows += simulated(built.spec, home, pythons)
    return {"passed": all(row["within"] is not False for row in rows), "rows": rows}


def simulated(spec: ObjectSpec, home: Path, pythons: list[Path]) -> list[dict[str, Any]]:
    """Return a row for each program and format: motion at rest and of the first slide or hinge."""
    low = float(bounds(spec)[0][2])
    joint = next(
        (j for kind in ("prismatic", "revolute") for j in spec.joints if j.type == kind), None
    )
    rows: list[dict[str, Any]] = []
    pulled = {} if joint is None else {
        "low": low, "seconds": PULL_S, "joint": joint.name, "force": force(spec, joint),
    }  # fmt: skip
    slippery = _probe(
        Path(sys.executable), "mujoco", home / "object.xml", {**pulled, "dry": False}
    ) if pulled else {}  # fmt: skip
    for program, (_, module, suffixes) in MOVERS.items():
        python = interpreter(pythons, module)
        for suffix in suffixes:
            row: dict[str, Any] = {"object": spec.name, "reader": f"{program} {suffix}"}
            rows.append(row)
            if python is None:
                row |= {"within": None, "note": "not installed"}
                continue
            file = home / f"object.{suffix}"
            rest = _probe(python, program, file, {"low": low, "seconds": REST_S})
            pull = _probe(python, program, file, pulled) if pulled else {}
            row |= {"rest_mm": rest.get("mm"), "rest_degrees": rest.get("degrees")}
            row |= {"pulled": pull.get("q"), "note": rest.get("error") or pull.get("error") or ""}
            row["expected"] = slippery.get("q") if program in NO_DRY_FRICTION else rows[0]["pulled"]
            row["within"] = within(row, rows[0])
    return rows


def within(row: dict[str, Any], mujoco: dict[str, Any]) -> bool:
    """Whether an object moved as in MuJoCo."""
    if row["note"] or row["rest_mm"] is None:
        return False
    still = abs(row["rest_mm"] - mujoco["rest_mm"]) <= REST_MM
    still = still and abs(row["rest_degrees"] - mujoco["rest_degrees"]) <= REST_DEGREES
    expected = row["expected"]
    if expected is None:
        return still
    return still and abs(row["pulled"] - expected) <= PULLED * abs(expected)


def force(spec: ObjectSpec, joint: JointSpec) -> float:
    """Return a force [N or N m] that moves a joint a good way in half a second."""
    mass = sum(inertial(spec, spec.part(name)).mass for name in carried(spec, joint))
    arm = 1.0 if joint.type == "prismatic" else 0.1
    return joint.friction + ACCELERATION * mass * arm


def _probe(python: Path, program: str, file: Path, options: dict[str, Any]) -> dict[str, Any]:
    done = subprocess.run(
        [python, PROBE, program, file, json.dumps(options)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    lines = done.stdout.strip().splitlines()
    try:
        return json.loads(lines[-1])
    except (IndexError, json.JSONDecodeError):
        return {"error": f"ended with {done.returncode}: {done.stderr.strip()[-200:]}"}
