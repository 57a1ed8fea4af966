"""Tasks that pick up an object and place it elsewhere, from their declarations in tasks.yaml."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from neoworld_mjx.environments.predicates import Located, Predicate
from neoworld_mjx.spec import Quat, SceneSpec, Vec3
from neoworld_mjx.spec.pose import IDENTITY

from .plan_format import TaskPlan
from .reference import Grasp, grasp_box, pick_and_place
from .task import Prepared
from .task_scenes import goal_on, grown, in_other, put, scene_of, size_of

STILL = "at rest and let go: StackCube-v1 of ManiSkill"
PLACED = f"{STILL}; own radius and height, which are less than half the object"
INSERTED = (
    "through an opening and supported: Section 4.4 of the paper; within the hole's radius and at "
    "least 15 mm deep: PegInsertionSide-v1 of ManiSkill"
)
UPRIGHT_DEG = (0.0, 15.0)
HEIGHT_M = 0.01
"""Tolerance of the height of a placed object [m]."""
DEEPEST_M = 0.3
"""Greatest depth of an inserted object below its opening [m]."""


def carrying(name: str, row: Mapping[str, Any]) -> Prepared:
    """Return a task that carries an object to a place.

    Args:
        name: name of the task.
        row: the declaration. "objects": arguments of `put`, with "parent" for `on`; "size": edge of
            the table [m]; "object": the one that is carried; "goal": arguments of `located`;
            "grasp": fields of `Grasp`, or arguments of `grasp_box`; "carry": arguments of `carry`.
    """
    objects = []
    for item in row["objects"]:
        fields = {"on" if key == "parent" else key: value for key, value in item.items()}
        objects.append(put(**fields))
    scene = scene_of(row.get("scene", name), *objects, size=row.get("size", 1.0))
    moved, way, held = row["object"], row["carry"], row["grasp"]
    goal = located(scene, moved, **{"relative_to": way["to"], **row["goal"]})
    grasp = Grasp(**held) if "point" in held else grasp_box(scene, moved, **held)
    return carry(scene, goal, moved, grasp, **way)


def located(
    scene: SceneSpec,
    name: str,
    relative_to: str,
    target: Vec3,
    *,
    radius: float | None = None,
    height: float = HEIGHT_M,
    depth: float | None = None,
    tilt_deg: tuple[float, float] = UPRIGHT_DEG,
    heading_deg: float = 180.0,
    touching: tuple[str, ...] | None = None,
    through: bool = False,
) -> Located:
    """Return the condition that an object's foot is at a point in another object's frame.

    Args:
        scene: the scene.
        name: the object.
        relative_to: the other object.
        target: the point [m]; with a depth, the opening.
        radius: tolerance across; by default, a quarter of the object's narrower edge [m].
        height: tolerance of the height [m].
        depth: least depth of the foot below the opening [m]; None if nothing is inserted.
        tilt_deg: bounds of the tilt.
        heading_deg: largest turn.
        touching: objects that it touches; by default, the other object.
        through: True if the object goes through an opening, or the other object through it.
    """
    if radius is None:
        radius = float(size_of(scene, name)[:2].min()) / 4
    low, high = (-height, height) if depth is None else (-DEEPEST_M, -depth)
    return Located(
        object=name,
        relative_to=relative_to,
        target=target,
        radius=radius,
        low=low,
        high=high,
        tilt=(math.radians(tilt_deg[0]), math.radians(tilt_deg[1])),
        heading=math.radians(heading_deg),
        touching=(relative_to,) if touching is None else touching,
        source=PLACED if depth is None and not through else INSERTED,
    )


def carry(
    scene: SceneSpec,
    predicate: Predicate,
    moved: str,
    grasp: Grasp,
    to: str,
    at: Vec3,
    *,
    yaw: float = 0.0,
    tilt: Quat = IDENTITY,
    **ways: float,
) -> Prepared:
    """Return a task that carries an object to a pose in another's frame; `ways` go to
    pick_and_place."""

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        goal = goal_on(
            reconstructed, to, in_other(scene, reconstructed, to, at), yaw=yaw, tilt=tilt
        )
        return pick_and_place(
            reconstructed, moved, grasp_in(scene, reconstructed, moved, grasp), goal, **ways
        )

    return Prepared(scene, predicate, plan)


def grasp_in(truth: SceneSpec, scene: SceneSpec, name: str, grasp: Grasp) -> Grasp:
    """Return a grasp in another scene, at the same share of the object's box."""
    across = float(np.abs(grasp.closing) @ grown(truth, scene, name))
    point = in_other(truth, scene, name, grasp.point)
    return replace(grasp, point=point, width=grasp.width * across)
