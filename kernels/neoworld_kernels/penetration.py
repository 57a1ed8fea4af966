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


def signed_distance(kind: str, x: Float[Array, "*batch 3"], piece: Group) -> Float[Array, "*batch"]:
    """Signed distance [m] from points in a piece's frame, negative inside.

    Exact for boxes, capsules and cylinders; first order in the distance for ellipsoids; for
    polytopes the largest plane distance, which is exact inside and a lower bound outside.

    Args:
        kind: a field name of `Solids`.
        x: points [m].
        piece: one row of the group, without the leading axis.
    """
    size = piece.size
    if kind == "box":
        q = jnp.abs(x) - size
        return _norm(jnp.maximum(q, 0.0)) + jnp.minimum(jnp.max(q, axis=-1), 0.0)
    if kind == "capsule":
        z = x[..., 2] - jnp.clip(x[..., 2], -size[1], size[1])
        return _norm(jnp.stack([x[..., 0], x[..., 1], z], axis=-1)) - size[0]
    if kind == "cylinder":
        side = _norm(x[..., :2]) - size[0]
        end = jnp.abs(x[..., 2]) - size[1]
        outside = _norm(jnp.stack([jnp.maximum(side, 0.0), jnp.maximum(end, 0.0)], axis=-1))
        return outside + jnp.minimum(jnp.maximum(side, end), 0.0)
    if kind == "ellipsoid":
        near, steep = _norm(x / size), _norm(x / size**2)
        return jnp.where(
            steep > 1e-9, near * (near - 1.0) / jnp.maximum(steep, 1e-9), -jnp.min(size)
        )
    if kind == "polytope":
        # Unrolled over faces, so that XLA fuses it into one pass over the points.
        a, b, c = x[..., 0], x[..., 1], x[..., 2]
        distance = jnp.full(a.shape, -1e6, x.dtype)
        for n in piece.planes:
            distance = jnp.maximum(distance, n[0] * a + n[1] * b + n[2] * c - n[3])
        return distance
    raise ValueError(f"kind must be one of {', '.join(Solids._fields)}, got {kind!r}")


def _norm(v: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    # The gradient of a norm at zero is taken as zero instead of NaN.
    square = jnp.sum(v * v, axis=-1)
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
    count = pos.shape[1]
    points = jnp.einsum("poij,osj->posi", rot, samples) * scale[:, :, None, None]
    points = points + pos[:, :, None, :]
    depth = jnp.zeros((pos.shape[0], count, count), pos.dtype)
    for kind, group in zip(Solids._fields, solids, strict=True):
        if group.owner.shape[0] == 0:
            continue

        def deepest(piece: Group, kind: str = kind) -> Float[Array, "pop object"]:
            o = piece.owner
            # World to piece: undo the owner's pose and scale, then the piece's own pose.
            turn = rot[:, o] @ piece.rot
            at = pos[:, o] + scale[:, o, None] * (rot[:, o] @ piece.pos)
            turn, at, size = turn[:, None, None], at[:, None, None], scale[:, o, None, None]
            d = points - at
            local = jnp.stack(
                [
                    (
                        d[..., 0] * turn[..., 0, k]
                        + d[..., 1] * turn[..., 1, k]
                        + d[..., 2] * turn[..., 2, k]
                    )
                    / size
                    for k in range(3)
                ],
                axis=-1,
            )
            inside = -signed_distance(kind, local, piece) * size
            return jnp.maximum(jnp.max(inside, axis=-1), 0.0)

        found = jax.lax.map(deepest, group)
        depth = depth.at[:, :, group.owner].max(jnp.moveaxis(found, 0, -1))
    return depth * (1.0 - jnp.eye(count, dtype=pos.dtype))


def pair_depth(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    solids: Solids,
) -> Float[Array, "pop object object"]:
    """Compute pairwise depths with the fastest implementation for this device; see the reference."""
    return pair_depth_reference(pos, rot, scale, samples, solids)
