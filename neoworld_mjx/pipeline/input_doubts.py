"""Doubts about a scene of another method: its unit of length, and solids that enclose objects."""

import itertools
from dataclasses import replace

import numpy as np

from ..checks.static_checks import distance_outside
from ..errors import SpecError
from ..export.importing import ImportedScene
from ..spec import SceneObject, SceneSpec, bounds, link_poses, pieces, world_poses
from ..spec.scale import scale, scaled_state

USUAL_M = (0.004, 3.0)
"""Usual range of the median longest edge of the free objects of a scene [m]."""
UNITS = {"centimeters": 0.01, "millimeters": 0.001, "kilometers": 1000.0}
LIFT_M = 0.3
"""Least height by which an object in a solid would be lifted for the solid to be in doubt [m]."""


def scaled_scene(imported: ImportedScene, s: float) -> ImportedScene:
    """Return an imported scene with all lengths multiplied by `s`, including the camera's place.

    Raises:
        SpecError: `s` is not a positive finite number.
    """
    if not 0 < s < float("inf"):
        raise SpecError(f"--scale: got {s:g}, expected a positive number, such as 0.01")
    objects = [
        item.model_copy(
            update={
                "spec": scale(item.spec, s),
                "xy": (s * item.xy[0], s * item.xy[1]),
                "z": s * item.z,
                "joint_state": scaled_state(item.spec, item.joint_state, s),
            }
        )
        for item in imported.spec.objects
    ]
    camera = imported.camera
    if camera is not None and camera.pose is not None:
        pose = np.array(camera.pose)
        pose[:3, 3] *= s
        a, b, c, d = (tuple(row) for row in pose.tolist())
        camera = camera.model_copy(update={"pose": (a, b, c, d)})
    spec = imported.spec.model_copy(update={"objects": tuple(objects)})
    return replace(imported, spec=spec, camera=camera)


def doubt_unit(scene: SceneSpec, remedy: str = "") -> None:
    """Raise a SpecError if the sizes of the free objects suggest another unit than meters.

    Args:
        scene: the scene.
        remedy: what the user can do; by default, the flag --scale of rescues.
    """
    edges = {
        item.name: float(np.ptp(bounds(item.spec, item.joint_state), axis=0).max())
        for item in scene.objects
        if not item.static
    }
    median = float(np.median(list(edges.values()))) if edges else 1.0
    if USUAL_M[0] <= median <= USUAL_M[1]:
        return
    sizes = ", ".join(f"{name} {edge:.3g} m" for name, edge in list(edges.items())[:3])
    fitting = [u for u, s in UNITS.items() if USUAL_M[0] * 5 < median * s < USUAL_M[1]]
    unit = fitting[0] if fitting else ("millimeters" if median > 1 else "kilometers")
    if not remedy:
        remedy = f"If so, add --scale {UNITS[unit]:g}; if the sizes are right, add --scale 1"
    raise SpecError(f"{scene.name} has unusual sizes ({sizes}): is it in {unit}? {remedy}")


def doubt_solids(scene: SceneSpec) -> None:
    """Raise a SpecError if a collider contains free objects, such as a room that is one solid.

    Objects that are only sunk in their support are not in doubt.
    """
    poses = world_poses(scene)
    for outer in scene.objects:
        solids = [
            (piece, poses[outer.name].then(links[part.name]).then(local))
            for links in [link_poses(outer.spec, outer.joint_state)]
            for part in outer.spec.parts
            for _, piece, local in pieces(part)
        ]
        top = _world_box(outer, scene)[1][2]
        inside = {}
        for item in scene.objects:
            low, high = _world_box(item, scene)
            lift = float(top - low[2])
            if item is outer or item.static or lift < max(LIFT_M, float(high[2] - low[2])):
                continue
            corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
            if np.all(distance_outside(corners, solids) < 0):
                inside[item.name] = lift
        if inside:
            moves = ", ".join(f"{name} by {lift:.2g} m" for name, lift in inside.items())
            raise SpecError(
                f"scene {scene.name}: the collider of {outer.name} is solid and encloses objects, "
                f"which would be lifted onto it ({moves}): leave out {outer.name}, or export its "
                "floor and walls as separate objects"
            )


def _world_box(item: SceneObject, scene: SceneSpec) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest corner of an object's colliders in the world [m]."""
    pose = world_poses(scene)[item.name]
    low, high = bounds(item.spec, item.joint_state, tuple(pose.quat.tolist()))
    return pose.pos + low, pose.pos + high
