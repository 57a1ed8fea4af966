"""Scenes of tasks: objects of programs, set down on a table or on each other."""

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from neoworld_mjx.compose.joint_friction import hold_joints
from neoworld_mjx.errors import SpecError, choices
from neoworld_mjx.program.sandbox import run
from neoworld_mjx.spec import ObjectSpec, Quat, SceneObject, SceneSpec, Vec3, bounds, world_poses
from neoworld_mjx.spec.pose import IDENTITY, Pose, from_yaw, pose, quat_mul
from neoworld_mjx.templates import read_template, templates
from neoworld_mjx.templates.template import Template, Value

from ..engines.table_scenes import TOP, table

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
    x, y, z = (np.array(point) * grown(truth, scene, name)).tolist()
    return x, y, z


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
