"""Differences of objects that were written in a format and read again."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from neoworld_mjx.export.formats import write_formats
from neoworld_mjx.export.importing import import_object
from neoworld_mjx.export.object_of_mechanism import Imported
from neoworld_mjx.names import Format
from neoworld_mjx.spec import (
    JointSpec,
    Material,
    ObjectSpec,
    inertial,
    link_poses,
    part_bounds,
    recentred,
)
from neoworld_mjx.spec.finish import finish
from neoworld_mjx.spec.pose import matrix

READERS: dict[Format, tuple[str, Callable[[Path], Imported]]] = {
    "mjcf": ("object.xml", import_object),
    "urdf": ("object.urdf", import_object),
}
BOUNDS: dict[str, float] = {
    "pose_m": 1e-5, "axis": 1e-5, "limits": 1e-5, "mass": 1e-5, "inertia": 1e-4, "dynamics": 1e-5,
    "mimic": 1e-5, "sites_m": 1e-5, "friction": 1e-4, "colour": 0.005, "shine": 1e-5,
}  # fmt: skip
"""Tolerances; those of masses, inertias and dynamics are relative."""
LOST: dict[Format, frozenset[str]] = {
    "mjcf": frozenset({"velocity"}),
    "urdf": frozenset({"stiffness", "armature", "friction", "shine", "effort", "velocity"}),
}
"""Fields of joints and materials that a format cannot store, as `neoworld export` reports, and
the limits of joints, which URDF requires where an object states none."""
DYNAMICS = ("damping", "friction", "stiffness", "armature", "effort", "velocity")


def round_trip(spec: ObjectSpec, kind: Format) -> dict[str, float]:
    """Write an object in a format, read it again, and return the largest differences."""
    file, read = READERS[kind]
    if kind == "urdf":  # A ball joint becomes three hinges.
        fixed = {"type": "fixed", "upper": 0.0}
        joints = [j.model_copy(update=fixed if j.type == "ball" else {}) for j in spec.joints]
        spec = spec.model_copy(update={"joints": tuple(joints)})
    with tempfile.TemporaryDirectory() as folder:
        write_formats(spec, Path(folder), [kind])
        return compare(recentred(spec), read(Path(folder) / file).spec, LOST[kind])


def compare(own: ObjectSpec, back: ObjectSpec, lost: frozenset[str]) -> dict[str, float]:
    """Return the largest differences between an object and its round trip.

    Places are relative to the root's centre of mass, as the middle of an object's box moves with
    the facets of its round shapes; `extent_m` is by how much colliders' bounds differ.
    """
    names = {part.name: part.name for part in own.parts} | {own.root: back.root}
    joints = {joint.name: joint for joint in back.joints}
    result = dict.fromkeys([*BOUNDS, "extent_m"], 0.0)

    def note(name: str, difference: float) -> None:
        result[name] = max(result[name], float(difference))

    root, other_root = (inertial(s, s.part(s.root)).pos for s in (own, back))
    shift = np.array(other_root) - np.array(root)
    for part in own.parts:
        twin = back.part(names[part.name])
        one, other = inertial(own, part), inertial(back, twin)
        note("mass", abs(one.mass - other.mass) / one.mass)
        tensors = [matrix(m.quat) @ np.diag(m.diagonal) @ matrix(m.quat).T for m in (one, other)]
        note("inertia", np.abs(tensors[0] - tensors[1]).max() / np.abs(tensors[0]).max())
        boxes = [np.array(part_bounds(s, p)) for s, p in ((own, part), (back, twin))]
        note("extent_m", np.abs(boxes[0] + shift - boxes[1]).max())
        for name, pick in (("friction", "collision"), ("colour", "visual"), ("shine", "visual")):
            if name in lost:
                continue
            looks = [_materials(s, p, pick, name) for s, p in ((own, part), (back, twin))]
            note(name, _apart(*looks))
    for joint in own.joints:
        if joint.type != "fixed":
            _compare_joint(own, back, joint, joints[joint.name], lost, note)
    rng = np.random.default_rng(0)
    moving = [j for j in own.joints if j.mimic is None and j.type != "fixed"]
    for _ in range(3):
        state = {k: v for j in moving for k, v in _values(j, rng).items()}
        moved, other_moved = link_poses(own, state), link_poses(back, state)
        for part in own.parts:
            # Three points also determine the rotation.
            for point in np.array(inertial(own, part).pos) + [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]:
                at = moved[part.name].apply(point)
                read = other_moved[names[part.name]].apply(point + shift)
                note("pose_m", np.abs(at + shift - read).max())
    sites = {site.name: site for site in back.sites}
    for site in own.sites:
        twin_site = sites[site.name]
        away = np.array(site.pos) + shift - twin_site.pos
        note("sites_m", np.abs(away).max() if twin_site.part == names[site.part] else np.inf)
    return result


def _compare_joint(
    own: ObjectSpec,
    back: ObjectSpec,
    joint: JointSpec,
    read: JointSpec,
    lost: frozenset[str],
    note: Callable[[str, float], None],
) -> None:
    if read.type != joint.type:
        note("limits", np.inf)
        return
    if joint.type != "ball":
        note("axis", np.abs(np.array(joint.axis) - read.axis).max())
    note("limits", max(abs(joint.lower - read.lower), abs(joint.upper - read.upper)))
    for name in DYNAMICS:
        one, other = getattr(joint, name), getattr(read, name)
        if name in lost:
            continue
        if (one is None) != (other is None):
            note("dynamics", np.inf)
        elif one or other:
            note("dynamics", abs(one - other) / max(abs(one), abs(other)))
    if (joint.mimic is None) != (read.mimic is None):
        note("mimic", np.inf)
    elif joint.mimic is not None and read.mimic is not None:
        note("mimic", 0.0 if joint.mimic.joint == read.mimic.joint else np.inf)
        note("mimic", abs(joint.mimic.multiplier - read.mimic.multiplier))
        note("mimic", abs(joint.mimic.offset - read.mimic.offset))


def _values(joint: JointSpec, rng: np.random.Generator) -> dict[str, float]:
    if joint.type == "ball":
        return {f"{joint.name}.{axis}": rng.uniform(-0.5, 0.5) for axis in "xyz"}
    low, high = (joint.lower, joint.upper) if joint.lower < joint.upper else (-1.0, 1.0)
    return {joint.name: rng.uniform(low, high)}


def _materials(spec: ObjectSpec, part: Any, role: str, what: str) -> list[list[float]]:
    """Return the unique frictions, colors, or metallic and roughness values of a part."""
    chosen = [spec.material(geom.material) for geom in part.geoms if geom.role in (role, "both")]
    kinds: dict[str, Callable[[Material], list[float]]] = {
        "friction": lambda m: [m.friction],
        "colour": lambda m: list(m.rgba),
        "shine": lambda m: list(finish(m)[:2]),
    }
    values = [kinds[what](m) for m in chosen]
    return sorted({tuple(v): v for v in values}.values())


def _apart(one: list[list[float]], other: list[list[float]]) -> float:
    """Return the largest distance of a value of either list from the nearest of the other."""
    if not one or not other:
        return 0.0 if one == other else np.inf
    gaps = np.abs(np.array(one)[:, None] - np.array(other)[None]).max(axis=2)
    return float(max(gaps.min(axis=0).max(), gaps.min(axis=1).max()))
