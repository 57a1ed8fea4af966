"""Errors of proportions within an object: positions of shelves, fronts, handles and legs."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from neoworld_mjx.spec import GeomSpec, ObjectSpec, bounds
from neoworld_mjx.spec.pose import matrix

SHARES = 0.2
"""Standard deviation of the knots at thirds of an object's sides, over the side. It is chosen by
the Chamfer distance of twelve objects, whose mean is .139 (times ten; docs/benchmarks.md, "Objects
from pictures"): with this spread it is .129 for cupboards, ovens and desks, without it .113; the
checks of programs refuse many draws with a larger one."""
KNOTS = 4
"""Points along a side between which errors are interpolated; both ends stay."""
NARROWEST = 0.15
"""Minimum share of its length that a third keeps; smaller draws are repeated."""
AXES = (3, 3, 2, 2, 2, 1, 1, 1)
"""Number of axes that change in each attempt, as the checks may refuse three at once."""
ALIGNED = 1e-6
"""Tolerance of a rotation matrix that permutes axes."""


class Shares:
    """A monotone map of each axis of an object onto itself that keeps its bounding box.

    Parts that are separate along an axis stay separate, parts that touch keep touching.
    """

    def __init__(self, spec: ObjectSpec, rng: np.random.Generator, axes: int) -> None:
        """Draw a map of a number of axes of an object at rest."""
        self.low, self.high = bounds(spec)
        self.knots = np.linspace(0.0, 1.0, KNOTS)
        changed = rng.permutation(3) < axes
        self.values = np.stack([self._drawn(rng) if own else self.knots for own in changed])

    def _drawn(self, rng: np.random.Generator) -> Float[np.ndarray, " knot"]:
        while True:
            values = self.knots.copy()
            values[1:-1] += SHARES * rng.normal(size=KNOTS - 2)
            if np.diff(values).min() > NARROWEST / (KNOTS - 1):
                return values

    def __call__(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Map points of the object's frame [m]; outside of the box nothing changes."""
        points, size = np.asarray(points, float), self.high - self.low
        share = (points - self.low) / size
        mapped = [
            np.interp(share[..., k], self.knots, self.values[k])
            + share[..., k]
            - np.clip(share[..., k], 0.0, 1.0)
            for k in range(3)
        ]
        return self.low + np.stack(mapped, axis=-1) * size


def with_other_shares(spec: ObjectSpec, rng: np.random.Generator, axes: int = 3) -> ObjectSpec:
    """Return an object in nearly the same box with other positions and sizes of its parts.

    Boxes and shapes extruded along an axis are resized, walls keep their thickness, other shapes
    are moved. Joint axes move along.
    """
    at = Shares(spec, rng, axes)
    point = lambda pos: tuple(at(np.array(pos)).tolist())
    parts = tuple(
        part.model_copy(update={"geoms": tuple(_mapped(geom, at) for geom in part.geoms)})
        for part in spec.parts
    )
    joints = tuple(
        joint.model_copy(update={"pos": point(joint.pos), "intent": None}) for joint in spec.joints
    )
    sites = tuple(site.model_copy(update={"pos": point(site.pos)}) for site in spec.sites)
    return spec.model_copy(update={"parts": parts, "joints": joints, "sites": sites})


def _mapped(geom: GeomSpec, at: Shares) -> GeomSpec:
    shape, turn = geom.shape.model_dump(), matrix(geom.quat)
    axes = np.abs(turn)
    pos = np.array(geom.pos)
    if np.minimum(axes, np.abs(1 - axes)).max() > ALIGNED:
        return geom.model_copy(update={"pos": tuple(at(pos).tolist())})
    own = _sides(shape)
    half = np.round(axes) @ own / 2
    ends = at(np.stack([pos - half, pos + half]))
    size = np.round(axes).T @ (ends[1] - ends[0])
    # Along axes in which the shape cannot grow its middle moves, alone.
    middle = np.where(half > 0, ends.mean(axis=0), at(pos))
    if "size" in shape:
        shape["size"] = tuple(size.tolist())
    elif own[2] > 0:
        shape["height"] = float(size[2])
    return GeomSpec.model_validate(
        geom.model_dump() | {"shape": shape, "pos": tuple(middle.tolist())}
    )


def _sides(shape: Mapping[str, object]) -> Float[np.ndarray, " 3"]:
    """Return the edges of a shape that the map may change [m]; 0 for others."""
    if "size" in shape:
        return np.array(shape["size"], float)
    if "height" in shape and shape["type"] in ("cylinder", "prism", "extrusion"):
        return np.array([0.0, 0.0, shape["height"]], float)
    return np.zeros(3)
