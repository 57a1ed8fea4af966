"""Which foreign programs read our files, and what they make of them, beside what we mean."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reader_probe import READERS
from benchmarks.suites import Readers
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.export import export_object
from neoworld_mjx.physics.mjcf import body_name
from neoworld_mjx.program import build
from neoworld_mjx.spec import ObjectSpec, inertial

OBJECTS = Path(__file__).parents[1] / "examples" / "objects"
PROBE = Path(__file__).with_name("reader_probe.py")
TOLERANCE_M, TOLERANCE_MASS = 1e-6, 1e-5


def answer(o: Readers) -> dict[str, Any]:
    """Export objects, let every reader that is installed read them, and compare."""
    pythons = [*o.python, Path(sys.executable)]
    names = o.object or tuple(sorted(path.stem for path in OBJECTS.glob("*.py")))
    wanted = o.reader or tuple(READERS)
    rows: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        specs = {}
        for name in names:
            built = build((OBJECTS / f"{name}.py").read_text(), ProgramOptions())
            if built.spec is None:
                raise ValueError(f"{name} does not build")
            specs[name] = built.spec
            export_object(built.spec, Path(folder) / name)
        for reader in wanted:
            _, module, suffixes = READERS[reader]
            python = interpreter(pythons, module)
            for suffix in suffixes:
                row = f"{reader} {suffix}"
                if python is None:
                    rows[row] = {"installed": False}
                    continue
                faults: list[str] = []
                for name, spec in specs.items():
                    file = Path(folder) / name / f"object.{suffix}"
                    faults += [f"{name}: {f}" for f in compare(spec, _probe(python, reader, file))]
                rows[row] = {"installed": True, "objects": len(specs), "faults": faults}
    return {"passed": not any(row.get("faults") for row in rows.values()), "readers": rows}


def compare(spec: ObjectSpec, read: dict[str, Any]) -> list[str]:
    """List in words where a reader's object is not what the spec means."""
    if "error" in read:
        return [read["error"]]
    faults = []
    mass = sum(inertial(spec, part).mass for part in spec.parts)
    if abs(read["mass"] - mass) > TOLERANCE_MASS * mass:
        faults.append(f"mass {read['mass']:g} kg, not {mass:g}")
    moving = sum(joint.type != "fixed" for joint in spec.joints)
    if read["joints"] != moving:
        faults.append(f"{read['joints']} joints that move, not {moving}")
    pieces = sum(
        len(geom.shape.pieces()) for p in spec.parts for geom in p.geoms if geom.role != "visual"
    )
    if read["shapes"] < pieces:
        faults.append(f"{read['shapes']} colliders, not {pieces}")
    for joint in spec.joints:
        at = next(
            (
                read["links"][name]
                for name in (joint.child, body_name(spec, joint.child))
                if name in read["links"]
            ),
            None,
        )
        if at is not None and read.get("base") != "com":
            gap = float(np.linalg.norm(np.array(at) - np.array(joint.pos)))
            if gap > TOLERANCE_M:
                faults.append(f"link {joint.child} {1e3 * gap:.3g} mm beside its place")
    return faults


def interpreter(pythons: list[Path], module: str) -> Path | None:
    """Return the first interpreter that has a module."""
    return next((python for python in pythons if _has(python, module)), None)


def _has(python: Path, module: str) -> bool:
    # The module's own folder is no place of ours: modules here have names of packages.
    text = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
    return subprocess.run([python, "-I", "-c", text], check=False).returncode == 0


def _probe(python: Path, reader: str, file: Path) -> dict[str, Any]:
    done = subprocess.run(
        [python, PROBE, reader, file], capture_output=True, text=True, check=False, timeout=600
    )
    lines = done.stdout.strip().splitlines()
    try:
        return json.loads(lines[-1])
    except (IndexError, json.JSONDecodeError):
        return {"error": f"ended with {done.returncode}: {done.stderr.strip()[-200:]}"}
