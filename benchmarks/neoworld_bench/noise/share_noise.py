"""Errors of a program's shares: where shelves, fronts, handles and legs are within an object."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from neoworld_mjx.spec import GeomSpec, ObjectSpec, bounds
from neoworld_mjx.spec.pose import matrix

SHARES = 0.2
"""Standard deviation by which the thirds of an object's sides are off, over the side. Nobody
measured them; what was measured is the Chamfer distance of twelve objects, ten times .139 in the
mean (docs/benchmarks.md, "Objects from pictures"). With this spread it is .129 for cupboards, ovens
and desks, without it .113; the checks of programs refuse much of a larger one."""
KNOTS = 4
"""Points along a side between which errors are interpolated; both ends stay."""
NARROWEST = 0.15
"""Least share of its true length that a third keeps, or the draw is done again."""
AXES = (3, 3, 2, 2, 2, 1, 1, 1)
"""Axes that change, of each try in turn: what three at once break, one may not."""
ALIGNED = 1e-6
"""Largest entry of a rotation matrix, beside the ones, of what stands along the object's axes."""


class Shares:
    """A monotone map of each of an object's axes onto itself, which keeps its bounding box.

    What lies apart along an axis stays apart, what touches goes on
    touching.
    """

    def __init__(self, spec: ObjectSpec, rng: np.random.Generator, axes: int) -> None:
        """Draw a map for an object at rest, of so many of its axes."""
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
    """Return an object in nearly the same box whose parts are elsewhere and of other sizes in it.

    Boxes and what is drawn out along an axis are cut anew, walls keep their thickness; other
    shapes are moved. Axes of joints move along.
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
    """Return the sides of a shape that a map of the axes may change, 0 of others [m]."""
    if "size" in shape:
        return np.array(shape["size"], float)
    if "height" in shape and shape["type"] in ("cylinder", "prism", "extrusion"):
        return np.array([0.0, 0.0, shape["height"]], float)
    return np.zeros(3)
