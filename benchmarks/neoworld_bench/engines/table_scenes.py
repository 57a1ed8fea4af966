"""Generated tables with any number of objects, and noisy layouts of them.

Gaps and noise are chosen so that a large share of the layouts fails; otherwise early stopping and
verdicts would be trivial.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import SceneModel
from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    GeomSpec,
    HollowBox,
    Material,
    ObjectSpec,
    PartSpec,
    Prism,
    SceneObject,
    SceneSpec,
    Sphere,
    bounds,
    recentred,
)

WOOD = Material(name="wood", density=600, friction=0.5)
CERAMIC = Material(name="ceramic", density=2300, friction=0.4)
STEEL = Material(name="steel", density=7800, friction=0.3)
FLAT = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
TOP = 0.04
"""Thickness of the table, whose top is the plane z = TOP of its own frame [m]."""

_KINDS = ("box", "cylinder", "upper", "container", "inside", "prism", "ball", "rod")
"""Kinds of the objects of a crowded scene, in turn; `inside` lies in the container before it and
`upper` stands on the box before it."""

_EDGES = {"box": (0.075, 0.075, 0.075), "upper": (0.05, 0.05, 0.05), "inside": (0.035, 0.03, 0.03)}
"""Mean edges of the boxes [m]."""

_GAPS = ((3, -0.02), (6, -0.011), (10, 0.01), (20, 0.017), (40, 0.025))
"""Clearance between neighbours [m] by number of objects: more objects need more
clearance for the same share of failures.
"""


class Noise(NamedTuple):
    """Spread of layouts; the default is that of a rough parse, with which 40 to 80 % of the layouts
    of `crowded` fail.
    """

    xy: float = 0.14
    """Standard deviation of the position as a share of the object's horizontal diagonal."""
    yaw: float = math.radians(15.0)
    """Standard deviation [rad]."""
    log_scale: float = 0.1
    """Standard deviation of the logarithm of the scale."""
    scales: tuple[float, float] | None = None
    """Smallest and largest scale, drawn log-uniformly, instead of a Gaussian."""


def noisy_layouts(
    scene: SceneModel, pop: int, *, seed: int = 0, noise: Noise | None = None
) -> Layout:
    """Draw layouts around the composed scene, as NumPy arrays in single precision.

    Args:
        scene: the compiled scene; environment supports stay where they are.
        pop: number of candidates.
        seed: of the draws; the first candidates are the same for every `pop`.
        noise: spread of the draws.
    """
    n = noise or Noise()
    free = np.asarray(scene.optimised, float)
    # One generator per candidate, so that a larger population begins with a smaller one.
    draws = [np.random.default_rng((seed, k)) for k in range(pop)]
    normal = np.stack([rng.normal(size=(4, len(free))) for rng in draws])
    xy = normal[:, :2].transpose(0, 2, 1) * (n.xy * np.asarray(scene.diagonal))[:, None]
    log_scale = normal[:, 3] * n.log_scale
    if n.scales is not None:
        low, high = np.log(n.scales)
        log_scale = np.stack([rng.uniform(low, high, len(free)) for rng in draws])
    f32 = lambda x: np.asarray(x, np.float32)
    return Layout(f32(xy * free[:, None]), f32(normal[:, 2] * n.yaw * free), f32(log_scale * free))


def crowded(objects: int) -> SceneSpec:
    """Return a table with boxes, cylinders, prisms, balls, rods and open containers.

    The clearance between neighbours is such that 40 to 80 % of noisy layouts fail.

    Args:
        objects: number of objects, without the table.
    """
    rng = np.random.default_rng((0, objects))
    gap = float(np.interp(math.log(objects), *_log_table(_GAPS)))
    items: list[SceneObject] = []
    discs: list[tuple[int, float]] = []
    latest: dict[str, SceneObject] = {}
    for k in range(objects):
        kind = _KINDS[k % len(_KINDS)]
        name, yaw = f"{kind}_{k}", float(rng.uniform(-0.5, 0.5))
        spec, radius = _thing(kind, name, rng)
        carrier = latest.get({"inside": "container", "upper": "box"}.get(kind, ""))
        if carrier is not None:
            z = 0.006 if kind == "inside" else _height(carrier)
            relation = "in" if kind == "inside" else "on"
            item = standing(spec, carrier.name, (0.0, 0.0), z, yaw, relation=relation)
        else:
            item = standing(spec, "table", (0.0, 0.0), TOP, yaw)
            discs.append((k, radius))
        latest[kind] = item
        items.append(item)
    spots, extent = _rows([radius for _, radius in discs], gap)
    for (k, _), spot in zip(discs, spots, strict=True):
        items[k] = items[k].model_copy(update={"xy": spot})
    return SceneSpec(name=f"crowded_{objects}", objects=(table(*extent), *items))


def _log_table(rows: tuple[tuple[int, float], ...]) -> tuple[list[float], list[float]]:
    return [math.log(count) for count, _ in rows], [value for _, value in rows]


def _rows(radii: list[float], gap: float) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Place discs in rows with a gap; return their centers and the table's edges [m]."""
    width = math.ceil(math.sqrt(len(radii)))
    spots: list[tuple[float, float]] = []
    y = 0.0
    for first in range(0, len(radii), width):
        row = radii[first : first + width]
        x = 0.0
        for radius in row:
            spots.append((x + radius, y + max(row)))
            x += 2 * radius + gap
        y += 2 * max(row) + gap
    centre = np.mean(spots, axis=0)
    edges = 2 * np.abs(np.array(spots) - centre).max(axis=0) + 0.4
    return [(float(a), float(b)) for a, b in np.array(spots) - centre], (
        float(edges[0]),
        float(edges[1]),
    )


def _thing(kind: str, name: str, rng: np.random.Generator) -> tuple[ObjectSpec, float]:
    """Return an object and the radius of the disc that it covers [m]."""
    a, b, c = (float(v) for v in rng.uniform(0.9, 1.15, 3))
    if kind in _EDGES:
        x, y, z = _EDGES[kind]
        spec = block(name, x * a, y * b, z * c)
        return spec, math.hypot(x * a, y * b) / 2
    if kind == "cylinder":
        shape = Cylinder(radius=0.03 * a, height=0.08 * b)
        return single(name, (shape, (0, 0, 0)), material=CERAMIC), 0.03 * a
    if kind == "prism":
        outline = polygon(6, 0.035 * a)
        return single(name, (Prism(outline=outline, height=0.05 * b), (0, 0, 0))), 0.035 * a
    if kind == "ball":
        return single(name, (Sphere(radius=0.03 * a), (0, 0, 0)), material=STEEL), 0.03 * a
    if kind == "rod":
        shape = Capsule(radius=0.012 * a, length=0.07 * b)
        return single(name, (shape, (0, 0, 0), FLAT)), 0.012 * a + 0.035 * b
    x, y = 0.11 * a, 0.1 * b
    shape = HollowBox(size=(x, y, 0.05 * c), wall=0.006)
    return single(name, (shape, (0, 0, 0))), math.hypot(x, y) / 2


def single(name: str, *shapes: tuple[Any, ...], material: Material = WOOD) -> ObjectSpec:
    """Return a rigid object of shapes, each (shape, pos) or (shape, pos, quat)."""
    geoms = tuple(
        GeomSpec(
            name=f"g{k}",
            shape=row[0],
            pos=row[1],
            quat=row[2] if len(row) > 2 else (1, 0, 0, 0),
            material=material.name,
        )
        for k, row in enumerate(shapes)
    )
    part = PartSpec(name="body", geoms=geoms)
    return recentred(ObjectSpec(name=name, materials=(material,), parts=(part,)))


def table(x: float = 0.8, y: float = 0.8) -> SceneObject:
    """Return a table with the given edges [m] and its top in the plane z = 0."""
    spec = single("table", (Box(size=(x, y, TOP)), (0, 0, 0)))
    return SceneObject(name="table", spec=spec, environment=True, z=-TOP)


def standing(
    spec: ObjectSpec,
    parent: str,
    xy: tuple[float, float],
    z: float,
    yaw: float = 0.0,
    **fields: Any,
) -> SceneObject:
    """Return an object placed on a parent; see `SceneObject`."""
    return SceneObject(name=spec.name, spec=spec, parent=parent, xy=xy, z=z, yaw=yaw, **fields)


def _height(item: SceneObject) -> float:
    low, high = bounds(item.spec)
    return float(high[2] - low[2])


def block(name: str, x: float, y: float, z: float) -> ObjectSpec:
    """Return a wooden box with the given edges [m]."""
    return single(name, (Box(size=(x, y, z)), (0, 0, 0)))


def polygon(corners: int, radius: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a regular polygon [m]."""
    turns = 2 * math.pi * np.arange(corners) / corners
    return tuple((radius * math.cos(t), radius * math.sin(t)) for t in turns)
