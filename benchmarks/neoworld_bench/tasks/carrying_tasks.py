"""Shared parts of the tasks that pick up an object and place it elsewhere."""

import math
from dataclasses import replace

import numpy as np

from neoworld_mjx.spec import Quat, SceneSpec, Vec3
from neoworld_mjx.spec.pose import IDENTITY

from .plan_format import TaskPlan
from .predicates import Located, Predicate
from .reference import Grasp, pick_and_place
from .task import Prepared
from .task_scenes import goal_on, grown, in_other, size_of

STILL = "at rest and let go: StackCube-v1 of ManiSkill"
PLACED = f"{STILL}; own radius and height, which are less than half the object"
INSERTED = (
    "through an opening and supported: Section 4.4 of the paper; within the hole's radius and at "
    "least 15 mm deep: PegInsertionSide-v1 of ManiSkill"
)
UPRIGHT = (0.0, math.radians(15.0))
HEIGHT_M = 0.01
"""Tolerance of the height of a placed object [m]."""


def placed(
    scene: SceneSpec,
    name: str,
    on: str,
    target: Vec3,
    *,
    radius: float | None = None,
    tilt: tuple[float, float] = UPRIGHT,
    touching: tuple[str, ...] | None = None,
    heading: float = math.pi,
    height: float = HEIGHT_M,
) -> Located:
    """Return the condition that an object's foot is at a point in another object's frame.

    The default radius is a quarter of its narrower edge.
    """
    if radius is None:
        radius = float(size_of(scene, name)[:2].min()) / 4
    return Located(
        object=name,
        relative_to=on,
        target=target,
        radius=radius,
        low=-height,
        high=height,
        tilt=tilt,
        heading=heading,
        touching=(on,) if touching is None else touching,
        source=PLACED,
    )


def inserted(
    name: str,
    into: str,
    opening: Vec3,
    radius: float,
    depth: float,
    *,
    deepest: float = 0.3,
    tilt: tuple[float, float] = UPRIGHT,
    heading: float = math.pi,
) -> Located:
    """Return the condition that an object's foot is at least `depth` [m] below an opening."""
    return Located(
        object=name,
        relative_to=into,
        target=opening,
        radius=radius,
        low=-deepest,
        high=-depth,
        tilt=tilt,
        heading=heading,
        touching=(into,),
        source=INSERTED,
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
