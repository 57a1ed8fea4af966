"""Errors of programs: proportions, walls, shapes, a missing part, positions of parts, joints.

Magnitudes were measured on twelve objects, each programmed from one image (docs/results.md). An
object with errors must pass the checks of programs. If no sample of an error passes, the error is
logged as refused.
"""

import zlib
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float

from neoworld_mjx.program.building import BuildResult, build
from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    GeomSpec,
    HollowBox,
    Lathe,
    ObjectSpec,
    RoundedBox,
    Shape,
    bounds,
    scale,
)
from neoworld_mjx.spec.kinematics import recentred
from neoworld_mjx.spec.pose import matrix
from neoworld_mjx.templates import Template
from neoworld_mjx.templates.template import BOX

from ..dataset.declaration import ObjectDeclaration, Value, template_of
from .joint_noise import TRIES, Draft, wrong_joints
from .parse_noise import NoiseLog

SHARES = 0.2
"""Standard deviation of the displacement of the knots at thirds of an object's side, as a fraction
of the side. It is chosen by the Chamfer distance (times ten) of twelve objects, whose mean is .139
(docs/results.md, "Objects from pictures"). With this deviation, the Chamfer distance of
cupboards, ovens and desks is .129; without it, .113. With a larger deviation, the checks of
programs refuse many samples."""
KNOTS = 4
"""Number of points along a side between which displacements are interpolated; both ends stay."""
NARROWEST = 0.15
"""Minimum length of a third after the displacement, as a fraction of its length before. Samples
with shorter thirds are repeated."""
AXES = (3, 3, 2, 2, 2, 1, 1, 1)
"""Number of axes that change in each attempt; fewer in later attempts, because the checks may
refuse changes of three axes."""
ALIGNED = 1e-6
"""Maximum deviation of a rotation matrix from one that permutes axes."""


class ProportionMap:
    """A random monotone map of each axis of an object that keeps the object's bounding box.

    Parts that are separate along an axis stay separate, and parts that touch keep touching.
    """

    def __init__(self, spec: ObjectSpec, rng: np.random.Generator, axes: int) -> None:
        """Sample a map that changes a number of axes of an object, with all joints at zero."""
        self.low, self.high = bounds(spec)
        self.knots = np.linspace(0.0, 1.0, KNOTS)
        changed = rng.permutation(3) < axes
        self.values = np.stack(
            [self._sample_knots(rng) if changes else self.knots for changes in changed]
        )

    def _sample_knots(self, rng: np.random.Generator) -> Float[np.ndarray, " knot"]:
        while True:
            values = self.knots.copy()
            values[1:-1] += SHARES * rng.normal(size=KNOTS - 2)
            if np.diff(values).min() > NARROWEST / (KNOTS - 1):
                return values

    def __call__(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Map points in the object's frame [m]; coordinates outside the box do not change."""
        points, size = np.asarray(points, float), self.high - self.low
        share = (points - self.low) / size
        mapped = [
            np.interp(share[..., k], self.knots, self.values[k])
            + share[..., k]
            - np.clip(share[..., k], 0.0, 1.0)
            for k in range(3)
        ]
        return self.low + np.stack(mapped, axis=-1) * size


def with_other_proportions(spec: ObjectSpec, rng: np.random.Generator, axes: int = 3) -> ObjectSpec:
    """Return an object with other positions and sizes of its parts in nearly the same box.

    Boxes and shapes extruded along an axis are resized, but walls keep their thickness. Other
    shapes are moved. Joints and sites are moved, too.
    """
    proportion_map = ProportionMap(spec, rng, axes)
    point = lambda pos: tuple(proportion_map(np.array(pos)).tolist())
    parts = tuple(
        part.model_copy(
            update={"geoms": tuple(_mapped(geom, proportion_map) for geom in part.geoms)}
        )
        for part in spec.parts
    )
    joints = tuple(
        joint.model_copy(update={"pos": point(joint.pos), "intent": None}) for joint in spec.joints
    )
    sites = tuple(site.model_copy(update={"pos": point(site.pos)}) for site in spec.sites)
    return spec.model_copy(update={"parts": parts, "joints": joints, "sites": sites})


def _mapped(geom: GeomSpec, proportion_map: ProportionMap) -> GeomSpec:
    shape, turn = geom.shape.model_dump(), matrix(geom.quat)
    axes = np.abs(turn)
    pos = np.array(geom.pos)
    if np.minimum(axes, np.abs(1 - axes)).max() > ALIGNED:
        return geom.model_copy(update={"pos": tuple(proportion_map(pos).tolist())})
    sides = _sides(shape)
    half = np.round(axes) @ sides / 2
    ends = proportion_map(np.stack([pos - half, pos + half]))
    size = np.round(axes).T @ (ends[1] - ends[0])
    # Along an axis in which the shape cannot be resized, only its center moves.
    middle = np.where(half > 0, ends.mean(axis=0), proportion_map(pos))
    if "size" in shape:
        shape["size"] = tuple(size.tolist())
    elif sides[2] > 0:
        shape["height"] = float(size[2])
    return GeomSpec.model_validate(
        geom.model_dump() | {"shape": shape, "pos": tuple(middle.tolist())}
    )


def _sides(shape: Mapping[str, object]) -> Float[np.ndarray, " 3"]:
    """Return the lengths of a shape that the map may change, along its axes [m]; others are 0."""
    if "size" in shape:
        return np.array(shape["size"], float)
    if "height" in shape and shape["type"] in ("cylinder", "prism", "extrusion"):
        return np.array([0.0, 0.0, shape["height"]], float)
    return np.zeros(3)


EDGE = 0.06
"""Standard deviation of the logarithm of edges and of other lengths and ratios in a program.
Measured: the worst edge of an object was wrong by 5.5 % (median of twelve objects; range 1 to 11 %)
after a fit of the overall size. The worst of three edges with this deviation has the same error."""
WALL = 0.26
"""Standard deviation of the logarithm of the thickness of walls. It was not measured; it equals
that of joint ranges, because a model chooses usual values for both."""
REPLACED, MISSING = 1 / (12 + 2), 1 / (12 + 2)
"""Rates per object of a shape that is replaced by another primitive, and of a missing small part.
Measured: no body or visible part of twelve objects was wrong. The rate 1/(n + 2) is the mean of
Laplace's rule of succession."""
SMALL = 0.1
"""Maximum volume of a missing part, as a fraction of the object's volume."""
NEARLY_SQUARE = 1.25
"""Maximum ratio of the horizontal edges of a box that is replaced by a cylinder."""


def wrong_program(
    item: ObjectDeclaration, number: int, parents: frozenset[str], log: NoiseLog
) -> ObjectSpec:
    """Return an object with the errors of a program written from an image.

    Args:
        item: the true declaration of the object.
        number: seed of the noise. The noise of each object also depends on its name.
        parents: parts that support other objects; these are never missing.
        log: log to which the errors are added: "shape", "part", and the errors of `joint_noise`.
    """
    rng = np.random.default_rng((number, 45, zlib.crc32(item.name.encode())))
    built = _sampled_program(template_of(item), item.set, rng, log)
    assert built.spec is not None
    draft = Draft(built.spec, built.allowances, rng, log)
    draft.change("walls", with_other_walls, noted=False)
    if rng.uniform() < REPLACED:
        draft.change("shape", with_other_shape)
    if rng.uniform() < MISSING:
        draft.change("part", lambda spec, rng: without_part(spec, rng, parents))
    wrong_joints(draft)
    axes = iter(AXES)
    draft.change(
        "shares", lambda spec, rng: with_other_proportions(spec, rng, next(axes)), noted=False
    )
    return scale(recentred(draft.spec), item.scale)


def _sampled_program(
    template: Template, true_values: dict[str, Value], rng: np.random.Generator, log: NoiseLog
) -> BuildResult:
    """Build the program with noisy parameters; if no sample passes, with the true parameters."""
    for _ in range(TRIES):
        values = near_parameters(template, true_values, rng)
        built = build(template.program(values))
        if built.ok:
            return built
    log.refused.append("proportions")
    return build(template.program(true_values))


def near_parameters(
    template: Template, true_values: dict[str, Value], rng: np.random.Generator
) -> dict[str, Value]:
    """Return a program's parameters with noisy lengths, clipped to the parameters' ranges.

    Equal edges stay equal, because a model recognizes round and square objects. Counts and choices
    are unchanged.
    """
    values: dict[str, Value] = {
        name: p.default for name, p in template.parameters.items()
    } | true_values
    factors: dict[Value, float] = {}
    for name, parameter in template.parameters.items():
        value, factor = values[name], float(np.exp(EDGE * rng.normal()))
        if isinstance(value, str) or isinstance(parameter.default, int | str):
            continue
        if name in BOX:
            factor = factors.setdefault(value, factor)
        values[name] = min(max(value * factor, parameter.low), parameter.high)
    return values


def with_other_walls(spec: ObjectSpec, rng: np.random.Generator) -> ObjectSpec:
    """Return an object in which the thickness of all walls is multiplied by one random factor."""
    factor = float(np.exp(WALL * rng.normal()))

    def walled(geom: GeomSpec) -> GeomSpec:
        shape = geom.shape
        if isinstance(shape, HollowBox):
            return _shaped(geom, shape.model_dump() | {"wall": shape.wall * factor})
        if isinstance(shape, Lathe) and shape.thickness is not None:
            return _shaped(geom, shape.model_dump() | {"thickness": shape.thickness * factor})
        return geom

    return _with_geoms(spec, walled)


def with_other_shape(spec: ObjectSpec, rng: np.random.Generator) -> ObjectSpec | None:
    """Return an object with one shape replaced by another primitive with similar bounds."""
    options = [
        (geom, other) for part in spec.parts for geom in part.geoms for other in _others(geom.shape)
    ]
    if not options:
        return None
    chosen, shape = options[int(rng.integers(len(options)))]
    return _with_geoms(
        spec, lambda geom: _shaped(geom, shape.model_dump()) if geom is chosen else geom
    )


def _others(shape: Shape) -> Iterator[Shape]:
    if isinstance(shape, Box | RoundedBox):
        x, y, z = shape.size
        if max(x, y) < NEARLY_SQUARE * min(x, y):
            yield Cylinder(radius=(x + y) / 4, height=z)
        if isinstance(shape, RoundedBox):
            yield Box(size=shape.size)
        else:
            yield RoundedBox(size=shape.size, radius=0.2 * min(shape.size))
    elif isinstance(shape, Cylinder):
        yield Box(size=(2 * shape.radius, 2 * shape.radius, shape.height))
    elif isinstance(shape, Capsule):
        yield Cylinder(radius=shape.radius, height=shape.length + 2 * shape.radius)


def without_part(
    spec: ObjectSpec, rng: np.random.Generator, parents: frozenset[str]
) -> ObjectSpec | None:
    """Return an object without a small part or shape that supports nothing; None if impossible."""
    total = sum(geom.shape.volume() for part in spec.parts for geom in part.geoms)
    holding = {joint.parent for joint in spec.joints} | parents | {spec.root}
    referenced = {name for joint in spec.joints for name in joint.after} | {
        joint.mimic.joint for joint in spec.joints if joint.mimic is not None
    }
    holding |= {joint.child for joint in spec.joints if joint.name in referenced}
    options: list[tuple[str, str | None]] = []
    for part in spec.parts:
        volumes = {geom.name: geom.shape.volume() for geom in part.geoms}
        if part.name not in holding and sum(volumes.values()) < SMALL * total:
            options.append((part.name, None))
        elif len(volumes) > 1:
            options += [(part.name, name) for name, v in volumes.items() if v < SMALL * total]
    if not options:
        return None
    name, shape = options[int(rng.integers(len(options)))]
    if shape is not None:
        return _with_geoms(spec, lambda geom: None if geom.name == shape else geom)
    update = {
        "parts": tuple(part for part in spec.parts if part.name != name),
        "joints": tuple(joint for joint in spec.joints if joint.child != name),
        "sites": tuple(site for site in spec.sites if site.part != name),
    }
    return spec.model_copy(update=update)


def _with_geoms(spec: ObjectSpec, change: Callable[[GeomSpec], GeomSpec | None]) -> ObjectSpec:
    parts = []
    for part in spec.parts:
        geoms = [new for geom in part.geoms if (new := change(geom)) is not None]
        parts.append(part.model_copy(update={"geoms": tuple(geoms)}))
    return spec.model_copy(update={"parts": tuple(parts)})


def _shaped(geom: GeomSpec, shape: Mapping[str, object]) -> GeomSpec:
    return GeomSpec.model_validate(geom.model_dump() | {"shape": shape})
