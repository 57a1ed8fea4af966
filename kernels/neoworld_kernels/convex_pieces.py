"""Convex colliders of a scene as arrays, by kind, and the signed distance to them in plain jnp.

The search of the deepest sample uses `coarse_depth`, which is cheaper, and approximate outside a
piece. It takes coordinates as separate, broadcastable arrays.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

SPARE = 1e6
"""Offset of a half-space that pads a table of planes and contains every point [m]."""


class PieceGroup(NamedTuple):
    """Convex pieces of one kind, each in the frame of the object that it belongs to."""

    owner: Int[Array, " piece"]
    """Index of the object that each piece belongs to."""
    pos: Float[Array, "piece 3"]
    """[m]"""
    rot: Float[Array, "piece 3 3"]
    """Columns are the piece's axes in the object's frame."""
    size: Float[Array, "piece 3"]
    """MuJoCo's geom_size [m]; unused entries are zero."""
    planes: Float[Array, "piece face 4"]
    """Half-spaces n.x <= d of polytopes, with outward normals n. Rows that pad the table are last
    and equal (0, 0, 0, SPARE)."""
    extent: Float[Array, "piece 2 3"]
    """Lowest and highest corner of each piece's bounding box, in the piece's frame [m]."""


class Colliders(NamedTuple):
    """All convex pieces of a scene, by kind. A kind that does not occur has zero pieces."""

    box: PieceGroup
    capsule: PieceGroup
    """Includes spheres, as capsules of length zero."""
    cylinder: PieceGroup
    ellipsoid: PieceGroup
    polytope: PieceGroup
    sector: PieceGroup
    """Polytopes that are repeated `size[0]` times about the z axis of their frame. Only the repeat
    at angles from 0 to 2 pi / size[0] is stored, and its halves are mirror images. Points are
    rotated into this range of angles before their distance is computed."""


class ObjectPoses(NamedTuple):
    """Poses of all objects of all candidates; the population is last, for vectorization."""

    pos: Float[Array, "object 3 pop"]
    rot: Float[Array, "object 3 3 pop"]
    scale: Float[Array, "object pop"]


def distance(kind: str, x: Array, y: Array, z: Array, piece: PieceGroup) -> Array:
    """Return the signed distance of points to a piece [m], negative inside.

    Distances to boxes, capsules and cylinders are exact. Distances to ellipsoids are accurate to
    first order. For polytopes and sectors, the result is the largest signed distance to a plane,
    which is exact inside and a lower bound outside. The coordinates are separate, because XLA then
    fuses the computation into one pass.

    Args:
        kind: a field name of `Colliders`.
        x: coordinates of the points in the piece's frame [m]; y and z likewise.
        y: see x.
        z: see x.
        piece: one piece of a group, without the leading axis.
    """
    size = piece.size
    if kind == "box":
        a, b, c = jnp.abs(x) - size[0], jnp.abs(y) - size[1], jnp.abs(z) - size[2]
        outside = _norm(jnp.maximum(a, 0.0), jnp.maximum(b, 0.0), jnp.maximum(c, 0.0))
        return outside + jnp.minimum(jnp.maximum(a, jnp.maximum(b, c)), 0.0)
    if kind == "capsule":
        return _norm(x, y, z - jnp.clip(z, -size[1], size[1])) - size[0]
    if kind == "cylinder":
        side, end = _norm(x, y) - size[0], jnp.abs(z) - size[1]
        outside = _norm(jnp.maximum(side, 0.0), jnp.maximum(end, 0.0))
        return outside + jnp.minimum(jnp.maximum(side, end), 0.0)
    if kind == "ellipsoid":
        near = _norm(x / size[0], y / size[1], z / size[2])
        steep = _norm(x / size[0] ** 2, y / size[1] ** 2, z / size[2] ** 2)
        safe = jnp.maximum(steep, 1e-9)
        return jnp.where(steep > 1e-9, near * (near - 1.0) / safe, -jnp.min(size))
    if kind == "sector":
        step = 2 * jnp.pi / size[0]
        turn = jnp.floor(jnp.arctan2(y, x) / step) * step
        c, s = jnp.cos(turn), jnp.sin(turn)
        x, y = c * x + s * y, c * y - s * x
    elif kind != "polytope":
        raise ValueError(f"kind must be one of {', '.join(Colliders._fields)}, got {kind!r}")
    largest = jnp.full(x.shape, -1e6, x.dtype)
    for n in piece.planes:
        largest = jnp.maximum(largest, n[0] * x + n[1] * y + n[2] * z - n[3])
    return largest


def _norm(*parts: Array) -> Array:
    # The gradient at zero is zero instead of NaN.
    square = sum(v * v for v in parts)
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def pair_gap(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "pop object object"]:
    """Compute the least signed distance of i's samples to j's colliders [m], at [candidate, i, j].

    The distance is negative if i penetrates j. Outside a polytope or sector, it is the largest
    signed distance to a plane, which is at most the true distance. It is inf if j has no colliders,
    and on the diagonal. Differentiable. Arguments are those of `pair_depth`.
    """
    pop, count = scale.shape
    # The population is the last axis, for vectorization of the maximum over samples.
    pos, rot, scale = jnp.moveaxis(pos, 0, -1), jnp.moveaxis(rot, 0, -1), scale.T
    at = jnp.swapaxes(samples, 0, 1)[..., None]
    points = [
        sum(rot[None, :, i, j] * at[:, :, j] for j in range(3)) * scale + pos[None, :, i]
        for i in range(3)
    ]
    depth = jnp.full((count, count, pop), -jnp.inf, pos.dtype)
    for kind, group in zip(Colliders._fields, colliders, strict=True):
        if group.owner.shape[0] == 0:
            continue

        # The gradient recomputes distances: those of all pieces together could exceed the memory.
        @jax.checkpoint
        def deepest(piece: PieceGroup, kind: str = kind) -> Float[Array, "object pop"]:
            o = piece.owner
            # World to piece: invert the owner's pose and scale, then the piece's pose.
            turn = [[dot(rot[o, i], piece.rot[:, k]) for k in range(3)] for i in range(3)]
            origin = [pos[o, i] + scale[o] * dot(rot[o, i], piece.pos) for i in range(3)]
            d = [points[i] - origin[i] for i in range(3)]
            local = [sum(d[i] * turn[i][k] for i in range(3)) / scale[o] for k in range(3)]
            inside = -distance(kind, local[0], local[1], local[2], piece)
            return jnp.max(inside, axis=0) * scale[o]

        depths = jax.lax.map(deepest, group)
        depth = depth.at[:, group.owner].max(jnp.moveaxis(depths, 0, 1))
    diagonal = jnp.eye(count, dtype=bool)
    return jnp.where(diagonal, jnp.inf, -jnp.moveaxis(depth, -1, 0))


def pair_depth_reference(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "pop object object"]:
    """Compute `pair_depth` in plain jnp."""
    return jnp.maximum(-pair_gap(pos, rot, scale, samples, colliders), 0.0)


def true_indices(mask: Bool[Array, "*shape"]) -> tuple[Int[Array, " flat"], Int[Array, ""]]:
    """Return the flat indices of the true elements, in order, and the number of true elements."""
    flat = mask.reshape(-1)
    place = jnp.where(flat, jnp.cumsum(flat, dtype=jnp.int32) - 1, flat.size)
    order = jnp.zeros(flat.size, jnp.int32)
    order = order.at[place].set(jnp.arange(flat.size, dtype=jnp.int32), mode="drop")
    return order, jnp.sum(flat, dtype=jnp.int32)


def dot(a: Any, b: Any) -> Array:
    """Return the dot product of two triples of arrays; a matrix product might use TF32."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def coarse_depth(kind: str, x: Array, y: Array, z: Array, size: list[Array]) -> Array:
    """Return the depths of points below the surface of a piece that is defined by its size [m].

    Distances to edges and corners matter only outside and are not computed.

    Args:
        kind: `box`, `capsule`, `cylinder` or `ellipsoid`.
        x: coordinates of the points in the piece's frame [m]; y and z likewise.
        y: see x.
        z: see x.
        size: size of the piece, three arrays [m].
    """
    if kind == "box":
        return jnp.minimum(
            jnp.minimum(size[0] - jnp.abs(x), size[1] - jnp.abs(y)), size[2] - jnp.abs(z)
        )
    if kind == "capsule":
        over = jnp.maximum(jnp.abs(z) - size[1], 0.0)
        return size[0] - _root(x * x + y * y + over * over)
    if kind == "cylinder":
        return jnp.minimum(size[0] - _root(x * x + y * y), size[1] - jnp.abs(z))
    inverse = [1.0 / s for s in size]
    least = jnp.minimum(jnp.minimum(size[0], size[1]), size[2])
    a = [v * w for v, w in zip((x, y, z), inverse, strict=True)]
    near = _root(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    b = [v * w for v, w in zip(a, inverse, strict=True)]
    steep = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    depth = near * (1.0 - near) * lax.rsqrt(jnp.maximum(steep, 1e-18))
    return jnp.where(steep > 1e-18, depth, least)


def fold_into_sector(x: Array, y: Array, times: Array) -> tuple[Array, Array]:
    """Rotate points about z into the sector from 0 to 2 pi / times."""
    inverse = times * (1 / (2 * math.pi))
    # Angles are shifted so that truncation rounds down.
    index = (_angle(y, x) * inverse + times).astype(jnp.int32).astype(jnp.float32) - times
    turn = index * (2 * math.pi / times)
    c, s = jnp.cos(turn), jnp.sin(turn)
    return c * x + s * y, c * y - s * x


def _root(square: Array) -> Array:
    return square * lax.rsqrt(jnp.maximum(square, 1e-24))


def _angle(y: Array, x: Array) -> Array:
    """Compute atan2 to 1e-5 (Abramowitz and Stegun, 4.4.47).

    This accuracy suffices for sectors, since two neighboring sectors have equal depths where they
    meet.
    """
    across, along = jnp.abs(x), jnp.abs(y)
    large = jnp.maximum(jnp.maximum(across, along), 1e-15)
    ratio = jnp.minimum(across, along) * lax.rsqrt(large * large)
    square = ratio * ratio
    angle = square * 0.0208351 - 0.0851330
    for factor in (0.1801410, -0.3302995, 0.9998660):
        angle = angle * square + factor
    angle = angle * ratio
    angle = jnp.where(along > across, math.pi / 2 - angle, angle)
    angle = jnp.where(x < 0.0, math.pi - angle, angle)
    return jnp.where(y < 0.0, -angle, angle)
