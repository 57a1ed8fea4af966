"""Cheap depths of points in convex pieces, for the search of the deepest sample.

Depths are approximate outside a piece. Functions take coordinates as separate, broadcastable arrays
of any shape, so that the Pallas kernel and plain XLA share them. `plane(f, k)` returns component k
of a piece's plane f.
"""

import math
from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

Plane = Callable[[Array, int], Array]


def depths(
    kind: str, local: list[list[Array]], size: list[Array], plane: Plane, faces: int | Array
) -> list[Array]:
    """Return the depths of points below a piece's surface; approximate for points outside.

    Distances to edges and corners matter only outside and are not computed. For a capsule, the
    result is minus the squared distance to the axis; see `to_depth`.

    Args:
        kind: a field name of `Colliders`.
        local: points in the piece's frame, each [x, y, z].
        size: size of the piece, three arrays.
        plane: function that returns a component of one of the piece's planes.
        faces: number of planes of the piece.
    """
    if kind == "box":
        return [
            jnp.minimum(
                jnp.minimum(size[0] - jnp.abs(x), size[1] - jnp.abs(y)), size[2] - jnp.abs(z)
            )
            for x, y, z in local
        ]
    if kind == "capsule":
        values = []
        for x, y, z in local:
            over = jnp.maximum(jnp.abs(z) - size[1], 0.0)
            values.append(-(x * x + y * y + over * over))
        return values
    if kind == "cylinder":
        return [
            jnp.minimum(size[0] - _root(x * x + y * y), size[1] - jnp.abs(z)) for x, y, z in local
        ]
    if kind == "ellipsoid":
        inverse = [1.0 / s for s in size]
        least = jnp.minimum(jnp.minimum(size[0], size[1]), size[2])
        values = []
        for point in local:
            a = [v * w for v, w in zip(point, inverse, strict=True)]
            near = _root(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
            b = [v * w for v, w in zip(a, inverse, strict=True)]
            steep = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
            depth = near * (1.0 - near) * lax.rsqrt(jnp.maximum(steep, 1e-18))
            values.append(jnp.where(steep > 1e-18, depth, least))
        return values
    if kind == "sector":
        local = [[*fold_into_sector(x, y, size[0]), z] for x, y, z in local]

    def clip_by_plane(f: Array, far: tuple[Array, ...]) -> tuple[Array, ...]:
        a, b, c, d = (plane(f, k) for k in range(4))
        return tuple(
            jnp.minimum(value, ((d - a * x) - b * y) - c * z)
            for value, (x, y, z) in zip(far, local, strict=True)
        )

    start = tuple(x * 0.0 + 1e6 for x, _, _ in local)
    return list(lax.fori_loop(0, faces, clip_by_plane, start))


def distance_bound(
    kind: str, point: list[Array], size: list[Array], plane: Plane, faces: int | Array
) -> Array:
    """Return a lower bound of the signed distance to the surface. Its Lipschitz constant is 1."""
    if kind == "capsule":
        return -to_depth(kind, depths(kind, [point], size, plane, faces)[0], size)
    if kind == "ellipsoid":
        x, y, z = (v / s for v, s in zip(point, size, strict=True))
        square = x * x + y * y + z * z
        least = jnp.minimum(jnp.minimum(size[0], size[1]), size[2])
        return least * (_root(square) - 1.0)
    return -depths(kind, [point], size, plane, faces)[0]


def to_depth(kind: str, best: Array, size: list[Array]) -> Array:
    """Convert the largest value that `depths` returned to a depth."""
    return size[0] - _root(-best) if kind == "capsule" else best


def fold_into_sector(x: Array, y: Array, times: Array) -> tuple[Array, Array]:
    """Rotate points about z into the sector from 0 to 2 pi / times."""
    inverse = times * (1 / (2 * math.pi))
    # Mosaic GPU has no floor. Angles are shifted so that truncation rounds down.
    index = (_angle(y, x) * inverse + times).astype(jnp.int32).astype(jnp.float32) - times
    turn = index * (2 * math.pi / times)
    c, s = jnp.cos(turn), jnp.sin(turn)
    return c * x + s * y, c * y - s * x


def _root(square: Array) -> Array:
    return square * lax.rsqrt(jnp.maximum(square, 1e-24))


def _angle(y: Array, x: Array) -> Array:
    """Compute atan2, which Mosaic GPU lacks, to 1e-5 (Abramowitz and Stegun, 4.4.47).

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
