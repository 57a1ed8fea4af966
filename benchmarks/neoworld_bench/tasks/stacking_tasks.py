"""Stacking tasks."""

from neoworld_mjx.templates.template import Value

from .carrying_tasks import carry, placed
from .predicates import Every
from .reference import Grasp, grasp_box
from .task import Prepared
from .task_scenes import put, scene_of


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
