"""Geometric S_sem: agreement of the placed poses with the relations of objects in the photograph.

S_sem is the mean of the paper's four criteria (Appendix B). They compare a candidate, seen through
the parsed camera, with the parsed 2D boxes and depths. Only visible parts count: neither occluded
parts nor parts outside the image.

All criteria score relations of pairs of objects. Two of them also score single objects:

- Orientation scores how well the box of each object agrees with the parsed box, which is the only
  evidence about the heading of an object.
- Depth order scores whether an object that is entirely visible in the photograph is occluded or cut
  by the border of the image.

Errors below the noise of a parse lower the score only slightly. The score is strictly monotonic
nevertheless, so that candidates can be ranked.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.array_types import AnyArray
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import Visible

NOISE = 0.02
"""Noise of a parse, as a fraction of a size, depth or direction. Smaller errors cost little."""
SIZE_TOLERANCE = 0.4
"""Difference between log size ratios at which the relative-size score of a pair is zero."""
TURN_TOLERANCE = np.radians(45.0)
"""Difference between directions [rad] at which the orientation score of a pair is zero."""
BOX_TOLERANCE = 0.25
"""Mean distance of box edges, relative to the size of the box, at which its score is zero."""
VISIBLE_DEPTH = 0.01
"""Penetration depth [m] at which an intersection is certainly visible."""


def _extent(boxes: AnyArray) -> Array:
    """Return the square root of the area of each box [px]."""
    sides = jnp.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return jnp.sqrt(sides[..., 0] * sides[..., 1] + 1e-9)


def semantic_score(
    scene: SceneArrays, depths: Float[AnyArray, "pop object object"], visible: Visible
) -> Float[Array, " pop"]:
    """Return S_sem of candidates in [0, 1]. If no object of the scene is scored, S_sem is 1.

    Args:
        scene: the scene's arrays.
        depths: penetration depths of pairs of objects [m].
        visible: visible parts of the objects in the camera image.
    """
    v = scene.photo
    boxes = jnp.where(v.parsed[:, None], visible.boxes, visible.outlines.boxes)
    depth = visible.outlines.depth
    parsed_size, size = _extent(v.boxes), jnp.maximum(_extent(boxes), 1.0)
    edge_error = jnp.mean(jnp.abs(boxes - v.boxes), axis=-1) / parsed_size
    box_score = _score(edge_error, BOX_TOLERANCE)
    hidden = jnp.mean(jnp.abs(visible.boxes - visible.outlines.boxes), axis=-1) / parsed_size
    full_visibility_score = jnp.where(
        v.fully_visible & v.parsed, _score(hidden, BOX_TOLERANCE), 1.0
    )
    single = (box_score + full_visibility_score) / 2
    scored_count = jnp.sum(v.scored)

    # Pair criteria are symmetric arrays [candidate, i, j].
    def pairwise_difference(x: AnyArray) -> AnyArray:
        return x[..., :, None] - x[..., None, :]

    # Depth ordering: the difference of two depths must have the sign of the parsed difference. If
    # the parsed depths are nearly equal, either sign is accepted.
    parsed = pairwise_difference(v.depth)
    slack = NOISE * (v.depth[:, None] + v.depth) / 2
    order = 0.5 + 0.5 * (jnp.sign(parsed) * pairwise_difference(depth) + slack) / slack
    order = jnp.where(jnp.abs(parsed) < slack, 1.0, jnp.clip(order, 0.0, 1.0))

    # Relative size: log ratio of the visible sizes.
    ratio = pairwise_difference(jnp.log(size)) - pairwise_difference(jnp.log(parsed_size))
    relative = _score(ratio, SIZE_TOLERANCE)

    # Relative orientation: direction from one object to the other in the image. The direction
    # between nearly concentric objects is undefined; their offset is compared with their size.
    def direction(b: AnyArray) -> list[AnyArray]:
        return [pairwise_difference((b[..., k] + b[..., k + 2]) / 2) for k in range(2)]

    def length(x: AnyArray, y: AnyArray) -> Array:
        return jnp.sqrt(x * x + y * y)

    parsed_direction, image_direction = direction(v.boxes), direction(boxes)
    reach = jnp.maximum(
        length(*parsed_direction), 0.5 * jnp.maximum(parsed_size[:, None], parsed_size)
    )
    deviation = (
        length(*(a - b for a, b in zip(image_direction, parsed_direction, strict=True))) / reach
    )
    turn = _score(2.0 * jnp.arcsin(jnp.minimum(deviation / 2, 1.0)), TURN_TOLERANCE)

    overlap = jnp.maximum(depths, jnp.swapaxes(depths, 1, 2))
    separation = jnp.clip(1.0 - overlap / VISIBLE_DEPTH, 0.0, 1.0)

    # Half of the scores of depth order and orientation comes from pairs, the other half from single
    # objects.
    pairs = (order / 2 + relative + turn / 2 + separation) / 4
    pair_mask = v.scored[:, None] & v.scored & ~jnp.eye(scene.count, dtype=bool)
    pair_count = jnp.sum(pair_mask)
    pair_mean = jnp.sum(jnp.where(pair_mask, pairs, 0.0), axis=(1, 2)) / jnp.maximum(pair_count, 1)
    mean = jnp.sum(jnp.where(v.scored, single, 0.0), axis=1) / jnp.maximum(scored_count, 1)
    return jnp.where(pair_count > 0, pair_mean + mean / 4, jnp.where(scored_count > 0, mean, 1.0))


def _score(error: AnyArray, tolerance: float) -> Array:
    """Map an error to a score: 1 at zero, nearly flat below the noise, 0 from `tolerance` on."""
    rounded = jnp.sqrt(error * error + NOISE * NOISE) - NOISE
    return jnp.clip(1.0 - rounded / (np.hypot(tolerance, NOISE) - NOISE), 0.0, 1.0)
