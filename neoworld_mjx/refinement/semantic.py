"""S_sem by geometry: agreement of the composed poses with the photograph's relations.

S_sem is the mean of the paper's four criteria (Appendix B). They compare what a candidate would
show through the parsed camera, hidden parts and the picture's border left out, with the parsed 2D
boxes and depths. Relations are scored by pairs of objects; orientation also by how each object
fills its own box, since that is all that a box says about a heading, and depth order also by
whether an object is cut or hidden that the photograph shows whole. Errors within the noise of a
parse count little, but no two are the same, so that candidates can be ranked.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.array_types import AnyArray
from ..physics.layout import Poses
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import Outlines, Visible, outlines

NOISE = 0.02
"""Error of a parse, as a share of a size, a depth or a direction, within which little is lost."""
SIZE_TOLERANCE = 0.4
"""Difference of log size ratios at which the relative-size score is zero."""
TURN_TOLERANCE = np.radians(45.0)
"""Difference of direction at which a pair's orientation score is zero."""
BOX_TOLERANCE = 0.25
"""Mean distance of box edges, over the box's size, at which a box's score is zero."""
SEEN_DEPTH = 0.01
"""Penetration [m] at which an intersection is certainly visible."""
BOX_NOISE_PX, BOX_NOISE = 2.0, 0.02
"""Noise of a parsed box edge: pixels, and a share of the box's size."""


def _extent(boxes: Any, xp: Any = jnp) -> Any:
    """Return the square roots of the boxes' areas [px]."""
    sides = xp.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return xp.sqrt(sides[..., 0] * sides[..., 1] + 1e-9)


class Semantic(eqx.Module):
    """S_sem of candidates, in [0, 1]."""

    total: Float[Array, " pop"]
    each: Float[Array, "pop object"]
    """Score by the criteria that involve an object; 1 for objects that are not judged."""


def semantic_score(
    scene: SceneArrays, depths: Float[Array, "pop object object"], seen: Visible
) -> Semantic:
    """Score candidates in [0, 1]; a scene in which nothing is judged scores 1.

    Args:
        scene: the scene's arrays.
        depths: pairwise penetration [m] of the candidates' objects.
        seen: what the camera sees of the candidates.
    """
    v = scene.photo
    boxes = jnp.where(v.parsed[:, None], seen.boxes, seen.outlines.boxes)
    depth = seen.outlines.depth
    parsed_size, size = _extent(v.boxes), jnp.maximum(_extent(boxes), 1.0)
    own = jnp.mean(jnp.abs(boxes - v.boxes), axis=-1) / parsed_size
    filled = _score(own, BOX_TOLERANCE)
    lost = jnp.mean(jnp.abs(seen.boxes - seen.outlines.boxes), axis=-1) / parsed_size
    shown = jnp.where(v.whole & v.parsed, _score(lost, BOX_TOLERANCE), 1.0)
    alone = (filled + shown) / 2
    judged = jnp.sum(v.judged)
    mean = lambda x: jnp.sum(jnp.where(v.judged, x, 0.0), axis=1) / jnp.maximum(judged, 1)

    # All criteria of a pair are at [candidate, i, j] and symmetric.
    between = lambda x: x[..., :, None] - x[..., None, :]
    # Depth ordering: the parsed difference of depth must keep its sign; near ties may be either.
    parsed = between(v.depth)
    slack = NOISE * (v.depth[:, None] + v.depth) / 2
    order = 0.5 + 0.5 * (jnp.sign(parsed) * between(depth) + slack) / slack
    order = jnp.where(jnp.abs(parsed) < slack, 1.0, jnp.clip(order, 0.0, 1.0))

    # Relative size: log ratio of visible sizes.
    ratio = between(jnp.log(size)) - between(jnp.log(parsed_size))
    relative = _score(ratio, SIZE_TOLERANCE)

    # Relative orientation: direction from one object to the other in the picture. Objects drawn
    # almost concentrically have no direction; their offset is compared with their size instead.
    way = lambda b: [between((b[..., k] + b[..., k + 2]) / 2) for k in range(2)]
    length = lambda x, y: jnp.sqrt(x * x + y * y)
    parsed_way, own_way = way(v.boxes), way(boxes)
    reach = jnp.maximum(length(*parsed_way), 0.5 * jnp.maximum(parsed_size[:, None], parsed_size))
    off = length(*(a - b for a, b in zip(own_way, parsed_way, strict=True))) / reach
    turn = _score(2.0 * jnp.arcsin(jnp.minimum(off / 2, 1.0)), TURN_TOLERANCE)

    hidden = jnp.maximum(depths, jnp.swapaxes(depths, 1, 2))
    apart = jnp.clip(1.0 - hidden / SEEN_DEPTH, 0.0, 1.0)

    # Pairs decide half of depth order and orientation, each object alone the other half.
    pairs = (order / 2 + relative + turn / 2 + apart) / 4
    both = v.judged[:, None] & v.judged & ~jnp.eye(scene.count, dtype=bool)
    partners = jnp.sum(both, axis=1)
    sums = jnp.sum(jnp.where(both, pairs, 0.0), axis=2)
    paired = jnp.sum(partners) > 0
    of_pairs = jnp.sum(sums, axis=1) / jnp.maximum(jnp.sum(partners), 1)
    each = jnp.where(paired, sums / jnp.maximum(partners, 1) + alone / 4, alone)
    total = jnp.where(paired, of_pairs + mean(alone) / 4, jnp.where(judged > 0, mean(alone), 1.0))
    return Semantic(total, jnp.where(v.judged, each, 1.0))


def _score(error: Array, tolerance: float) -> Array:
    """Return 1 for no error and 0 from `tolerance` on; flat at 1 over the noise of a parse."""
    rounded = jnp.sqrt(error * error + NOISE * NOISE) - NOISE
    return jnp.clip(1.0 - rounded / (np.hypot(tolerance, NOISE) - NOISE), 0.0, 1.0)


def reprojection_error(scene: SceneArrays, poses: Poses) -> Float[AnyArray, " pop"]:
    """Return the squared distance of projected boxes from the photograph's, in units of its noise.

    Differentiable; beyond three units it grows linearly (Huber), as a parsed box may be plainly
    wrong. Only sides count that the photograph shows: see `PhotoView.sides`.
    """
    return boxes_off(scene, outlines(scene, poses))


def boxes_off(scene: SceneArrays, shown: Outlines, xp: Any = jnp) -> Float[AnyArray, " pop"]:
    """Return `reprojection_error` of known outlines; `xp` is `numpy` on the host."""
    off = xp.abs(_box_sides(scene, shown, xp))
    huber = xp.where(off < 3.0, off**2 / 2, 3.0 * (off - 1.5))
    return xp.sum(huber, axis=(1, 2))


def box_error(scene: SceneArrays, shown: Outlines) -> Float[Array, "pop object"]:
    """Return how far the worst visible side of each object's box is off the photograph's.

    In units of the noise of a parsed box; zero for objects that are not judged, or of whose sides
    the photograph shows none.
    """
    return jnp.max(jnp.abs(_box_sides(scene, shown)), axis=-1)


def _box_sides(
    scene: SceneArrays, shown: Outlines, xp: Any = jnp
) -> Float[AnyArray, "pop object 4"]:
    v = scene.photo
    boxes, sides, judged = (xp.asarray(x) for x in (v.boxes, v.sides, v.judged))
    off = xp.asarray(shown.boxes) - boxes
    off = off / (BOX_NOISE_PX + BOX_NOISE * _extent(boxes, xp)[:, None])
    return xp.where(sides & judged[:, None], off, 0.0)
