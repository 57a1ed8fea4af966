"""Cheap depths of points in convex pieces, for the search of the deepest sample.

Depths are approximate outside a piece. Functions take coordinates as separate, broadcastable
arrays.
"""

import math

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array


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
