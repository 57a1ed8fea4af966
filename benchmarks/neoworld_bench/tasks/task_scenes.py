"""Scenes of tasks: objects of programs on a table or on each other, and their photographs.

Tasks are declared about the middle of a table; cameras stand above the world's origin and look
along +x. So the scene is turned and moved before its photograph is taken, and what was
reconstructed from there is moved back.
"""

import math
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neoworld_mjx.compose.resting_pose import hold_joints
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.program.building import run
from neoworld_mjx.spec import (
    Camera,
    ObjectSpec,
    Quat,
    SceneObject,
    SceneSpec,
    Vec3,
    bounds,
    world_poses,
)
from neoworld_mjx.spec.pose import IDENTITY, Pose, from_yaw, pose, quat_mul, triple
from neoworld_mjx.spec.scene import transformed_scene
from neoworld_mjx.templates import read_template, templates
from neoworld_mjx.templates.template import Template, Value

from ..engines.table_scenes import TOP, table
from ..fidelity.rendered_scenes import see, visible_shares

GAP = 1e-4
"""Clearance under what is set down [m], as composition leaves it."""


@cache
def task_programs() -> dict[str, Template]:
    """Read the programs of this package, by name; they are written as templates are."""
    folder = Path(str(resources.files("neoworld_bench.tasks").joinpath("programs")))
    return {path.stem: read_template(path) for path in sorted(folder.glob("*.py"))}


@cache
def _object(program: str, values: tuple[tuple[str, Value], ...]) -> ObjectSpec:
    every = {**templates(), **task_programs()}
    if program not in every:
        raise SpecError(f"program: {choices(program, every)}")
    built = run(every[program].program(dict(values)))
    if built.spec is None:
        raise SpecError(f"program {program}: {built.signals[0].message}")
    return built.spec


def put(
    program: str,
    xy: tuple[float, float] = (0.0, 0.0),
    *,
    name: str | None = None,
    on: str = "table",
    z: float | None = None,
    yaw: float = 0.0,
    tilt: Quat = IDENTITY,
    fixed: bool = False,
    state: dict[str, float] | None = None,
    link: str | None = None,
    values: Mapping[str, Value] | None = None,
) -> SceneObject:
    """Put an object of a program into a scene.

    As in composition, joints that gravity would move get the dry friction that holds them.

    Args:
        program: a template, or a program of this package.
        xy: in the frame of its parent [m].
        name: of the object; that of the program by default.
        on: its parent.
        z: height of its lowest point above the frame of its parent [m]; the table's top by
            default.
        yaw: heading there [rad].
        tilt: rotation before the heading, for what lies.
        fixed: whether it is fastened.
        state: joint values [rad or m].
        link: the part that carries it.
        values: parameters of the program.
    """
    spec = _object(program, tuple(sorted((values or {}).items())))
    low, _ = bounds(spec, state or {}, tilt)
    height = (TOP if z is None else z) - float(low[2]) + GAP
    name = name or program
    item = SceneObject(
        name=name,
        spec=spec.model_copy(update={"name": name}),
        parent=on,
        parent_link=link,
        relation="on",
        xy=xy,
        z=height,
        yaw=yaw,
        base_tilt=tilt,
        fixed_base=fixed,
        joint_state=state or {},
    )
    return hold_joints(item)[0]


def scene_of(name: str, *objects: SceneObject, size: float = 1.0) -> SceneSpec:
    """Put objects onto a table with edges of `size` [m]."""
    return SceneSpec(name=name, objects=(table(size, size), *objects))


def size_of(scene: SceneSpec, name: str) -> np.ndarray:
    """Return the edge lengths of an object's bounding box with all joints at 0 [3] m."""
    low, high = bounds(scene.object(name).spec)
    return high - low


def grown(truth: SceneSpec, scene: SceneSpec, name: str) -> np.ndarray:
    """Return an object's edge lengths in a scene over those in the ground truth [3]."""
    return size_of(scene, name) / size_of(truth, name)


def in_other(truth: SceneSpec, scene: SceneSpec, name: str, point: Vec3) -> Vec3:
    """Return a point of an object's frame at the same share of its box in another scene [m]."""
    return triple(np.array(point) * grown(truth, scene, name))


def goal_on(
    scene: SceneSpec,
    name: str,
    at: tuple[float, float, float],
    *,
    yaw: float = 0.0,
    tilt: Quat = IDENTITY,
) -> Pose:
    """Return a pose in the frame of an object, which may be the table, in the world.

    Args:
        scene: the scene.
        name: the object.
        at: in its frame [m].
        yaw: heading in it [rad].
        tilt: rotation before the heading.
    """
    return world_poses(scene)[name].then(pose(at, quat_mul(from_yaw(yaw), np.array(tilt))))


PITCH, FOVY = math.radians(28.0), math.radians(34.0)
"""View down, and vertical field of view, as most scenes of the benchmark have them [rad]."""
MARGIN = 1.1
"""Room about the sphere that holds all objects, which fills the picture's height otherwise."""
BESIDE_DEG = (0.0, 30.0, -30.0, 60.0, -60.0)
"""Views, counted from the front of objects, which is +x in a task's scene."""
LEAST_SHOWN = 0.5
"""Share of every object that a view should show: the first that does is taken."""


class TaskPhoto(NamedTuple):
    """A task's scene as it was photographed."""

    scene: SceneSpec
    """With its camera, visible boxes, depths and hidden flags."""
    scene_transform: Pose
    """Motion of the task's scene to its place before the camera."""

    def back(self, reconstructed: SceneSpec) -> SceneSpec:
        """Move a scene that was reconstructed from the photograph to where the task's scene is."""
        return transformed_scene(reconstructed, self.scene_transform.inverse())


def photographed_task(scene: SceneSpec) -> TaskPhoto:
    """Photograph a task's scene from the first of BESIDE_DEG that shows LEAST_SHOWN of everything.

    If none does, the view is taken in which the most hidden object shows most.

    Args:
        scene: of a task; objects without a parent stand upright.
    """
    best: tuple[float, SceneSpec, Pose] | None = None
    for beside in BESIDE_DEG:
        transform, camera = _view(scene, math.pi + math.radians(beside))
        moved_scene = transformed_scene(scene, transform).model_copy(update={"camera": camera})
        least_visible = min(
            share
            for name, share in visible_shares(moved_scene).items()
            if not moved_scene.object(name).environment
        )
        if best is None or least_visible > best[0]:
            best = least_visible, moved_scene, transform
        if least_visible >= LEAST_SHOWN:
            break
    assert best is not None
    return TaskPhoto(see(best[1], finer=2), best[2])


def _view(scene: SceneSpec, turn: float) -> tuple[Pose, Camera]:
    """Return what moves a scene before a camera after a turn [rad], and the camera."""
    points = _points(scene)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    distance = MARGIN * radius / math.sin(FOVY / 2)
    ahead = np.array([distance * math.cos(PITCH), 0.0, 0.0])
    rotation = pose((0.0, 0.0, 0.0), from_yaw(turn))
    transform = pose(ahead - rotation.apply(middle * [1.0, 1.0, 0.0]), rotation.quat)
    camera = Camera(
        width=640,
        height_px=480,
        fovy=FOVY,
        height=float(middle[2]) + distance * math.sin(PITCH),
        pitch=PITCH,
    )
    return transform, camera


def _points(scene: SceneSpec) -> Float[np.ndarray, "n 3"]:
    """Return points of the surfaces of everything but the environment, in the world [m]."""
    poses = world_poses(scene)
    return np.vstack(
        [
            poses[item.name].apply(at.apply(shape.surface()[0]))
            for item in scene.objects
            if not item.environment
            for shape, at in posed_shapes(item)
        ]
    )
