"""Twelve valid scenes with what a photograph would show of them, and starts as a parse leaves them.

The search sees boxes and depths with noise, never the truth; its starts are off by as much as a
rough parse is, so that hardly any of them holds.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.physics.support import posed_shapes
from neoworld_mjx.spec import (
    Box,
    Box2D,
    Camera,
    Cylinder,
    HollowBox,
    SceneObject,
    SceneSpec,
    world_poses,
)

from .engines.agreement_scenes import cabinet, stack
from .engines.table_scenes import (
    CERAMIC,
    TOP,
    Noise,
    block,
    crowded,
    noisy_layouts,
    single,
    standing,
    table,
)
from .fidelity.rendered_scenes import see

BOX_NOISE_PX, BOX_NOISE, DEPTH_NOISE = 2.0, 0.02, 0.02
"""Noise of the photograph's boxes [px] and as a share of their sizes, and of depths as a share."""
START = Noise(xy=0.08, yaw=math.radians(20.0), log_scale=0.12)
"""Noise of starts around the truth; xy in horizontal diagonals."""
GAP = 0.004
"""Clearance between neighbours of the truth [m]."""

Row = tuple[Any, str, tuple[float, float], float]
"""An object: its description, its parent, where on it, and its height above the parent's origin."""


def _on_table(name: str, rows: list[Row], *, turn: float = 0.1) -> SceneSpec:
    """Set things down, each turned by `turn` [rad] more than the one before it."""
    made: list[SceneObject] = [table(0.8, 0.8)]
    made += [
        standing(spec, parent, xy, z, turn * k) for k, (spec, parent, xy, z) in enumerate(rows)
    ]
    return SceneSpec(name=name, objects=tuple(made))


def _packed(rows: int, columns: int) -> Callable[[], SceneSpec]:
    """Boxes and cylinders in a grid, GAP apart."""

    def make() -> SceneSpec:
        made: list[Row] = []
        for k in range(rows * columns):
            x, y = (k // columns) * (0.13 + GAP), (k % columns) * (0.09 + GAP)
            tall = 0.07 + 0.015 * (k % 3)
            box = block(f"box_{k}", 0.13, 0.09, tall)
            can = single(f"can_{k}", (Cylinder(radius=0.045, height=tall), (0, 0, 0)))
            made.append((can if k % 4 == 3 else box, "table", (x - 0.1, y - 0.1), TOP))
        return _on_table(f"packed_{rows * columns}", made, turn=0.0)

    return make


def flanked() -> SceneSpec:
    """Four blocks on each other, between two boxes."""
    scene = stack()
    low = 0.09 / 2 + GAP + 0.05
    boxes = [
        standing(block(f"box_{k}", 0.15, 0.1, 0.12), "table", (0.0, side * low), TOP)
        for k, side in enumerate((-1, 1))
    ]
    return scene.model_copy(update={"name": "flanked", "objects": (*scene.objects, *boxes)})


def full() -> SceneSpec:
    """An open box that four blocks almost fill."""
    bin_ = single("bin", (HollowBox(size=(0.2, 0.2, 0.07), wall=0.008), (0, 0, 0)))
    made: list[Row] = [(bin_, "table", (0.0, 0.0), TOP)]
    for k, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        spec = block(f"block_{k}", 0.086, 0.086, 0.05)
        made.append((spec, "bin", (0.046 * x, 0.046 * y), 0.008))
    return _inside(_on_table("full", made, turn=0.0), "block_")


def two_stacks() -> SceneSpec:
    """Two stacks of three blocks, side by side, and a box before both."""
    rows: list[Row] = []
    for k, y in enumerate((-0.047, 0.047)):
        parent, z = "table", TOP
        for level, edge in enumerate((0.09, 0.075, 0.06)):
            spec = block(f"block_{k}_{level}", edge, edge, 0.045)
            rows.append((spec, parent, (0.0, y if level == 0 else 0.0), z))
            parent, z = spec.name, 0.045
    rows.append((block("before", 0.08, 0.14, 0.06), "table", (-0.089, 0.0), TOP))
    return _on_table("two_stacks", rows, turn=0.0)


def books() -> SceneSpec:
    """A row of upright books, a few millimetres apart, and a box at each end."""
    thick = (0.035, 0.045, 0.04, 0.05)
    rows: list[Row] = []
    y = -0.13
    for k, t in enumerate((0.06, *thick, 0.06)):
        size = (0.08, t, 0.07) if k in (0, 5) else (0.12, t, 0.17)
        rows.append((block(f"book_{k}", *size), "table", (0.0, y + t / 2), TOP))
        y += t + GAP
    return _on_table("books", rows, turn=0.0)


def shelf() -> SceneSpec:
    """A fixed shelf with three boards, and things standing on two of them."""
    boards = [(Box(size=(0.3, 0.6, 0.02)), (0, 0, 0.01 + 0.25 * k)) for k in range(3)]
    sides = [(Box(size=(0.3, 0.02, 0.52)), (0, side * 0.31, 0.26)) for side in (-1, 1)]
    spec = single("shelf", *boards, *sides)
    fixed = SceneObject(name="shelf", spec=spec, environment=True, xy=(0.0, 0.0), z=-0.3)
    made = [fixed]
    for k, (z, y) in enumerate(
        ((0.27, -0.19), (0.27, -0.06), (0.27, 0.07), (0.02, 0.0), (0.02, 0.14))
    ):
        thing = block(f"thing_{k}", 0.15, 0.11, 0.12 + 0.01 * k)
        made.append(standing(thing, "shelf", (0.02, y), z, 0.05 * k))
    return SceneSpec(name="shelf", objects=tuple(made))


def dishes() -> SceneSpec:
    """Plates in a pile, two cups on it and a bowl on either side."""
    plate = lambda k, r: single(
        f"plate_{k}", (Cylinder(radius=r, height=0.015), (0, 0, 0)), material=CERAMIC
    )
    cup = lambda k: single(
        f"cup_{k}", (Cylinder(radius=0.03, height=0.07), (0, 0, 0)), material=CERAMIC
    )
    bowl = lambda k: single(
        f"bowl_{k}", (HollowBox(size=(0.13, 0.13, 0.06), wall=0.008), (0, 0, 0)), material=CERAMIC
    )
    rows: list[Row] = [
        (plate(0, 0.12), "table", (0.0, 0.0), TOP),
        (plate(1, 0.1), "plate_0", (0.0, 0.0), 0.015),
        (cup(0), "plate_1", (0.0, 0.032), 0.015),
        (cup(1), "plate_1", (0.0, -0.032), 0.015),
        (bowl(0), "table", (0.0, 0.189), TOP),
        (bowl(1), "table", (0.0, -0.189), TOP),
    ]
    return _on_table("dishes", rows, turn=0.0)


def tower() -> SceneSpec:
    """A board across two pillars, with a block on its middle."""
    rows: list[Row] = [
        (block("left", 0.07, 0.07, 0.12), "table", (0.0, -0.09), TOP),
        (block("right", 0.07, 0.07, 0.12), "table", (0.0, 0.09), TOP),
        (block("crate", 0.09, 0.08, 0.08), "table", (0.0, 0.0), TOP),
        (block("top", 0.06, 0.06, 0.05), "crate", (0.0, 0.0), 0.08),
    ]
    return _on_table("tower", rows, turn=0.0)


def drawers() -> SceneSpec:
    """A cabinet with its drawer open, something inside and on top, and boxes beside it."""
    scene = cabinet()
    beside = [
        standing(block(f"beside_{k}", 0.12, 0.1, 0.1), "table", (0.05, side * 0.21), TOP)
        for k, side in enumerate((-1, 1))
    ]
    return scene.model_copy(update={"name": "drawers", "objects": (*scene.objects, *beside)})


def crates() -> SceneSpec:
    """Two open crates, side by side, each with things inside."""
    crate = lambda k: single(
        f"crate_{k}", (HollowBox(size=(0.2, 0.18, 0.08), wall=0.008), (0, 0, 0))
    )
    rows: list[Row] = []
    for k, side in enumerate((-1, 1)):
        rows.append((crate(k), "table", (0.0, side * 0.096), TOP))
        rows.append((block(f"in_{k}_0", 0.07, 0.06, 0.05), f"crate_{k}", (-0.045, 0.02), 0.008))
        rows.append((block(f"in_{k}_1", 0.06, 0.07, 0.05), f"crate_{k}", (0.045, -0.02), 0.008))
    return _inside(_on_table("crates", rows, turn=0.0), "in_")


def _inside(scene: SceneSpec, prefix: str) -> SceneSpec:
    objects = [
        item.model_copy(update={"relation": "in"}) if item.name.startswith(prefix) else item
        for item in scene.objects
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


def _crowd(objects: int) -> Callable[[], SceneSpec]:
    return lambda: crowded(objects, seed=objects, gap=GAP)


SCENES: dict[str, Callable[[], SceneSpec]] = {
    "packed_6": _packed(2, 3),
    "packed_9": _packed(3, 3),
    "crowd_10": _crowd(10),
    "flanked": flanked,
    "two_stacks": two_stacks,
    "tower": tower,
    "books": books,
    "shelf": shelf,
    "dishes": dishes,
    "drawers": drawers,
    "full": full,
    "crates": crates,
}
"""The scenes of `bench run refine`, 4 to 10 objects each."""

LARGE: dict[str, Callable[[], SceneSpec]] = {"crowd_20": _crowd(20), "crowd_40": _crowd(40)}
"""Larger ones, of which only validity and time are asked."""


def photographed(name: str, *, seed: int = 0) -> SceneSpec:
    """Return a scene with a camera before it and the noisy boxes and depths that it would see.

    Boxes are of what is visible, taken from a ray-cast picture.

    Args:
        name: of `SCENES` or `LARGE`.
        seed: of the noise.
    """
    scene = (SCENES | LARGE)[name]()
    poses = world_poses(scene)
    half = max(float(np.hypot(*pose.pos[:2])) for pose in poses.values()) + 0.15
    away = 2.2 * half
    base = scene.objects[0]
    base = base.model_copy(update={"xy": (base.xy[0] + away, base.xy[1])})
    camera = Camera(width=640, height_px=480, fovy=0.9, height=0.9 * away, pitch=0.73)
    scene = scene.model_copy(update={"camera": camera, "objects": (base, *scene.objects[1:])})
    rng = np.random.default_rng((seed, len(name), *name.encode()))
    return scene.model_copy(update={"objects": tuple(_noisy(see(scene), rng))})


def _noisy(scene: SceneSpec, rng: np.random.Generator) -> list[SceneObject]:
    """Disturb what a photograph shows of a scene's objects."""
    objects = []
    for item in scene.objects:
        assert item.box2d is not None and item.depth is not None
        box = np.array(item.box2d.as_tuple())
        size = math.sqrt(np.prod(box[2:] - box[:2]))
        box += rng.normal(size=4) * math.hypot(BOX_NOISE_PX, BOX_NOISE * size)
        # However few pixels show it, a detector gives it one.
        narrow = np.maximum(1.0 - (box[2:] - box[:2]), 0.0) / 2
        box += np.concatenate([-narrow, narrow])
        far = item.depth * (1 + DEPTH_NOISE * rng.normal())
        edges = dict(zip(("x0", "y0", "x1", "y1"), map(float, box), strict=True))
        objects.append(item.model_copy(update={"box2d": Box2D(**edges), "depth": far}))
    return objects


def start(scene: SceneModel, seed: int) -> Layout:
    """Draw where a search starts, as a layout about the truth; pop axis of length 1."""
    return noisy_layouts(scene, 1, seed=100 + seed, noise=START)


def symmetry(item: SceneObject) -> float:
    """Return the smallest turn about the vertical [rad] that an object looks the same after.

    0 for what is round, such as a ball or a standing can, whose heading means nothing.
    """
    points = np.vstack(
        [at.apply(shape.surface()[0]) for shape, at in posed_shapes(item, tilted=True)]
    )
    ways = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    outline = points[:, :2] @ np.stack([np.cos(ways), np.sin(ways)])
    reach = outline.max(axis=0)
    for step in (10, 45, 60, 90, 120, 180):
        if np.abs(reach - np.roll(reach, step)).max() < 0.02 * reach.max():
            return 0.0 if step == 10 else math.radians(step)
    return 2 * math.pi


def errors(scene: SceneModel, layout: Layout) -> dict[str, float]:
    """Return how far a layout is from the truth, means over the objects that move.

    Returns:
        "xy_m", in parents' frames; "yaw_deg", up to an object's symmetry and without round ones;
        "scale", of the logarithm.
    """
    moves = np.asarray(scene.optimised)
    mean = lambda x: float(np.mean(np.asarray(x)[moves]))
    turns = []
    for k, item in enumerate(scene.spec.objects):
        period = symmetry(item) if moves[k] else 0.0
        if period > 0:
            turn = float(layout.yaw[0, k])
            turns.append(abs((turn + period / 2) % period - period / 2))
    return {
        "xy_m": mean(np.linalg.norm(layout.xy[0], axis=-1)),
        "yaw_deg": math.degrees(float(np.mean(turns))) if turns else 0.0,
        "scale": mean(np.abs(layout.log_scale[0])),
    }
