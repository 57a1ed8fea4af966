"""Tasks of stacking and assembling whose condition has two parts."""

import math

from neoworld_mjx.environments.predicates import Every, Located
from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.spec.pose import Pose, from_yaw, pose
from neoworld_mjx.templates.template import Value

from ..engines.table_scenes import TOP
from .carrying_tasks import PLACED, carry, grasp_in, located
from .plan_format import TaskPlan
from .reference import grasp_box, pick_and_place
from .task import Prepared
from .task_scenes import grown, put, scene_of


def third_block(edge: float) -> Prepared:
    """Stack a third cube on two, all of which must stay."""
    sizes: dict[str, Value] = {"depth": edge, "width": edge, "height": edge, "form": "box"}
    first = put("toy_block", (0.12, 0.0), name="first", values=sizes | {"colour": "blue"})
    second = put("toy_block", on="first", z=edge, name="second", values=sizes | {"colour": "green"})
    third = put("toy_block", (-0.12, 0.1), name="third", yaw=-0.4, values=sizes | {"colour": "red"})
    scene = scene_of("third_block", first, second, third)
    target = (0.0, 0.0, edge)
    goal = Every(
        of=(
            located(scene, "third", "second", target),
            located(scene, "second", "first", target, touching=("first", "third")),
        )
    )
    return carry(scene, goal, "third", grasp_box(scene, "third"), "second", target)


def bridge(form: str, turn: float) -> Prepared:
    """Lay a beam across two blocks."""
    pier: dict[str, Value] = {"depth": 0.05, "width": 0.05, "height": 0.06, "colour": "blue"}
    beam: dict[str, Value] = {"depth": 0.2, "width": 0.04, "height": 0.02, "colour": "red"}
    if form == "cylinder":
        pier |= {"form": "cylinder"}
    x, y = 0.07 * math.cos(turn), 0.07 * math.sin(turn)
    scene = scene_of(
        "bridge",
        put("toy_block", (0.12 + x, 0.05 + y), name="pier_1", yaw=turn, values=pier),
        put("toy_block", (0.12 - x, 0.05 - y), name="pier_2", yaw=turn, values=pier),
        put("toy_block", (-0.15, -0.1), name="beam", yaw=0.4, values=beam),
    )
    on_table = located(scene, "beam", "table", (0.12, 0.05, 0.1), radius=0.01, touching=())
    on_piers = Located(
        object="beam",
        relative_to="pier_1",
        target=(-0.07, 0.0, 0.06),
        radius=0.015,
        low=-0.005,
        high=0.005,
        touching=("pier_1", "pier_2"),
        source=PLACED,
    )
    grasp = grasp_box(scene, "beam", depth=0.01)

    def condition(reconstructed: SceneSpec) -> Every:
        poses, at = world_poses(reconstructed), _across(scene, reconstructed).pos
        targets = (poses[name].inverse().apply(at).tolist() for name in ("table", "pier_1"))
        both = zip((on_table, on_piers), targets, strict=True)
        return Every(of=tuple(leaf.model_copy(update={"target": tuple(t)}) for leaf, t in both))

    def plan(reconstructed: SceneSpec) -> TaskPlan:
        held = grasp_in(scene, reconstructed, "beam", grasp)
        return pick_and_place(reconstructed, "beam", held, _across(scene, reconstructed))

    return Prepared(scene, Every(of=(on_table, on_piers)), plan, condition)


def _across(truth: SceneSpec, scene: SceneSpec) -> Pose:
    """Return the pose of the beam on the piers of `bridge`: at their center, along the line from 2
    to 1."""
    poses, piers = world_poses(scene), ("pier_1", "pier_2")
    top = max(0.06 * float(grown(truth, scene, name)[2]) for name in piers)
    first, second = (poses[name].pos for name in piers)
    middle = (first + second) / 2
    heading = math.atan2(first[1] - second[1], first[0] - second[0])
    return pose((middle[0], middle[1], poses["table"].pos[2] + TOP + top), from_yaw(heading))
