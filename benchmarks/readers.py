"""Exported files in other simulators: what they read, and motion compared with MuJoCo."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import neoworld_mjx as nw
from benchmarks.foreign import PROGRAMS, Program, probe
from benchmarks.motion_probe import degrees
from benchmarks.pulls import PULL_S, pull_of
from benchmarks.suites import Readers
from neoworld_mjx.config import ProgramOptions, load_config
from neoworld_mjx.errors import NeoWorldError
from neoworld_mjx.export import export_object, export_scene, import_mjcf
from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.physics.mjcf import body_name
from neoworld_mjx.program import build
from neoworld_mjx.spec import ObjectSpec, SceneSpec, bounds, inertial, read_scene, world_poses

ROOT = Path(__file__).parents[1]
OBJECTS = ROOT / "examples" / "objects"
TOLERANCE_M, TOLERANCE_MASS, LEAST_KG = 1e-6, 1e-5, 1e-5
"""Tolerances of positions, of masses (relative) and of small masses; SAPIEN and others give each
frame a milligram."""
REST_MM, REST_DEGREES, PULLED = 5.0, 2.0, 0.1
"""Tolerances of resting poses against MuJoCo's, and of pulled joints relative to their value."""
REST_S = 2.0
ASSET = "asset_"
"""Prefix of the names of external assets, which are counted separately."""
KNOWN = {
    "dry": "has no dry friction of joints: pulls are compared with MuJoCo's without it",
    "coefficient": "reads URDF's dry friction as a coefficient: it is set to 0 there and in MuJoCo",
}
"""Known differences of programs, for which the comparison allows."""
CHECKS = ("loads", "joints", "masses", "colliders", "places", "rest", "pulled")
Row = dict[str, Any]
Results = dict[Any, dict[str, Any]]
"""Results by ((object, kind of job), dry friction), and by "scene"."""


def run_suite(o: Readers) -> dict[str, Any]:
    """Export objects and a scene, read and simulate them in other programs, and compare."""
    names = o.reader or tuple(PROGRAMS)
    for name in names:
        if name not in PROGRAMS:
            raise ValueError(f"no reader {name}; readers are {', '.join(PROGRAMS)}")
    rows: list[Row] = []
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        scene = None if o.no_scene else example_scene(o.scene, home)
        specs = {spec.name: spec for spec in objects(o, scene)}
        for name, spec in specs.items():
            export_object(spec, home / name)
            write_formats(spec, home / name, ["usd"], simulator="newton")
        expected = expectations(home, specs, scene)
        for name in names:
            new = rows_of(name, home, specs, scene, expected)
            faults += [f"{row['reader']} {row['file']}: {f}" for row in new for f in row["faults"]]
            rows += new
    if o.figure is not None:
        write_figure(o.figure, rows)
    return {"passed": not faults, "objects": len(specs), "rows": rows, "faults": faults}


def example_scene(run: Path | None, home: Path) -> SceneSpec:
    """Return the scene of a run folder, or of the bundled example, written in every form."""
    if run is None:
        run = home / "example"
        nw.reconstruct(ROOT / "examples" / "coffee.png", run, load_config())
    scene = read_scene(run)
    export_scene(scene, home / "scene")
    for simulator in ("newton", "isaac"):
        write_formats(scene, home / "scene", ["usd"], simulator=simulator)
    return scene


def objects(o: Readers, scene: SceneSpec | None) -> Iterator[ObjectSpec]:
    """Yield the programs of examples/objects, the scene's objects and the assets."""
    for path in sorted(OBJECTS.glob("*.py")):
        if not o.object or path.stem in o.object:
            built = build(path.read_text(), ProgramOptions())
            if built.spec is None:
                raise ValueError(f"{path.stem} does not build")
            yield built.spec.model_copy(update={"name": path.stem})
    for item in scene.objects if scene is not None else ():
        yield item.spec.model_copy(update={"name": f"example_{item.name}"})
    for path in sorted(o.assets.glob("*/model.xml")) if o.assets is not None else ():
        with contextlib.suppress(NeoWorldError):
            name = f"{ASSET}{path.parent.name}"
            yield import_mjcf(path).spec.model_copy(update={"name": name})


def expectations(home: Path, specs: dict[str, ObjectSpec], scene: SceneSpec | None) -> Results:
    """Return the motions in this environment's MuJoCo, by the jobs of `jobs_of`."""
    result: Results = {}
    for dry in (True, False):
        jobs = jobs_of(home, specs, "object.xml", dry)
        _, done = probe("mujoco", list(jobs.values()))
        result |= {(key, dry): one for key, one in zip(jobs, done, strict=True)}
    if scene is not None:
        job = {"move": str(home / "scene" / "scene.xml"), "scene": True, "seconds": REST_S}
        result["scene"] = probe("mujoco", [job])[1][0]
    return result


def jobs_of(
    home: Path, specs: dict[str, ObjectSpec], name: str, dry: bool
) -> dict[tuple[str, str], dict[str, Any]]:
    """Return simulation jobs by (object, kind): at rest, and pulled by a handle."""
    jobs: dict[tuple[str, str], dict[str, Any]] = {}
    for key, spec in specs.items():
        file = str(home / key / name)
        low = float(bounds(spec)[0][2])
        jobs[key, "rest"] = {"move": file, "low": low, "seconds": REST_S}
        pull = pull_of(spec, dry=dry)
        if pull is not None:
            jobs[key, "pulled"] = {"move": file, "seconds": PULL_S, "dry": dry, **pull._asdict()}
    return jobs


def rows_of(
    name: str,
    home: Path,
    specs: dict[str, ObjectSpec],
    scene: SceneSpec | None,
    expected: Results,
) -> list[Row]:
    """Run a program, and return a row for each object format and scene file."""
    program = PROGRAMS[name]
    jobs: list[dict[str, Any]] = []
    places: list[tuple[int, str, str]] = []
    rows: list[Row] = []

    def add(row: int, key: str, what: str, job: dict[str, Any]) -> None:
        places.append((row, key, what))
        jobs.append(job)

    for file in program.objects:
        row = len(rows)
        rows.append({"file": file, "scene": False})
        for key in specs:
            add(row, key, "read", {"read": str(home / key / file)})
        if program.moves:
            moved = jobs_of(home, specs, file, not program.known)
            for (key, what), job in moved.items():
                add(row, key, what, job)
    for file in program.scenes if scene is not None else ():
        row, path = len(rows), str(home / "scene" / file)
        rows.append({"file": file, "scene": True})
        add(row, "scene", "read", {"read": path})
        if program.moves:
            add(row, "scene", "rest", {"move": path, "scene": True, "seconds": REST_S})
    version, results = probe(name, jobs)
    for k, row in enumerate(rows):
        own = {
            (key, what): r for (at, key, what), r in zip(places, results, strict=True) if at == k
        }
        compared = _compare_scene if row["scene"] else _compare_objects
        row |= {"reader": name, "version": version}
        row |= compared(program, own, specs, scene, expected)
    return rows


def _compare_objects(
    program: Program, own: Results, specs: dict[str, ObjectSpec],
    scene: SceneSpec | None, expected: Results,
) -> Row:  # fmt: skip
    tally = {(check, kind): (0, 0) for check in CHECKS for kind in (False, True)}
    faults: list[str] = []

    def note(check: str, name: str, fault: str | None) -> None:
        kind = name.startswith(ASSET)
        good, of = tally[check, kind]
        tally[check, kind] = (good + (fault is None), of + 1)
        if fault is not None:
            faults.append(f"{name}: {check}: {fault}")

    for name, spec in specs.items():
        read = own[name, "read"]
        note("loads", name, read.get("error"))
        if "error" not in read:
            for check, fault in compare(spec, read).items():
                note(check, name, fault)
        for what in ("rest", "pulled"):
            if (name, what) in own:
                reference = expected[(name, what), not program.known]
                note(what, name, apart(own[name, what], reference))
    shares = {
        check: ", ".join(filter(None, (_share(tally[check, kind]) for kind in (False, True))))
        for check in CHECKS
    }
    return {**shares, "faults": faults}


def compare(spec: ObjectSpec, read: dict[str, Any]) -> dict[str, str | None]:
    """Return the difference of a reader's object from the spec in words; None if equal."""
    mass = sum(inertial(spec, part).mass for part in spec.parts)
    light = abs(read["mass"] - mass) > max(TOLERANCE_MASS * mass, LEAST_KG)
    moving = sum(joint.type != "fixed" for joint in spec.joints)
    # URDF has three hinges for a ball joint.
    turns = moving + 2 * sum(joint.type == "ball" for joint in spec.joints)
    pieces = sum(
        len(geom.shape.pieces()) for p in spec.parts for geom in p.geoms if geom.role != "visual"
    )
    result: dict[str, str | None] = {
        "masses": f"{read['mass']:g} kg, not {mass:g}" if light else None,
        "joints": None if read["joints"] in (moving, turns)
        else f"{read['joints']} that move, not {moving}",
        "colliders": f"{read['shapes']}, not {pieces}" if read["shapes"] < pieces else None,
    }  # fmt: skip
    gaps: dict[str, float] = {}
    for joint in spec.joints:
        names = (joint.child, body_name(spec, joint.child))
        at = next((p for n, p in read["links"].items() if n.replace("_", "-") in
                   {own.replace("_", "-") for own in names}), None)  # fmt: skip
        if at is not None and read.get("base") != "com":
            gaps[joint.child] = float(np.linalg.norm(np.array(at) - np.array(joint.pos)))
    if gaps:
        worst = max(gaps, key=lambda name: gaps[name])
        far = gaps[worst] > TOLERANCE_M
        result["places"] = f"{worst} {1e3 * gaps[worst]:.3g} mm beside its place" if far else None
    return result


def apart(moved: dict[str, Any], reference: dict[str, Any]) -> str | None:
    """Return the difference of a motion from MuJoCo's in words; None if within tolerance."""
    if "error" in moved:
        return moved["error"]
    if "q" in reference:
        q, meant = moved["q"], reference["q"]
        return None if abs(q - meant) <= PULLED * abs(meant) else f"{q:.4g}, not {meant:.4g}"
    ends, meant = (list(m["roots"].values()) for m in (moved, reference))
    return _parted(ends[0], meant[0]) if ends and meant else "it has no root"


def _parted(one: dict[str, Any], other: dict[str, Any]) -> str | None:
    gap = 1e3 * float(np.linalg.norm(np.array(one["pos"]) - other["pos"]))
    turn = degrees(_quotient(one["quat"], other["quat"]))
    near = gap <= REST_MM and turn <= REST_DEGREES
    return None if near else f"{gap:.1f} mm and {turn:.1f} degrees beside MuJoCo's"


def _quotient(one: list[float], other: list[float]) -> list[float]:
    a, u = one[0], np.array(one[1:])
    b, v = other[0], -np.array(other[1:])
    return [a * b - float(u @ v), *(a * v + b * u + np.cross(u, v)).tolist()]


def _compare_scene(
    program: Program, own: Results, specs: dict[str, ObjectSpec],
    scene: SceneSpec | None, expected: Results,
) -> Row:  # fmt: skip
    assert scene is not None
    read, faults = own["scene", "read"], []
    result: Row = dict.fromkeys(CHECKS, "")

    def note(check: str, fault: str | None) -> None:
        result[check] = "no" if fault else "yes"
        if fault:
            faults.append(f"{check}: {fault}")

    note("loads", read.get("error"))
    items = [(i, sum(inertial(i.spec, p).mass for p in i.spec.parts)) for i in scene.objects]
    # Static objects have no mass in USD.
    masses = [sum(m for i, m in items if not (still and i.static)) for still in (True, False)]
    moving = sum(j.type != "fixed" for i, _ in items for j in i.spec.joints)
    if "error" not in read:
        near = any(abs(read["mass"] - m) <= max(TOLERANCE_MASS * m, LEAST_KG) for m in masses)
        note("masses", None if near else f"{read['mass']:g} kg, not {masses[0]:g}")
        good = read["joints"] == moving
        note("joints", None if good else f"{read['joints']} that move, not {moving}")
    moved = own.get(("scene", "rest"))
    if moved is None:
        return {**result, "faults": faults}
    if "error" in moved:
        note("rest", moved["error"])
        return {**result, "faults": faults}
    at, words, far = world_poses(scene), [], []
    for item, _ in items:
        if item.static:
            continue
        one, other = moved["roots"].get(item.name), expected["scene"]["roots"][item.name]
        fault = "is missing" if one is None else _parted(one, other)
        words += [f"{item.name} {fault}"] if fault else []
        if one is not None:
            gap = float(np.linalg.norm(np.array(one["start"]) - at[item.name].pos))
            far += [f"{item.name} {1e3 * gap:.3g} mm beside its place"] * (gap > TOLERANCE_M)
    note("rest", "; ".join(words) or None)
    note("places", "; ".join(far) or None)
    return {**result, "faults": faults}


def _share(tally: tuple[int, int]) -> str:
    good, of = tally
    return f"{good}/{of}" if of else ""


def _label(row: Row) -> str:
    """Return a name of a row's file that is unique over objects and scenes."""
    both = row["file"] == "newton.usda" and not row["scene"]
    return f"`{row['file']}`{' of objects' if both else ''}"


def write_figure(path: Path, rows: list[Row]) -> None:
    """Write rows as the table of an existing figure of `benchmarks/figures`."""
    kept = yaml.safe_load(path.read_text(encoding="utf-8")) if path.exists() else {}
    kept["columns"] = ["", "file", *CHECKS]
    kept["rows"] = [
        [f"{row['reader']} {row['version']}".replace("_4 ", " "), _label(row),
         *(str(row[check]) or "-" for check in CHECKS)]
        for row in rows
    ]  # fmt: skip
    path.write_text(yaml.safe_dump(kept, sort_keys=False, allow_unicode=True), encoding="utf-8")
