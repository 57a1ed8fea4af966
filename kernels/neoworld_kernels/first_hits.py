"""First hits of camera rays on convex pieces, for a population of poses: a z-buffer without pixels.

The inverse depth at which a ray crosses a plane is linear in the ray's image position. A ray hits a
convex polytope if the minimum over planes that face the camera exceeds the maximum over all other
planes. The minimum is then the inverse depth of the hit. A quadric adds bounds that contain a
square root.

A piece is tested against a block of rays only if the image boxes of both overlap in some candidate.
Loops run only over pieces that are near at run time, so padding costs almost nothing.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .convex_pieces import SPARE, Colliders, ObjectPoses, PieceGroup, dot, true_indices

UNROLL = 4
"""Number of planes that are evaluated per pass over the rays of a block."""
MAX_INVERSE_DEPTH = 1e5
"""Inverse depth of a hit [1/m] from which the camera counts as inside the piece. Such a piece
occludes nothing."""
MIN_DEPTH = 1e-2
"""Depth [m] below which a bounding box counts as filling the image."""


class Rays(NamedTuple):
    """Rays through the points (x, y, 1) in the camera's frame (right, down, forward), in blocks."""

    x: Float[Array, "block ray pop"]
    y: Float[Array, "block ray pop"]


class ConvexRows(NamedTuple):
    """Pieces that are defined by planes alone, or by planes and a quadric."""

    owner: Int[Array, " row"]
    pos: Float[Array, "row 3"]
    rot: Float[Array, "row 3 3"]
    extent: Float[Array, "row 2 3"]
    planes: Float[Array, "row face 4"]
    weights: Float[Array, "row 3"]
    """Coefficients w of the quadric w.x^2 <= 1, where x^2 are squared coordinates; 0 if none."""
    repeats: Float[Array, " row"]
    """Number of repeats about the z axis of the piece's frame."""
    used: Bool[Array, " row"]


def flat_rows(colliders: Colliders) -> ConvexRows:
    """Return the pieces defined by planes: boxes, polytopes and repeated polytopes."""
    box, groups = colliders.box, (colliders.polytope, colliders.sector)
    width = max(6, *(g.planes.shape[1] for g in groups))
    width += -width % UNROLL
    spare = np.array([0.0, 0.0, 0.0, SPARE], np.float32)
    fill = lambda planes: jnp.concatenate(
        [planes, jnp.broadcast_to(spare, (len(planes), width - planes.shape[1], 4))], axis=1
    )
    normals = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    box_planes = jnp.concatenate(
        [
            jnp.broadcast_to(normals, (len(box.owner), 6, 3)),
            jnp.tile(box.size, (1, 2))[..., None],
        ],
        axis=-1,
    )
    join = lambda leaf: jnp.concatenate([getattr(g, leaf) for g in (box, *groups)])
    extent = join("extent")
    single = jnp.ones(len(box.owner) + len(colliders.polytope.owner))
    return ConvexRows(
        join("owner"),
        join("pos"),
        join("rot"),
        extent,
        jnp.concatenate([fill(box_planes), *(fill(g.planes) for g in groups)]),
        jnp.zeros_like(extent[:, 0]),
        jnp.concatenate([single, colliders.sector.size[:, 0]]),
        jnp.all(extent[:, 1] > extent[:, 0], axis=1),
    )


def round_rows(colliders: Colliders) -> ConvexRows:
    """Return the pieces defined by quadrics. A capsule becomes a cylinder and two spheres."""
    capsule, cylinder, ellipsoid = colliders.capsule, colliders.cylinder, colliders.ellipsoid
    long = capsule.size[:, 1] > 0
    parts = []

    def add(
        group: PieceGroup,
        weights: Array,
        half: Array | float,
        shift: Array | float = 0.0,
        used: Array | bool = True,
        extent: Array | None = None,
    ) -> None:
        real = jnp.all(group.extent[:, 1] > group.extent[:, 0], axis=1)
        pos = group.pos + group.rot[..., 2] * jnp.reshape(shift, (-1, 1))
        extent = group.extent if extent is None else extent
        half = half + jnp.zeros(len(group.owner))
        parts.append((group.owner, pos, group.rot, extent, weights, half, real & used))

    squared = lambda r: 1.0 / jnp.maximum(r, 1e-6) ** 2
    for group in (cylinder, capsule):
        w = squared(group.size[:, 0])
        used = long if group is capsule else True
        add(group, jnp.stack([w, w, 0 * w], axis=-1), group.size[:, 1], used=used)
    ball = squared(capsule.size[:, :1]) * jnp.ones(3)
    reach = capsule.size[:, :1, None] * np.array([[-1.0], [1.0]], np.float32) * jnp.ones(3)
    add(capsule, ball, SPARE, capsule.size[:, 1], True, reach)
    add(capsule, ball, SPARE, -capsule.size[:, 1], long, reach)
    add(ellipsoid, squared(ellipsoid.size), SPARE)
    owner, pos, rot, extent, weights, half, used = map(jnp.concatenate, zip(*parts, strict=True))
    count = len(owner)
    up = jnp.tile(np.array([0.0, 0.0, 1.0], np.float32), (count, 1))
    faces = jnp.stack(
        [
            jnp.concatenate([up, half[:, None]], axis=1),
            jnp.concatenate([-up, half[:, None]], axis=1),
        ],
        axis=1,
    )
    spare = np.array([0.0, 0.0, 0.0, SPARE], np.float32)
    planes = jnp.concatenate([faces, jnp.broadcast_to(spare, (count, UNROLL - 2, 4))], axis=1)
    return ConvexRows(owner, pos, rot, extent, planes, weights, jnp.ones(count), used)


def image_boxes(
    placed: ObjectPoses, owner: Array, pos: Array, rot: Array, extent: Array
) -> Float[Array, "row 5 pop"]:
    """Return the image box and the greatest inverse depth of each row's bounding box.

    Args:
        placed: objects in the camera's frame.
        owner: object of each row.
        pos: position of each row in its object's frame [m].
        rot: rotation of each row in its object's frame.
        extent: corners of each row's bounding box [m].

    Returns:
        left, top, right, bottom at depth 1, and the inverse depth of the nearest corner [1/m]. The
        image box of a bounding box that reaches the camera's plane is infinite.
    """
    # Coordinates first: [3, corner, row, pop].
    object_rot = jnp.transpose(placed.rot[owner], (1, 2, 0, 3))
    size = placed.scale[owner]
    unit = np.array([*np.ndindex(2, 2, 2)], np.float32).T[..., None, None]
    low, high = (extent[:, k].T[:, None, :, None] for k in range(2))
    local = low + unit * (high - low)
    at = _matvec(jnp.transpose(rot, (1, 2, 0))[..., None, :, None], local) + pos.T[:, None, :, None]
    at = _matvec(object_rot[:, :, None], at) * size + placed.pos[owner].swapaxes(0, 1)[:, None]
    nearest_depth = jnp.min(at[2], axis=0)
    sides = at[:2] / jnp.maximum(at[2], MIN_DEPTH)
    fills_image = nearest_depth <= MIN_DEPTH
    return jnp.concatenate(
        [
            jnp.where(fills_image, -jnp.inf, jnp.min(sides, axis=1)),
            jnp.where(fills_image, jnp.inf, jnp.max(sides, axis=1)),
            1.0 / jnp.maximum(nearest_depth, MIN_DEPTH)[None],
        ]
    ).swapaxes(0, 1)


def _matvec(matrix: Array, vectors: Array) -> Array:
    """Multiply matrices [3, 3, ...] by vectors [3, ...], elementwise."""
    return dot([matrix[:, k] for k in range(3)], vectors)


def first_hits(
    placed: ObjectPoses,
    families: list[ConvexRows],
    near: list[Bool[Array, " row"]],
    rays: Rays,
    layer: Int[Array, " object"],
    layers: int,
) -> Float[Array, "layer block ray pop"]:
    """Return the first hits of rays on the objects of each layer.

    Args:
        placed: objects in the camera's frame: right, down, forward.
        families: rows of `flat_rows` and `round_rows`.
        near: for each family, a mask of the rows that are tested.
        rays: the camera rays.
        layer: layer of each object. Layers do not occlude one another.
        layers: number of layers.

    Returns:
        Inverse depths of the nearest surfaces [1/m]; 0 if a ray hits nothing.
    """
    hits = jnp.zeros((layers, *rays.x.shape), jnp.float32)
    bounds = [
        rays.x.min(axis=1),
        rays.y.min(axis=1),
        rays.x.max(axis=1),
        rays.y.max(axis=1),
    ]
    for rows, mask in zip(families, near, strict=True):
        if len(rows.owner):
            curved = rows.planes.shape[1] == UNROLL
            order, number = true_indices(mask)

            def cast(i, hits, rows=rows, order=order, curved=curved):
                return _cast_row(hits, placed, rows, order[i], rays, bounds, layer, curved)

            hits = lax.fori_loop(0, number, cast, hits)
    return hits


def _cast_row(
    hits: Float[Array, "layer block ray pop"],
    placed: ObjectPoses,
    rows: ConvexRows,
    row: Array,
    rays: Rays,
    bounds: list[Array],
    layer: Int[Array, " object"],
    curved: bool,
) -> Float[Array, "layer block ray pop"]:
    owner, pos, rot = rows.owner[row], rows.pos[row], rows.rot[row]
    size = placed.scale[owner]
    planes = rows.planes[row]
    faces = jnp.sum(planes[:, 3] < SPARE / 2)
    low, high = rows.extent[row]
    step = 2 * math.pi / rows.repeats[row]
    if not curved:
        # The box of one wedge, at angles from 0 to `step`, is smaller than the box of all repeats.
        narrow = step <= math.pi / 2
        low = jnp.where(narrow, jnp.maximum(low, jnp.array([0.0, 0.0, -jnp.inf])), low)
        wedge = high.at[1].multiply(jnp.sin(step))
        high = jnp.where(narrow, jnp.minimum(high, wedge), high)

    def cast_repeat(k: Array | int, hits: Array) -> Array:
        turn = rot
        if not curved:
            c, s = jnp.cos(k * step), jnp.sin(k * step)
            turn = jnp.stack(
                [rot[:, 0] * c + rot[:, 1] * s, rot[:, 1] * c - rot[:, 0] * s, rot[:, 2]], axis=1
            )
        box = image_boxes(placed, owner[None], pos[None], turn[None], jnp.stack([low, high])[None])[
            0
        ]
        touched = (box[0] <= bounds[2]) & (box[2] >= bounds[0])
        touched &= (box[1] <= bounds[3]) & (box[3] >= bounds[1])
        order, number = _true_indices_of_short(jnp.any(touched, axis=1))
        # Camera to piece: the point of a ray at depth t is eye + t * (into @ (x, y, 1)).
        world_to_object = jnp.swapaxes(placed.rot[owner], 0, 1) / size
        to_piece = jnp.sum(turn.T[:, :, None, None] * world_to_object, axis=1)
        eye = -_matvec(to_piece, placed.pos[owner]) - jnp.sum(turn * pos[:, None], axis=0)[:, None]
        table = _bounds_of_planes(planes, to_piece, eye)
        quadric = _quadric(rows.weights[row], to_piece, eye) if curved else table

        def block(i: Array, hits: Array) -> Array:
            b = order[i]
            x, y = rays.x[b], rays.y[b]
            if curved:
                upper, lower = _through_quadric(quadric, x, y)
            else:
                upper, lower = jnp.full_like(x, 2 * MAX_INVERSE_DEPTH), jnp.zeros_like(x)

            def clip_by_planes(j: Array, carry: tuple[Array, ...]) -> tuple[Array, ...]:
                upper, lower, loaded = carry
                for a, d, up, down in loaded:
                    sloped = a * x + d * y
                    upper = jnp.minimum(upper, sloped + up)
                    lower = jnp.maximum(lower, sloped + down)
                return upper, lower, load_planes(j + 1)

            # Load planes one iteration ahead: XLA does not vectorize a loop with a dynamic index.
            load_planes = lambda j: lax.dynamic_slice_in_dim(table, j * UNROLL, UNROLL)
            iterations = -(-faces // UNROLL)
            upper, lower, _ = lax.fori_loop(
                0, iterations, clip_by_planes, (upper, lower, load_planes(0))
            )
            covered = (upper > lower) & (upper < MAX_INVERSE_DEPTH)
            # Read and write the array in one place: otherwise XLA copies it in every iteration.
            nearest = jnp.maximum(hits[layer[owner], b], jnp.where(covered, upper, 0.0))
            return hits.at[layer[owner], b].set(nearest)

        return lax.fori_loop(0, number, block, hits)

    return (
        cast_repeat(0, hits)
        if curved
        else lax.fori_loop(0, rows.repeats[row].astype(jnp.int32), cast_repeat, hits)
    )


def _true_indices_of_short(
    mask: Bool[Array, " block"],
) -> tuple[Int[Array, " block"], Int[Array, ""]]:
    """Compute `true_indices` of a short mask."""
    index = np.arange(mask.shape[0], dtype=np.int32)
    place = jnp.sum((index < index[:, None]) & mask, axis=1, dtype=jnp.int32)
    chosen = (place == index[:, None]) & mask
    return jnp.sum(jnp.where(chosen, index, 0), axis=1), jnp.sum(mask, dtype=jnp.int32)


def _bounds_of_planes(
    planes: Float[Array, "face 4"], turn: Float[Array, "3 3 pop"], eye: Float[Array, "3 pop"]
) -> Float[Array, "face 4 pop"]:
    """Return the bounds that planes impose on the inverse depth of a ray, linear in x and y.

    Columns are the slopes in x and y, the offset of the upper bound and that of the lower bound.
    Planes that face the camera are upper bounds, all others are lower bounds.
    """
    # Sums of products: XLA delegates short reductions to a library that is slow on small arrays.
    *normal, far = planes[:, :, None].swapaxes(0, 1)
    gap = far - dot(normal, eye)
    facing = gap < 0
    gap = jnp.where(jnp.abs(gap) < 1e-9, 1e-9, gap)
    x, y, end = (dot(normal, turn[:, k]) / gap for k in range(3))
    large = 2 * MAX_INVERSE_DEPTH
    up, down = jnp.where(facing, end, large), jnp.where(facing, -large, end)
    return jnp.stack([x, y, up, down], axis=1)


def _quadric(
    weights: Float[Array, " 3"], turn: Float[Array, "3 3 pop"], eye: Float[Array, "3 pop"]
) -> Float[Array, "term pop"]:
    """Return the coefficients of `_through_quadric`."""
    w = weights[:, None]
    e = jnp.sum(w * eye * eye, axis=0) - 1.0
    f = jnp.sum((w * eye)[:, None] * turn, axis=0)
    g = jnp.sum((w[:, None] * turn)[:, :, None] * turn[:, None], axis=0)
    safe = jnp.where(jnp.abs(e) < 1e-9, 1e-9, e)
    # The quadratic e u^2 + 2 f u + g <= 0 in the inverse depth u, divided by e.
    return jnp.concatenate([f / safe, g.reshape(9, -1) / safe, safe[None]])


def _through_quadric(quadric: Array, x: Array, y: Array) -> tuple[Array, Array]:
    fx, fy, f0, xx, xy, x0, _, yy, y0, _, _, gg, e = quadric
    outside = e > 0
    f = fx * x + fy * y + f0
    g = (xx * x + 2.0 * (xy * y + x0)) * x + (yy * y + 2.0 * y0) * y + gg
    square = f * f - g
    root = jnp.sqrt(jnp.maximum(square, 0.0))
    missed = square <= 0.0
    large = 2 * MAX_INVERSE_DEPTH
    # From inside an infinite cylinder, the ray leaves through the side.
    upper = jnp.where(missed, -large, jnp.where(outside, root - f, large))
    return upper, jnp.where(outside, -f - root, root - f)
