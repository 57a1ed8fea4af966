"""Rescues of disturbed scenes of meshes: validity, and errors of the objects' poses and sizes.

Scenes of meshes that stand are disturbed as a method without physics would leave them.
"""

import colorsys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from neoworld_mjx.config import Config, RefineOptions
from neoworld_mjx.evidence.evidence import Evidence, PhotoPixels
from neoworld_mjx.evidence.file_camera import FileCamera, known_camera
from neoworld_mjx.export.importing import ImportedScene, scene_of_assemblies
from neoworld_mjx.export.mesh_colors import Surface
from neoworld_mjx.export.read_mesh_scene import mesh_object
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.pipeline.place import RefinedPlacement, place, refine_placed
from neoworld_mjx.pipeline.rescue import as_given, posed_tree
from neoworld_mjx.render import render_scene
from neoworld_mjx.spec import Camera, SceneSpec, bounds, world_poses
from neoworld_mjx.spec.pose import angle_between

from ..rows import Row

TABLE_Z = 0.4
SINK_M, TILT_DEG, WRONG = 0.02, 5.0, 0.1


def carton(rng):
    """Return a box that stands on its bottom, with its origin there [m]."""
    size = rng.uniform([0.08, 0.06, 0.05], [0.16, 0.12, 0.16])
    return lifted(trimesh.creation.box(extents=size))


def can(rng):
    """Return a cylinder."""
    radius, height = rng.uniform(0.03, 0.045), rng.uniform(0.07, 0.12)
    return lifted(trimesh.creation.cylinder(radius=radius, height=height, sections=48))


def prism(rng):
    """Return a prism of six sides."""
    return lifted(
        trimesh.creation.cylinder(radius=0.05, height=rng.uniform(0.05, 0.12), sections=6)
    )


def bracket(rng):
    """Return an L that stands on its foot, which is no convex shape."""
    foot = trimesh.creation.box(extents=(0.16, 0.1, 0.03))
    wall = trimesh.creation.box(extents=(0.03, 0.1, 0.1))
    wall.apply_translation((-0.065, 0, 0.064))
    return lifted(trimesh.boolean.union([foot, wall], engine="manifold"))


def lifted(mesh):
    """Return a mesh with its lowest point at height 0."""
    mesh.apply_translation((0, 0, -mesh.bounds[0, 2]))
    return mesh


KINDS = {"carton": carton, "can": can, "prism": prism, "bracket": bracket}
PLACES = [(-0.2, -0.25), (-0.2, 0.0), (-0.2, 0.25), (0.12, -0.25), (0.12, 0.0), (0.12, 0.25)]


def standing(seed: int):
    """Return meshes and poses [4, 4] of a table with three to five objects, some with another."""
    rng = np.random.default_rng(seed)
    table = trimesh.creation.box(extents=(0.8, 1.0, 0.04))
    lifted(table)
    pose = np.eye(4)
    pose[:3, 3] = (0.9, 0.0, TABLE_Z - 0.04)
    objects = {"table": (table, pose)}
    count = int(rng.integers(3, 6))
    for k, at in enumerate(rng.permutation(PLACES)[:count]):
        kind = str(rng.choice(list(KINDS)))
        mesh = KINDS[kind](rng)
        position = np.array([0.9 + at[0], at[1], TABLE_Z]) + [*rng.uniform(-0.04, 0.04, 2), 0]
        objects[f"{kind}_{k}"] = mesh, upright(position, rng.uniform(-np.pi, np.pi))
        if kind == "carton" and rng.random() < 0.5:
            small = lifted(trimesh.creation.box(extents=0.5 * mesh.extents))
            top = position + [0, 0, mesh.extents[2]]
            objects[f"upper_{k}"] = small, upright(top, rng.uniform(-np.pi, np.pi))
    return objects


def upright(at, yaw: float) -> np.ndarray:
    """Return a pose at a place [3] with a heading."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_euler("z", yaw).as_matrix(), at
    return pose


def disturbed(objects, seed: int):
    """Return the objects with wrong sizes (10 %), 2 cm too low, and tilted about their middles."""
    rng = np.random.default_rng(seed + 1000)
    result = {}
    for name, (mesh, pose) in objects.items():
        if name == "table":
            result[name] = mesh, pose
            continue
        angle = rng.uniform(-np.pi, np.pi)
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted = pose.copy()
        turn = Rotation.from_rotvec(np.radians(TILT_DEG) * axis).as_matrix()
        middle = pose[:3, :3] @ mesh.bounds.mean(axis=0) + pose[:3, 3]
        tilted[:3, :3] = turn @ pose[:3, :3] * (1 + rng.uniform(-WRONG, WRONG))
        tilted[:3, 3] = middle - tilted[:3, :3] @ mesh.bounds.mean(axis=0) - [0, 0, SINK_M]
        result[name] = mesh, tilted
    return result


def scene_of_meshes(objects):
    """Return an imported scene of meshes at poses; none of them says that it is a support."""
    assemblies = [
        mesh_object(key, [Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))], pose)
        for key, (mesh, pose) in objects.items()
    ]
    return scene_of_assemblies(Path("scene"), assemblies)


NEAR_M, NEAR_DEG = 5e-3, 2.0
"""Distance and angle within which an object is where it stood."""
CAMERA = Camera(width=640, height_px=480, fovy=0.75, height=TABLE_Z + 0.55, pitch=0.6)
"""Camera of the photographs: it shows all of the table's objects."""
TABLE_RGB = (0.75, 0.7, 0.6)


class RescueRow(Row):
    """One object of a rescued scene."""

    scene: int
    """Seed of the scene."""
    object: str
    given_passed: bool
    """True if the scene as given passes the final check, its table fixed."""
    passed: bool
    """True if the rescued scene does."""
    position_mm: float
    """Horizontal distance of the origins of the rescued and the undisturbed object. Heights follow
    from the supports, which may have wrong sizes."""
    turn_deg: float
    given_size: float
    """Size over that of the undisturbed object, minus 1."""
    size: float
    """The same of the rescued object."""
    seconds: float
    """Time of the rescue of the whole scene."""

    @property
    def near(self) -> bool:
        """True if the object is where it stood."""
        return self.position_mm <= 1e3 * NEAR_M and self.turn_deg <= NEAR_DEG


def rescue_rows(seed: int, *, photo: bool = False) -> Iterator[RescueRow]:
    """Disturb a scene, rescue it, and compare its objects with those of the undisturbed one.

    Args:
        seed: of the scene.
        photo: True to give the rescue a rendered photograph of the undisturbed scene.
    """
    original = scene_of_meshes(standing(seed)).spec
    given = scene_of_meshes(disturbed(standing(seed), seed))
    picture = photograph_of(original) if photo else None
    began = time.perf_counter()
    rescued = rescued_scene(given, picture)
    seconds = time.perf_counter() - began
    fixed = tuple(
        item.model_copy(update={"environment": item.name == "table"}) for item in given.spec.objects
    )
    o = RefineOptions()
    given_measure = measured(given.spec.model_copy(update={"objects": fixed}), o)
    starts, ends = world_poses(original), world_poses(rescued.scene)
    for name in [item.name for item in rescued.scene.objects if not item.static]:
        start, end = starts[name], ends[name]
        yield RescueRow(
            scene=seed,
            object=name,
            given_passed=passes(given_measure, o),
            passed=rescued.refined.passed,
            position_mm=1e3 * float(np.linalg.norm((end.pos - start.pos)[:2])),
            turn_deg=float(np.degrees(angle_between(start.quat, end.quat))),
            given_size=_size(given.spec, name) / _size(original, name) - 1,
            size=_size(rescued.scene, name) / _size(original, name) - 1,
            seconds=seconds,
        )


def rescued_scene(given: ImportedScene, photo: PhotoPixels | None) -> RefinedPlacement:
    """Return the result of Steps 4 and 5 of a rescue, without a run folder."""
    known, _ = known_camera(camera_file(), (CAMERA.width, CAMERA.height_px), "CAMERA")
    tree = posed_tree(given, None if photo is None else known)
    c, evidence = as_given(Config(), photo=photo is not None), Evidence(photo, boxes=False)
    placed = place(tree.tree, tree.objects, evidence, c.compose)
    return refine_placed(placed.scene, c.refine, photo=evidence.photo, again=c.compose.align)


def photograph_of(scene: SceneSpec) -> PhotoPixels:
    """Render a scene with a plain color for each object through CAMERA, which is given exactly."""
    objects = []
    for k, item in enumerate(scene.objects):
        rgb = colorsys.hsv_to_rgb((0.37 * k) % 1, 0.6, 0.8) if item.name != "table" else TABLE_RGB
        materials = tuple(m.model_copy(update={"rgba": (*rgb, 1.0)}) for m in item.spec.materials)
        spec = item.spec.model_copy(update={"materials": materials})
        objects.append(item.model_copy(update={"spec": spec}))
    colored = scene.model_copy(update={"objects": tuple(objects), "camera": CAMERA})
    return render_scene(colored).color


def camera_file() -> FileCamera:
    """Return CAMERA as a file states it."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = CAMERA.axes(), CAMERA.position()
    return FileCamera.model_validate({"pose": matrix.tolist(), "fovy": CAMERA.fovy})


def rescue_figures(rows: Sequence[RescueRow]) -> dict[str, Any]:
    """Summarize rows: numbers of scenes that are valid and within bounds, medians, and times."""
    scenes: dict[int, list[RescueRow]] = {}
    for row in rows:
        scenes.setdefault(row.scene, []).append(row)
    median = lambda values: float(np.median(values)) if values else None
    return {
        "n": len(scenes),
        "objects": len(rows),
        "given_pass": sum(some[0].given_passed for some in scenes.values()),
        "pass": sum(some[0].passed for some in scenes.values()),
        "pass_and_within": sum(
            some[0].passed and all(row.near for row in some) for some in scenes.values()
        ),
        "position_mm": median([row.position_mm for row in rows]),
        "given_size_error": median([abs(row.given_size) for row in rows]),
        "size_error": median([abs(row.size) for row in rows]),
        "seconds": median([some[0].seconds for some in scenes.values()]),
    }


def _size(scene: SceneSpec, name: str) -> float:
    """Return the geometric mean of the edges of an object's box [m]."""
    return float(np.prod(np.subtract(*bounds(scene.object(name).spec)[::-1]))) ** (1 / 3)
