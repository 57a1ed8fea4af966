"""Geometric S_sem: agreement of the placed poses with the relations in the photograph.

S_sem is the mean of the paper's four criteria (Appendix B). They compare the visible regions of a
candidate in the parsed camera, without occluded parts and parts outside the image, with the parsed
2D boxes and depths. Relations are scored for pairs of objects. Orientation is also scored by the
agreement of each object's box, the only evidence about its heading, and depth order also by whether
an object that the photograph shows whole is cut or occluded. Errors within the noise of a parse
count little, but the score is strictly monotonic, so that candidates can be ranked.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..physics.array_types import AnyArray
from ..physics.scene_arrays import SceneArrays
from ..physics.visibility import Visible

NOISE = 0.02
"""Parse noise, as a fraction of a size, depth or direction; smaller errors cost little."""
SIZE_TOLERANCE = 0.4
"""Difference of log size ratios at which the relative-size score is zero."""
TURN_TOLERANCE = np.radians(45.0)
"""Difference of direction at which a pair's orientation score is zero."""
BOX_TOLERANCE = 0.25
"""Mean distance of box edges, over the box's size, at which a box's score is zero."""
SEEN_DEPTH = 0.01
"""Penetration [m] at which an intersection is certainly visible."""


def _extent(boxes: AnyArray) -> Array:
    """Return the square roots of the boxes' areas [px]."""
    sides = jnp.maximum(boxes[..., 2:] - boxes[..., :2], 0.0)
    return jnp.sqrt(sides[..., 0] * sides[..., 1] + 1e-9)


class Semantic(eqx.Module):
    """S_sem of candidates, in [0, 1]."""

    total: Float[Array, " pop"]
    each: Float[Array, "pop object"]
    """Score of each object by the criteria that involve it; 1 for objects that are not judged."""


def semantic_score(
    scene: SceneArrays, depths: Float[Array, "pop object object"], visible: Visible
) -> Semantic:
    """Score candidates in [0, 1]; a scene in which nothing is judged scores 1.

    Args:
        scene: the scene's arrays.
        depths: pairwise penetration [m] of the candidates' objects.
        visible: visible regions of the candidates in the camera image.
    """
    v = scene.photo
    boxes = jnp.where(v.parsed[:, None], visible.boxes, visible.outlines.boxes)
    depth = visible.outlines.depth
    parsed_size, size = _extent(v.boxes), jnp.maximum(_extent(boxes), 1.0)
    edge_error = jnp.mean(jnp.abs(boxes - v.boxes), axis=-1) / parsed_size
    box_score = _score(edge_error, BOX_TOLERANCE)
    cut = jnp.mean(jnp.abs(visible.boxes - visible.outlines.boxes), axis=-1) / parsed_size
    whole_score = jnp.where(v.whole & v.parsed, _score(cut, BOX_TOLERANCE), 1.0)
    single = (box_score + whole_score) / 2
    judged = jnp.sum(v.judged)

    def mean(x: Array) -> Array:
        return jnp.sum(jnp.where(v.judged, x, 0.0), axis=1) / jnp.maximum(judged, 1)

    # Pair criteria are symmetric arrays [candidate, i, j].
    def between(x: AnyArray) -> AnyArray:
        return x[..., :, None] - x[..., None, :]

    # Depth ordering: the parsed difference of depth must keep its sign; near ties may be either.
    parsed = between(v.depth)
    slack = NOISE * (v.depth[:, None] + v.depth) / 2
    order = 0.5 + 0.5 * (jnp.sign(parsed) * between(depth) + slack) / slack
    order = jnp.where(jnp.abs(parsed) < slack, 1.0, jnp.clip(order, 0.0, 1.0))

    # Relative size: log ratio of visible sizes.
    ratio = between(jnp.log(size)) - between(jnp.log(parsed_size))
    relative = _score(ratio, SIZE_TOLERANCE)

    # Relative orientation: direction from one object to the other in the image. Nearly concentric
    # objects have no direction; their offset is compared with their size instead.
    def direction(b: AnyArray) -> list[AnyArray]:
        return [between((b[..., k] + b[..., k + 2]) / 2) for k in range(2)]

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
    separation = jnp.clip(1.0 - overlap / SEEN_DEPTH, 0.0, 1.0)

    # Pairs contribute half of depth order and orientation, single objects the other half.
    pairs = (order / 2 + relative + turn / 2 + separation) / 4
    pair_mask = v.judged[:, None] & v.judged & ~jnp.eye(scene.count, dtype=bool)
    partners = jnp.sum(pair_mask, axis=1)
    sums = jnp.sum(jnp.where(pair_mask, pairs, 0.0), axis=2)
    paired = jnp.sum(partners) > 0
    pair_mean = jnp.sum(sums, axis=1) / jnp.maximum(jnp.sum(partners), 1)
    each = jnp.where(paired, sums / jnp.maximum(partners, 1) + single / 4, single)
    total = jnp.where(
        paired, pair_mean + mean(single) / 4, jnp.where(judged > 0, mean(single), 1.0)
    )
    return Semantic(total, jnp.where(v.judged, each, 1.0))


def _score(error: AnyArray, tolerance: float) -> Array:
    """Map an error to a score: 1 at zero, nearly flat within the noise, 0 from `tolerance` on."""
    rounded = jnp.sqrt(error * error + NOISE * NOISE) - NOISE
    return jnp.clip(1.0 - rounded / (np.hypot(tolerance, NOISE) - NOISE), 0.0, 1.0)
