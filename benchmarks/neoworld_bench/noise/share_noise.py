"""Errors of the proportions of an object: positions of shelves, fronts, handles and legs."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from neoworld_mjx.spec import GeomSpec, ObjectSpec, bounds
from neoworld_mjx.spec.pose import matrix

SHARES = 0.2
"""Standard deviation of the displacement of the knots at thirds of an object's side, as a fraction
of the side. It is chosen by the Chamfer distance (times ten) of twelve objects, whose mean is .139
(docs/benchmarks.md, "Objects from pictures"). With this deviation, the Chamfer distance of
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
