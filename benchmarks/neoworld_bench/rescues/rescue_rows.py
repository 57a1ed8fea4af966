"""Rescues of disturbed scenes: which are valid, and which objects are where they stood."""

import colorsys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from neoworld_mjx.align.outline_error import outline_errors
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.export.read_mesh_scene import FileCamera, viewpoint
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.pipeline.rescue import Photographed, Rescued, rescue
from neoworld_mjx.render import render_scene, visible_surface
from neoworld_mjx.spec import Camera, SceneSpec, bounds, world_poses
from neoworld_mjx.spec.pose import angle_between

from ..measures.pose_measure import RECALL, add_s, recall
from ..rows import Row
from .disturbed_scenes import TABLE_Z, disturbed, scene_of_meshes, standing

NEAR_M, NEAR_DEG = 5e-3, 2.0
"""Distance and angle within which an object is where it stood."""
POINTS = 2000
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
    on_table: bool
    """True if the rescued object stands on the table, not on another object."""
    position_mm: float
    """Distance of the origins of the rescued and the undisturbed object."""
    height_mm: float
    """Difference of their heights."""
    turn_deg: float
    given_size: float
    """Size over that of the undisturbed object, minus 1."""
    size: float
    """The same of the rescued object."""
    given_add_s: float
    """ADD-S of the given object over the diagonal of the undisturbed one's box."""
    add_s: float
    given_outline_px: float | None
    """Distance of the outline from the photograph's (`outline_errors`); None without one."""
    outline_px: float | None
    seconds: float
    """Time of the rescue of the whole scene."""

    @property
    def near(self) -> bool:
        """True if the object is where it stood, heights counted."""
        return self.position_mm <= 1e3 * NEAR_M and self.turn_deg <= NEAR_DEG

    @property
    def near_horizontally(self) -> bool:
        """The same, but for heights on objects of a wrong size."""
        if self.on_table:
            return self.near
        level = max(self.position_mm**2 - self.height_mm**2, 0.0) ** 0.5
        return level <= 1e3 * NEAR_M and self.turn_deg <= NEAR_DEG


def rescue_rows(seed: int, *, photo: bool = False) -> Iterator[RescueRow]:
    """Disturb a scene, rescue it, and compare its objects with those of the undisturbed one.

    Args:
        seed: of the scene.
        photo: True to give the rescue a rendered photograph of the undisturbed scene.
    """
    original = scene_of_meshes(standing(seed)).spec
    disturbed_scene = scene_of_meshes(disturbed(standing(seed), seed))
    picture = photograph_of(original) if photo else None
    began = time.perf_counter()
    rescued = rescue(disturbed_scene, photo=picture)
    seconds = time.perf_counter() - began
    # With a photograph the table's top is at z = 0.
    up = np.array([0.0, 0.0, TABLE_Z if photo else 0.0])
    fixed = tuple(
        item.model_copy(update={"environment": item.name == "table"})
        for item in disturbed_scene.spec.objects
    )
    o = RefineOptions()
    given_passed = passes(
        measured(disturbed_scene.spec.model_copy(update={"objects": fixed}), o), o
    )
    outlines: list[dict[str, float | None]] = [{}, {}]
    if picture is not None:
        outlines = [outline_errors(s, picture.rgb) for s in (rescued.given, rescued.scene)]
    for name in rescued.moves_m:
        yield RescueRow(
            scene=seed,
            object=name,
            given_passed=given_passed,
            passed=rescued.passed,
            **_compared(original, disturbed_scene.spec, rescued, name, up),
            given_outline_px=outlines[0].get(name),
            outline_px=outlines[1].get(name),
            seconds=seconds,
        )


def photograph_of(scene: SceneSpec) -> Photographed:
    """Render a scene with a plain color for each object through CAMERA, which is given exactly."""
    objects = []
    for k, item in enumerate(scene.objects):
        rgb = colorsys.hsv_to_rgb((0.37 * k) % 1, 0.6, 0.8) if item.name != "table" else TABLE_RGB
        materials = tuple(m.model_copy(update={"rgba": (*rgb, 1.0)}) for m in item.spec.materials)
        spec = item.spec.model_copy(update={"materials": materials})
        objects.append(item.model_copy(update={"spec": spec}))
    colored = scene.model_copy(update={"objects": tuple(objects), "camera": CAMERA})
    return Photographed(
        render_scene(colored).color, viewpoint(camera_file(), CAMERA.width, CAMERA.height_px)
    )


def camera_file() -> FileCamera:
    """Return CAMERA as a file states it."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = CAMERA.axes(), CAMERA.position()
    return FileCamera.model_validate({"pose": matrix.tolist(), "fovy": CAMERA.fovy})


def rescue_figures(rows: Sequence[RescueRow]) -> dict[str, Any]:
    """Summarize rows: scenes that are valid and within bounds, recalls, sizes and times."""
    scenes: dict[int, list[RescueRow]] = {}
    for row in rows:
        scenes.setdefault(row.scene, []).append(row)
    times = [scene_rows[0].seconds for scene_rows in scenes.values()]
    with_outlines = [r for r in rows if r.given_outline_px is not None and r.outline_px is not None]
    median = lambda values: float(np.median(values)) if values else None
    return {
        "scenes": len(scenes),
        "objects": len(rows),
        "given_pass": sum(scene_rows[0].given_passed for scene_rows in scenes.values()),
        "pass": sum(scene_rows[0].passed for scene_rows in scenes.values()),
        "pass_and_within": sum(
            scene_rows[0].passed and all(r.near for r in scene_rows)
            for scene_rows in scenes.values()
        ),
        "pass_and_within_but_for_heights": sum(
            scene_rows[0].passed and all(r.near_horizontally for r in scene_rows)
            for scene_rows in scenes.values()
        ),
        f"given_add_s_recall_{RECALL:g}d": recall([r.given_add_s for r in rows]),
        f"add_s_recall_{RECALL:g}d": recall([r.add_s for r in rows]),
        "given_add_s": median([r.given_add_s for r in rows]),
        "add_s": median([r.add_s for r in rows]),
        "position_mm": median([r.position_mm for r in rows]),
        "given_size_error": median([abs(r.given_size) for r in rows]),
        "size_error": median([abs(r.size) for r in rows]),
        "given_outline_px": median([r.given_outline_px for r in with_outlines]),
        "outline_px": median([r.outline_px for r in with_outlines]),
        "seconds": {"median": median(times), "largest": max(times, default=None)},
    }


def _compared(
    original: SceneSpec,
    disturbed_scene: SceneSpec,
    rescued: Rescued,
    name: str,
    up: Float[np.ndarray, "3"],
) -> dict[str, Any]:
    start, end = world_poses(original)[name], world_poses(rescued.scene)[name]
    shift = end.pos + up - start.pos
    turn = float(np.degrees(angle_between(start.quat, end.quat)))
    true = _points(original, name)
    diagonal = float(np.linalg.norm(np.ptp(true, axis=0)))
    return {
        "on_table": rescued.scene.object(name).parent in (None, "table"),
        "position_mm": 1e3 * float(np.linalg.norm(shift)),
        "height_mm": 1e3 * float(shift[2]),
        "turn_deg": turn,
        "given_size": _size(disturbed_scene, name) / _size(original, name) - 1,
        "size": _size(rescued.scene, name) / _size(original, name) - 1,
        "given_add_s": add_s(_points(disturbed_scene, name), true) / diagonal,
        "add_s": add_s(_points(rescued.scene, name) + up, true) / diagonal,
    }


def _points(scene: SceneSpec, name: str) -> Float[np.ndarray, "n 3"]:
    """Return samples of an object's surface in the world [m]."""
    item = scene.object(name)
    vertices, faces = visible_surface(item.spec)
    mesh = trimesh.Trimesh(world_poses(scene)[name].apply(vertices), faces, process=False)
    return trimesh.sample.sample_surface(mesh, POINTS, seed=0)[0]


def _size(scene: SceneSpec, name: str) -> float:
    """Return the geometric mean of the edges of an object's box [m]."""
    return float(np.prod(np.subtract(*bounds(scene.object(name).spec)[::-1]))) ** (1 / 3)
