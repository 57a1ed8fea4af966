"""Stacking tasks.

Assembling tasks: parts are joined so that one holds the other.
"""

import math

from neoworld_mjx.spec import SceneSpec, world_poses
from neoworld_mjx.spec.pose import Pose, from_yaw, pose
from neoworld_mjx.templates.template import Value

from ..engines.table_scenes import TOP
from .carrying_tasks import INSERTED, PLACED, UPRIGHT, carry, grasp_in, placed
from .plan_format import TaskPlan
from .predicates import Every, Located
from .reference import Grasp, grasp_box, pick_and_place
from .task import Prepared
from .task_scenes import grown, put, scene_of


def block_on(
    lower: tuple[float, float, float, str],
    upper: tuple[float, float, float, str],
    *,
    yaw: float = 0.0,
    turn: float = 0.0,
    along: str | None = None,
) -> Prepared:
    """Stack a block on another; each is given by its edges [m] and its form."""
    scene = scene_of(
        "block_on_block",
        put("toy_block", (0.15, 0.05), name="lower", yaw=yaw, values=_sizes(lower, "blue")),
        put("toy_block", (-0.12, -0.1), name="upper", yaw=0.3, values=_sizes(upper, "red")),
        put("peg", (0.0, 0.22), values={"form": "square"}),
    )
    target = (0.0, 0.0, lower[2])
    goal = placed(scene, "upper", "lower", target)
    grasp = grasp_box(scene, "upper", depth=min(0.02, upper[2] / 2), along=along)
    return carry(scene, goal, "upper", grasp, "lower", target, yaw=turn)


def third_block(edge: float) -> Prepared:
    """Stack a third cube on two, all of which must stay."""
    sizes = (edge, edge, edge, "box")
    first = put("toy_block", (0.12, 0.0), name="first", values=_sizes(sizes, "blue"))
    second = put("toy_block", on="first", z=edge, name="second", values=_sizes(sizes, "green"))
    third = put("toy_block", (-0.12, 0.1), name="third", yaw=-0.4, values=_sizes(sizes, "red"))
    scene = scene_of("third_block", first, second, third)
    target = (0.0, 0.0, edge)
    goal = Every(
        of=(
            placed(scene, "third", "second", target),
            placed(scene, "second", "first", target, touching=("first", "third")),
        )
    )
    return carry(scene, goal, "third", grasp_box(scene, "third"), "second", target)


def tray_on_tray() -> Prepared:
    """Stack an open tray, gripped by its wall, on another."""
    sizes: dict[str, Value] = {"depth": 0.12, "width": 0.16, "height": 0.05}
    scene = scene_of(
        "tray_on_tray",
        put("tray", (0.15, 0.05), name="lower", values=sizes),
        put("tray", (-0.15, -0.05), name="upper", values={**sizes, "finish": "walnut"}),
    )
    target = (0.0, 0.0, 0.05)
    goal = placed(scene, "upper", "lower", target, radius=0.02)
    grasp = Grasp((0.0, 0.077, 0.038), 0.006)
    return carry(scene, goal, "upper", grasp, "lower", target)


def ring_on_ring() -> Prepared:
    """Stack a disc on a disc of the same size."""
    values: dict[str, Value] = {"depth": 0.07, "width": 0.07, "height": 0.025, "bore": 0.02}
    scene = scene_of(
        "ring_on_ring",
        put("ring", (0.12, 0.1), name="lower", values=values),
        put("ring", (-0.12, 0.0), name="upper", values=values | {"colour": "red"}),
    )
    target = (0.0, 0.0, 0.025)
    goal = placed(scene, "upper", "lower", target)
    grasp = grasp_box(scene, "upper", depth=0.012)
    return carry(scene, goal, "upper", grasp, "lower", target)


def bottle_on_block() -> Prepared:
    """Stand a bottle on a narrow block."""
    scene = scene_of(
        "bottle_on_block",
        put("toy_block", (0.15, 0.0), values={"depth": 0.06, "width": 0.06, "colour": "wood"}),
        put("bottle_plain", (-0.15, 0.1), values={"height": 0.18, "colour": "brown"}),
    )
    target = (0.0, 0.0, 0.05)
    goal = placed(scene, "bottle_plain", "toy_block", target)
    grasp = Grasp((0.0, 0.0, 0.165), 0.024)
    return carry(scene, goal, "bottle_plain", grasp, "toy_block", target, clear=0.15)


def _sizes(block: tuple[float, float, float, str], colour: str) -> dict[str, Value]:
    depth, width, height, form = block
    return {"depth": depth, "width": width, "height": height, "form": form, "colour": colour}


def lid_on_jar(stuff: str, across: float, tall: float, at: tuple[float, float]) -> Prepared:
    """Put a lid, gripped by its knob, on its jar."""
    jar: dict[str, Value] = {"stuff": stuff, "depth": across, "width": across, "height": tall}
    inner = across - 0.01
    lid: dict[str, Value] = {"stuff": stuff, "depth": across + 0.004, "width": across + 0.004}
    lid |= {"plug": inner - 0.006}
    scene = scene_of(
        "lid_on_jar",
        put("jar", at, values=jar),
        put("jar_lid", (-0.15, -0.05), values=lid),
    )
    # The plate rests on the rim, so the foot is a plug's length below it.
    target = (0.0, 0.0, tall - 0.0095)
    goal = placed(scene, "jar_lid", "jar", target, radius=0.006, height=0.003)
    grasp = Grasp((0.0, 0.0, 0.03), 0.022)
    return carry(scene, goal, "jar_lid", grasp, "jar", target)


def ring_on_post(
    bore: float, rod: float, *, rings: int = 1, colour: str = "green", tall: float = 0.12
) -> Prepared:
    """Put a ring over a post, on top of other rings."""
    size: dict[str, Value] = {"bore": bore, "height": 0.02, "depth": 0.08, "width": 0.08}
    others = [put("post", (0.14, 0.05), values={"rod": rod, "height": tall})]
    for k in range(rings - 1):
        on, z = (f"ring_{k}", 0.02) if k else ("post", 0.015)
        others.append(put("ring", name=f"ring_{k + 1}", on=on, z=z, values=size))
    ring = put("ring", (-0.12, -0.1), name="ring", yaw=0.2, values=size | {"colour": colour})
    scene = scene_of("ring_on_post", *others, ring)
    height = 0.015 + 0.02 * (rings - 1)
    below = "post" if rings == 1 else f"ring_{rings - 1}"
    goal = Located(
        object="ring",
        relative_to="post",
        target=(0.0, 0.0, height),
        radius=(bore - rod) / 2 + 0.003,
        low=-0.006,
        high=0.006,
        tilt=UPRIGHT,
        touching=(below,),
        source=INSERTED,
    )
    # The ring's wall is held, beside the post.
    wall = (0.08 - bore) / 2
    grasp = Grasp((0.0, (0.08 - wall) / 2, 0.012), wall)
    over = max(0.05, tall - height + 0.01)
    return carry(
        scene, goal, "ring", grasp, "post", (0.0, 0.0, height + 0.001), hover=over, clear=0.15
    )


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
    on_table = placed(scene, "beam", "table", (0.12, 0.05, 0.1), radius=0.01, touching=())
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


def roof_on_house() -> Prepared:
    """Put a wedge as a roof on two walls and a ceiling."""
    wall: dict[str, Value] = {"depth": 0.1, "width": 0.08, "height": 0.06, "form": "arch"}
    roof: dict[str, Value] = {"depth": 0.11, "width": 0.08, "height": 0.05, "form": "wedge"}
    scene = scene_of(
        "roof_on_house",
        put("toy_block", (0.13, 0.0), name="house", yaw=0.3, values=wall | {"colour": "yellow"}),
        put("toy_block", (-0.13, 0.1), name="roof", values=roof),
    )
    target = (0.0, 0.0, 0.06)
    goal = placed(
        scene, "roof", "house", target, radius=0.015, heading=math.radians(10), height=0.005
    )
    grasp = Grasp((0.0, 0.0, 0.02), 0.08)
    return carry(scene, goal, "roof", grasp, "house", target)


def nut_on_bolt() -> Prepared:
    """Put a steel washer over a short pin."""
    washer: dict[str, Value] = {"bore": 0.016, "depth": 0.05, "width": 0.05, "height": 0.012}
    scene = scene_of(
        "washer_on_pin",
        put("post", (0.12, -0.05), values={"rod": 0.01, "height": 0.06, "foot": "steel"}),
        put("ring", (-0.12, 0.05), values=washer | {"colour": "steel"}),
    )
    goal = Located(
        object="ring",
        relative_to="post",
        target=(0.0, 0.0, 0.015),
        radius=0.006,
        low=-0.004,
        high=0.004,
        tilt=UPRIGHT,
        touching=("post",),
        source=INSERTED,
    )
    grasp = Grasp((0.0, 0.0, 0.006), 0.05)
    return carry(scene, goal, "ring", grasp, "post", (0.0, 0.0, 0.0155), hover=0.07, clear=0.1)
