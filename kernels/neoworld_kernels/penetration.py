"""Deepest penetration of surface samples into convex solids, for a population of poses.

`pair_depth` answers, for every candidate and every ordered pair of objects (i, j), how deep the
deepest surface sample of i lies inside a solid of j. It is a maximum over samples and solids of the
negated signed distance, clipped at zero, and differentiable almost everywhere.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


class Group(NamedTuple):
    """Convex pieces of one kind, in the frames of the objects that own them."""

    owner: Int[Array, " piece"]
    pos: Float[Array, "piece 3"]
    """[m]"""
    rot: Float[Array, "piece 3 3"]
    """Columns are the piece's axes in the object's frame."""
    size: Float[Array, "piece 3"]
    """MuJoCo's geom_size [m]; unused entries are zero."""
    planes: Float[Array, "piece face 4"]
    """Outward half-spaces n.x <= d of polytopes; spare rows are (0, 0, 0, 1e6)."""


class Solids(NamedTuple):
    """All convex pieces of a scene, by kind; a kind that does not occur has zero pieces."""

    box: Group
    capsule: Group
    """Spheres too: capsules of length zero."""
    cylinder: Group
    ellipsoid: Group
    polytope: Group
    sector: Group
    """Polytopes repeated about their frame's z axis: `size[0]` times around, of which the one that
    spans the angles from 0 to 2 pi / size[0] is given. A point is turned into it first."""


def signed_distance(kind: str, x: Float[Array, "*batch 3"], piece: Group) -> Float[Array, "*batch"]:
    """Signed distance [m] from points in a piece's frame, negative inside.

    Exact for boxes, capsules and cylinders; first order in the distance for ellipsoids; for
    polytopes the largest plane distance, which is exact inside and a lower bound outside.

    Args:
        kind: a field name of `Solids`.
        x: points [m].
        piece: one row of the group, without the leading axis.
    """
    return _distance(kind, x[..., 0], x[..., 1], x[..., 2], piece)


def _distance(kind: str, x: Array, y: Array, z: Array, piece: Group) -> Array:
    # In components, so that XLA fuses everything into one pass over the points.
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
        raise ValueError(f"kind must be one of {', '.join(Solids._fields)}, got {kind!r}")
    distance = jnp.full(x.shape, -1e6, x.dtype)
    for n in piece.planes:
        distance = jnp.maximum(distance, n[0] * x + n[1] * y + n[2] * z - n[3])
    return distance


def _norm(*parts: Array) -> Array:
    # The gradient of a norm at zero is taken as zero instead of NaN.
    square = sum(v * v for v in parts)
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def pair_depth_reference(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    solids: Solids,
) -> Float[Array, "pop object object"]:
    """Compute the depth [m] of i's samples in j's solids, at [candidate, i, j], in plain jnp.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m]; repeat a point to pad.
        solids: convex pieces in object frames at scale 1.

    Returns:
        Depths, zero where nothing penetrates; the diagonal is zero.
    """
    pop, count = scale.shape
    # Candidates last: the maximum over samples then runs along vectors of candidates.
    pos, rot, scale = jnp.moveaxis(pos, 0, -1), jnp.moveaxis(rot, 0, -1), scale.T
    at = jnp.swapaxes(samples, 0, 1)[..., None]
    points = [
        sum(rot[None, :, i, j] * at[:, :, j] for j in range(3)) * scale + pos[None, :, i]
        for i in range(3)
    ]
    depth = jnp.zeros((count, count, pop), pos.dtype)
    for kind, group in zip(Solids._fields, solids, strict=True):
        if group.owner.shape[0] == 0:
            continue

        def deepest(piece: Group, kind: str = kind) -> Float[Array, "object pop"]:
            o = piece.owner
            # World to piece: undo the owner's pose and scale, then the piece's own pose.
            turn = jnp.einsum("ijp,jk->ikp", rot[o], piece.rot)
            origin = pos[o] + scale[o] * jnp.einsum("ijp,j->ip", rot[o], piece.pos)
            d = [points[i] - origin[i] for i in range(3)]
            local = [sum(d[i] * turn[i, k] for i in range(3)) / scale[o] for k in range(3)]
            inside = -_distance(kind, local[0], local[1], local[2], piece)
            return jnp.maximum(jnp.max(inside, axis=0) * scale[o], 0.0)

        found = jax.lax.map(deepest, group)
        depth = depth.at[:, group.owner].max(jnp.moveaxis(found, 0, 1))
    apart = 1.0 - jnp.eye(count, dtype=pos.dtype)
    return jnp.moveaxis(depth, -1, 0) * apart


def pair_depth(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    solids: Solids,
) -> Float[Array, "pop object object"]:
    """Compute pairwise depths with the fastest implementation for this device; see the reference."""
    return pair_depth_reference(pos, rot, scale, samples, solids)
