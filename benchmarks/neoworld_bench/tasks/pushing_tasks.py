"""Pushing tasks: closed fingers move along a line, as in the paper."""

import math

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.predicates import Every, Leaning, Located, Predicate
from neoworld_mjx.spec import SceneObject, SceneSpec, world_poses
from neoworld_mjx.spec.pose import Pose, conjugate, rotate
from neoworld_mjx.templates.template import Value

from .carrying_tasks import PLACED
from .plan_format import TaskPlan
from .reference import push
from .task import Prepared
from .task_scenes import GAP, grown, put, scene_of

TOPPLED = (math.radians(45.0), math.pi)
TOPPLED_SOURCE = "own bound: past 45 deg nothing of these sizes comes back upright"
PUSHED_SOURCE = (
    "as PushCube-v1 of ManiSkill: within a goal region, which is tighter here, and at rest"
)


def dominoes(count: int, gap: float, bend: float, values: dict[str, Value]) -> Prepared:
    """Topple a row of dominoes by pushing the first.

    Args:
        count: how many.
        gap: from one to the next [m].
        bend: heading of the next against that of the one before [rad].
        values: parameters of a domino.
    """
    tall, thick = float(values.get("height", 0.08)), float(values.get("depth", 0.012))
    heading, at = -bend * (count - 1) / 2, np.array([-0.2, 0.0])
    row: list[SceneObject] = []
    colours = ("red", "ivory", "blue", "ivory", "green")
    for k in range(count):
        colour: dict[str, Value] = {"colour": colours[k % len(colours)]}
        spot = (float(at[0]), float(at[1]))
        row.append(put("domino", spot, name=f"domino_{k + 1}", yaw=heading, values=colour | values))
        heading += bend / 2
        at = at + gap * np.array([math.cos(heading), math.sin(heading)])
        heading += bend / 2
    scene = scene_of(f"dominoes_{count}", *row, size=1.4)
    goal = Every(
        of=tuple(Leaning(object=item.name, tilt=TOPPLED, source=TOPPLED_SOURCE) for item in row)
    )

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        first, edges = _foot(reconstructed, "domino_1"), grown(scene, reconstructed, "domino_1")
        deep, high = thick * float(edges[0]), tall * float(edges[2])
        way = _level(rotate(first.quat, (1.0, 0.0, 0.0)))
        # 3 mm before its face, near its top, and 6 mm farther than it takes to tip it over.
        start = first.pos - way * (deep / 2 + 0.011) + np.array([0.0, 0.0, high - 0.01])
        far = 0.003 + deep * (high - 0.01) / high + 0.006
        return push(start, way * far, speed=0.05)

    return Prepared(scene, goal, plan)


def tip(program: str, tall: float, half: float, foot: float, values: dict[str, Value]) -> Prepared:
    """Topple a tall object by pushing it near its top.

    Args:
        program: what.
        tall: its height [m].
        half: half its thickness there [m].
        foot: its thickness at the foot [m].
        values: parameters.
    """
    scene = scene_of(
        f"tip_{program}",
        put(program, (0.0, 0.0), yaw=math.pi / 2 if program == "book" else 0.0, values=values),
        put("toy_block", (-0.1, 0.2), values={"colour": "green"}),
    )
    goal = Leaning(object=program, tilt=TOPPLED, source=TOPPLED_SOURCE)
    # The push goes along +x of the table.
    along = np.round(rotate(conjugate(world_poses(scene)[program].quat), (1.0, 0.0, 0.0)), 9)

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        foot_pose, edges = _foot(reconstructed, program), grown(scene, reconstructed, program)
        across, high = float(np.abs(along) @ edges), tall * float(edges[2])
        way = _level(rotate(foot_pose.quat, along))
        start = foot_pose.pos - way * (half * across + 0.012) + np.array([0.0, 0.0, high - 0.012])
        far = 0.005 + foot * across * (high - 0.012) / high + 0.01
        return push(start, way * far, speed=0.05)

    return Prepared(scene, goal, plan)


def slide(
    program: str, half: float, way: tuple[float, float], values: dict[str, Value], height: float
) -> Prepared:
    """Push an object across the table to a mark."""
    length = math.hypot(*way)
    heading = math.atan2(way[1], way[0])
    forward = np.array([way[0], way[1]]) / length
    mark: dict[str, Value] = {"depth": 0.02, "width": 0.02, "height": 0.01, "colour": "yellow"}
    side = np.array([-forward[1], forward[0]]) * 0.12
    ends = np.array(way)
    scene = scene_of(
        f"slide_{program}",
        put(program, (0.0, 0.0), yaw=heading, values=values),
        put(
            "toy_block",
            (float(ends[0] + side[0]), float(ends[1] + side[1])),
            name="mark",
            values=mark,
        ),
        put(
            "toy_block",
            (float(ends[0] - side[0]), float(ends[1] - side[1])),
            name="mark_2",
            values=mark,
        ),
    )
    goal = Located(
        object=program,
        relative_to="table",
        target=(way[0], way[1], 0.04),
        radius=0.02,
        low=-0.01,
        high=0.01,
        tilt=(0.0, math.radians(15)),
        touching=("table",),
        released=False,
        source=PUSHED_SOURCE,
    )

    def between(reconstructed: SceneSpec) -> NDArray:
        poses = world_poses(reconstructed)
        return (poses["mark"].pos + poses["mark_2"].pos) / 2

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        foot_pose, edges = _foot(reconstructed, program), grown(scene, reconstructed, program)
        offset = (between(reconstructed) - foot_pose.pos) * [1.0, 1.0, 0.0]
        way = _level(offset)
        start = foot_pose.pos - way * (half * float(edges[0]) + 0.012)
        start = start + np.array([0.0, 0.0, height * float(edges[2])])
        far = float(np.linalg.norm(offset)) + 0.003
        return push(start, way * far, speed=0.08, retreat=0.1)

    def condition(reconstructed: SceneSpec) -> Predicate:
        x, y, _ = (
            world_poses(reconstructed)["table"].inverse().apply(between(reconstructed)).tolist()
        )
        return goal.model_copy(update={"target": (x, y, goal.target[2])})

    return Prepared(scene, goal, plan, condition)


def off_the_edge() -> Prepared:
    """Push a cube from a block into a tray below it."""
    scene = scene_of(
        "off_the_edge",
        put(
            "toy_block",
            (0.0, 0.0),
            name="shelf",
            values={"depth": 0.1, "width": 0.1, "height": 0.08, "colour": "wood"},
        ),
        put("tray", (0.16, 0.0), values={"depth": 0.2, "width": 0.2}),
        put(
            "toy_block",
            (0.0, 0.0),
            name="cube",
            on="shelf",
            z=0.08,
            values={"depth": 0.04, "width": 0.04, "height": 0.04},
        ),
    )
    goal = Located(
        object="cube",
        point=(0.0, 0.0, 0.02),
        relative_to="tray",
        target=(0.0, 0.0, 0.026),
        radius=0.1,
        low=-0.01,
        high=0.02,
        touching=("tray",),
        source=PLACED,
    )

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        foot_pose, edges = _foot(reconstructed, "cube"), grown(scene, reconstructed, "cube")
        way = _level(world_poses(reconstructed)["tray"].pos - foot_pose.pos)
        # The shelf's own clearance lies below the cube, too.
        middle = 0.02 * float(edges[2]) - GAP
        start = (
            foot_pose.pos - way * (0.02 * float(edges[0]) + 0.012) + np.array([0.0, 0.0, middle])
        )
        return push(start, way * 0.075, speed=0.1, retreat=0.1)

    return Prepared(scene, goal, plan)


def ball_into_goal(angle: float) -> Prepared:
    """Strike a ball so that it rolls into a gate."""
    forward = np.array([math.cos(angle), math.sin(angle), 0.0])
    end = forward[:2] * 0.25
    gate: dict[str, Value] = {"depth": 0.04, "width": 0.4, "height": 0.16, "form": "arch"}
    wall: dict[str, Value] = {"depth": 0.03, "width": 0.2, "height": 0.05, "colour": "blue"}
    behind = forward[:2] * 0.36
    scene = scene_of(
        "ball_into_goal",
        put(
            "toy_block",
            (float(end[0]), float(end[1])),
            name="gate",
            yaw=angle,
            fixed=True,
            values=gate,
        ),
        put(
            "toy_block",
            (float(behind[0]), float(behind[1])),
            name="wall",
            yaw=angle,
            fixed=True,
            values=wall,
        ),
        put("ball", (0.0, 0.0), values={"depth": 0.07, "width": 0.07, "height": 0.07}),
    )
    goal: Predicate = Located(
        object="ball",
        point=(0.0, 0.0, 0.035),
        relative_to="gate",
        target=(0.06, 0.0, 0.0),
        radius=0.05,
        low=0.0,
        high=0.05,
        released=False,
        source=PUSHED_SOURCE,
    )

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        foot_pose, radius = (
            _foot(reconstructed, "ball"),
            0.035 * float(grown(scene, reconstructed, "ball")[2]),
        )
        offset = (world_poses(reconstructed)["gate"].pos - foot_pose.pos) * [1.0, 1.0, 0.0]
        way = _level(offset)
        # The fingers lie flat and are open, so that the ball rests against both.
        start = foot_pose.pos - way * (radius + 0.01) + np.array([0.0, 0.0, radius])
        aim = (float(way[0]), float(way[1]), 0.0)
        side = (-aim[1], aim[0], 0.0)
        far = float(np.linalg.norm(offset)) + 0.06
        return push(start, way * far, approach=aim, closing=side, opening=0.04, speed=0.1)

    return Prepared(scene, goal, plan)


def _foot(scene: SceneSpec, name: str) -> Pose:
    """Return an object's pose without its clearance over the support."""
    at = world_poses(scene)[name]
    return Pose(at.pos - np.array([0.0, 0.0, GAP]), at.quat)


def _level(direction: NDArray) -> NDArray:
    """Return the horizontal unit vector along a direction [3].

    Raises:
        ValueError: it is vertical, or zero.
    """
    flat = np.array([direction[0], direction[1], 0.0])
    length = float(np.linalg.norm(flat))
    if length < 1e-6:
        raise ValueError("there is no horizontal direction to push along")
    return flat / length
