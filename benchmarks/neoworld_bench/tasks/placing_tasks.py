"""Placement tasks: an object is carried onto or into another and released."""

import math

import numpy as np

from neoworld_mjx.spec import Quat
from neoworld_mjx.spec.pose import from_axis_angle
from neoworld_mjx.templates.template import Value

from .carrying_tasks import carry, placed
from .reference import Grasp, grasp_box
from .task import Prepared
from .task_scenes import put, scene_of, size_of

LYING: Quat = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Rotation that turns the object's z axis to +x."""
NO_TILT = (0.0, math.pi)


def by_the_rim(width: float, height: float, wall: float) -> Grasp:
    """Return a grasp of the wall of a round cup from above, at its +x side."""
    return Grasp(
        ((width - wall) / 2, 0.0, height - 0.012), wall, closing=(1.0, 0.0, 0.0), slack=0.006
    )


def cup_on(plate: str, colour: str, *, across: float, at: tuple[float, float]) -> Prepared:
    """Put a cup, gripped by its rim, on a plate or a coaster."""
    tall = 0.02 if across > 0.12 else 0.008
    scene = scene_of(
        f"cup_on_{plate}",
        put("saucer", at, values={"depth": across, "width": across, "height": tall}),
        put("mug", (-0.12, -0.1), yaw=0.4, values={"colour": colour}),
        put("book", (0.3, -0.25), yaw=0.3),
    )
    goal = placed(scene, "mug", "saucer", (0.0, 0.0, 0.0045), height=0.012)
    return carry(scene, goal, "mug", by_the_rim(0.075, 0.09, 0.004), "saucer", (0, 0, 0.006))


def bottle_on_tray() -> Prepared:
    """Put a bottle, gripped by its neck, on a tray."""
    scene = scene_of(
        "bottle_on_tray",
        put("tray", (0.15, 0.1), yaw=0.2),
        put("bottle_plain", (-0.15, -0.1)),
        put("mug", (0.03, 0.096), on="tray", z=0.006, yaw=-0.2, values={"colour": "blue"}),
    )
    goal = placed(scene, "bottle_plain", "tray", (0.0, -0.05, 0.006))
    grasp = Grasp((0.0, 0.0, 0.185), 0.024)
    return carry(scene, goal, "bottle_plain", grasp, "tray", (0.0, -0.05, 0.006))


def ball_into_jar(across: float, ball: float) -> Prepared:
    """Drop a ball into an open jar."""
    sizes = {"depth": ball, "width": ball, "height": ball}
    scene = scene_of(
        "ball_into_jar",
        put("jar", (0.15, 0.05), values={"depth": across, "width": across, "height": 0.09}),
        put("hole_board", (-0.12, 0.0), values={"hole": 0.6 * ball}),
        put("ball", (0.0, 0.0), on="hole_board", z=0.05 - 0.1 * ball, values=sizes),
    )
    goal = placed(scene, "ball", "jar", (0, 0, 0.008), radius=across / 2, tilt=NO_TILT)
    grasp = Grasp((0.0, 0.0, 0.55 * ball), ball, slack=0.003)
    return carry(scene, goal, "ball", grasp, "jar", (0, 0, 0.07), drop=0.01)


def block_into_tray(finish: str, height: float, yaw: float) -> Prepared:
    """Put a block into an open box."""
    blue: dict[str, Value] = {"colour": "blue"}
    scene = scene_of(
        "block_into_tray",
        put("tray", (0.15, 0.1), values={"height": height, "finish": finish, "width": 0.2}),
        put("toy_block", (-0.1, -0.1), yaw=yaw),
        put("toy_block", (-0.04, -0.03), name="other", on="tray", z=0.006, values=blue),
    )
    goal = placed(scene, "toy_block", "tray", (0.04, 0.04, 0.006))
    grasp = grasp_box(scene, "toy_block", depth=0.015)
    return carry(scene, goal, "toy_block", grasp, "tray", (0.04, 0.04, 0.007))


def phone_on_stand(case: str, lean: float) -> Prepared:
    """Put a phone from the table on a stand."""
    scene = scene_of(
        "phone_on_stand",
        put("phone_stand", (0.15, 0.1), values={"lean": lean, "depth": 0.1, "width": 0.07}),
        put("phone", (-0.2, -0.05), tilt=_tilted(-90), values={"case": case}),
        put("mug", (0.0, 0.25)),
    )
    a = math.radians(lean)
    # The stand's back is 8 mm thick and leans from (-12, 6) mm; the phone, 8.5 mm, stands along it.
    off = 0.004 + 0.00425 + 0.0005
    up = (0.012 + 0.00425 * math.sin(a) - 0.006 - off * math.sin(a)) / math.cos(a)
    foot = (-0.012 + off * math.cos(a) - up * math.sin(a), 0.0, 0.012 + 0.00425 * math.sin(a))
    goal = placed(
        scene,
        "phone",
        "phone_stand",
        (0.0, 0.0, 0.012),
        radius=0.015,
        tilt=(math.radians(5), math.radians(40)),
    )
    grasp = Grasp((0.002, 0.0, 0.11), 0.072, approach=(-1.0, 0.0, 0.0))
    return carry(
        scene,
        goal,
        "phone",
        grasp,
        "phone_stand",
        foot,
        tilt=_tilted(-lean),
        clear=0.25,
        hover=0.15,
    )


def pencil_into_cup(colour: str, at: tuple[float, float]) -> Prepared:
    """Put a standing pencil into a cup."""
    scene = scene_of(
        "pencil_into_cup",
        put("mug", at, values={"colour": "green", "height": 0.1}),
        put("hole_board", (-0.15, 0.0), values={"hole": 0.0112}),
        put("pencil", (0, 0), on="hole_board", z=0.006, values={"colour": colour}),
    )
    goal = placed(
        scene,
        "pencil",
        "mug",
        (0, 0, 0.006),
        radius=0.036,
        tilt=(0.0, math.radians(40)),
        height=0.02,
    )
    grasp = Grasp((0.0, 0.0, 0.15), 0.01, slack=0.003)
    return carry(
        scene, goal, "pencil", grasp, "mug", (0, 0, 0.007), clear=0.22, hover=0.13, drop=0.005
    )


def fruit_on_plate() -> Prepared:
    """Put an apple on a plate with a rim."""
    values = {"stuff": "fruit", "depth": 0.07, "width": 0.07, "height": 0.07}
    scene = scene_of(
        "fruit_on_plate",
        put("saucer", (0.15, 0.0), values={"depth": 0.16, "width": 0.16, "height": 0.03}),
        put("ring", (-0.15, 0.0), values={"bore": 0.05}),
        put("ball", (0, 0), name="apple", on="ring", z=0.0105, values=values),
    )
    goal = placed(scene, "apple", "saucer", (0, 0, 0.005), radius=0.055, tilt=NO_TILT)
    grasp = Grasp((0.0, 0.0, 0.04), 0.07)
    return carry(scene, goal, "apple", grasp, "saucer", (0, 0, 0.006))


def cup_into_microwave() -> Prepared:
    """Put a cup, gripped from the front, into an open microwave oven."""
    scene = scene_of(
        "cup_into_microwave",
        put("microwave", (-0.2, 0.0), fixed=True, state={"hinge": 1.5}),
        put("toy_block", (0.35, -0.05), name="stand", values={"depth": 0.12, "width": 0.12}),
        put("mug", (0, 0), on="stand", z=0.05, values={"depth": 0.06, "width": 0.06}),
        size=1.6,
    )
    inside = (0.05, 0.05, 0.06)
    goal = placed(
        scene, "mug", "microwave", inside, radius=0.06, touching=("microwave",), height=0.03
    )
    grasp = Grasp((0.0, 0.0, 0.06), 0.06, approach=(-1.0, 0.0, 0.0))
    return carry(
        scene, goal, "mug", grasp, "microwave", inside, hover=0.02, clear=0.02, retreat=0.25
    )


def block_into_drawer(cabinet: str, drawer: str, pull: float, z: float, drop: float) -> Prepared:
    """Put a block into a drawer that is open by `pull`, with its floor at z [m]."""
    scene = scene_of(
        f"block_into_{drawer}",
        put(cabinet, (0.0, 0.0), fixed=True, state={f"{drawer}_slide": pull}),
        put("toy_block", (0.75, 0.3), values={"depth": 0.04, "width": 0.04, "height": 0.04}),
        size=2.0,
    )
    front = size_of(scene, cabinet)[0] / 2
    target = (float(front + pull / 2 - 0.02), 0.0, z)
    goal = placed(scene, "toy_block", cabinet, target, radius=0.08)
    grasp = grasp_box(scene, "toy_block", depth=0.012)
    return carry(scene, goal, "toy_block", grasp, cabinet, target, drop=drop, hover=0.15)


def block_into_chest() -> Prepared:
    """Put a block into an open chest."""
    scene = scene_of(
        "block_into_chest",
        put("treasure_chest", (0.0, 0.0), fixed=True, state={"lid_hinge": 1.5}),
        put("toy_block", (0.4, 0.1), yaw=0.5, values={"colour": "yellow"}),
        size=1.6,
    )
    target = (0.03, 0.05, 0.03)
    goal = placed(scene, "toy_block", "treasure_chest", target, radius=0.05, height=0.03)
    grasp = grasp_box(scene, "toy_block", depth=0.015)
    return carry(
        scene,
        goal,
        "toy_block",
        grasp,
        "treasure_chest",
        target,
        drop=0.02,
        hover=0.25,
        retreat=0.3,
    )


def book_on_nightstand() -> Prepared:
    """Put a standing book on a nightstand."""
    scene = scene_of(
        "book_on_nightstand",
        put("nightstand", (0.0, 0.0), fixed=True),
        put("book", (0.6, 0.1), yaw=0.2),
        size=2.0,
    )
    top = float(size_of(scene, "nightstand")[2])
    goal = placed(scene, "book", "nightstand", (0, 0, top), radius=0.03)
    return carry(scene, goal, "book", grasp_box(scene, "book"), "nightstand", (0, 0, top))


def _tilted(degrees: float) -> Quat:
    w, x, y, z = from_axis_angle(np.array([0.0, 1.0, 0.0]), math.radians(degrees)).tolist()
    return w, x, y, z
