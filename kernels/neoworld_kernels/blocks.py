"""Blocks of neighbouring surface samples, and which of them can touch which pieces.

Arrays have candidates last, so that vectors run along them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt32

from .coarse_distance import bound
from .convex_pieces import Colliders, PieceGroup

WORD = 32
"""Bits that are counted together."""


class ObjectPoses(NamedTuple):
    """Poses of all candidates' objects."""

    pos: Float[Array, "3 object pop"]
    rot: Float[Array, "3 3 object pop"]
    scale: Float[Array, "object pop"]


class Blocks(NamedTuple):
    """Samples of all objects, equally many blocks of each, one object after the other."""

    points: Float[Array, "sample 3 block"]
    which: Int[Array, "sample block"]
    """Where each was among its object's samples."""
    centre: Float[Array, "3 block"]
    radius: Float[Array, " block"]


def dot(a: Array | list[Array], b: Array | list[Array]) -> Array:
    """Multiply threes of arrays elementwise and add up; not a matrix product, which may be TF32."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def sample_blocks(samples: Float[Array, "object sample 3"], size: int) -> Blocks:
    """Halve each object's samples across their longest extent until blocks have at most `size`."""
    count, number, _ = samples.shape
    halvings = (-(-number // size) - 1).bit_length()
    each = -(-number // 2**halvings)
    # What is missing to equal blocks repeats the last sample.
    order = jnp.minimum(jnp.arange(each * 2**halvings, dtype=jnp.int32), number - 1)
    order = jnp.broadcast_to(order, (count, 1, order.size))
    at = lambda order: jnp.take_along_axis(samples[:, None], order[..., None], axis=2)
    for _ in range(halvings):
        points = at(order)
        longest = jnp.argmax(points.max(axis=2) - points.min(axis=2), axis=-1)
        key = jnp.take_along_axis(points, longest[..., None, None], axis=-1)[..., 0]
        order = lax.sort((key, order), num_keys=1)[1].reshape(count, 2 * order.shape[1], -1)
    points = at(order)
    centre = (points.min(axis=2) + points.max(axis=2)) / 2
    radius = jnp.sqrt(jnp.max(jnp.sum((points - centre[:, :, None]) ** 2, axis=-1), axis=2))
    return Blocks(
        points=jnp.transpose(points.reshape(-1, each, 3), (1, 2, 0)),
        which=order.reshape(-1, each).T,
        centre=centre.reshape(-1, 3).T,
        # A hair more, so that rounding never culls what touches.
        radius=radius.reshape(-1) * 1.00001 + 1e-6,
    )


def touching(
    placed: ObjectPoses, blocks: Blocks, colliders: Colliders
) -> Bool[Array, "piece block pop"]:
    """Whether a block's bounding sphere reaches a piece of another object; pieces of all kinds.

    A pose that is not a number touches nothing.
    """
    count = placed.scale.shape[0]
    owner = jnp.repeat(jnp.arange(count), len(blocks.radius) // count)
    rot, scale = placed.rot[:, :, owner], placed.scale[owner]
    centre = [
        dot(rot[k], blocks.centre[..., None]) * scale + placed.pos[k][owner] for k in range(3)
    ]
    reach = blocks.radius[:, None] * scale
    owners = jnp.concatenate([group.owner for group in colliders])
    local = _local(placed, centre, owners, colliders)
    near_enough, first = [], 0
    for kind, group in zip(Colliders._fields, colliders, strict=True):
        if number := len(group.owner):
            here = [x[first : first + number] for x in local]
            near = _near(kind, here, group) * placed.scale[group.owner][:, None]
            near_enough.append(near < reach)
            first += number
    return jnp.concatenate(near_enough) & (owners[:, None] != owner)[..., None]


def _local(
    placed: ObjectPoses,
    centre: list[Array],
    owners: Int[Array, " piece"],
    colliders: Colliders,
) -> list[Float[Array, "piece block pop"]]:
    """Put points [block, pop] in the world into the frame of each piece, of all kinds."""
    turn, scale = placed.rot[:, :, owners], placed.scale[owners]
    own = jnp.transpose(jnp.concatenate([group.rot for group in colliders]), (1, 2, 0))[..., None]
    at = jnp.concatenate([group.pos for group in colliders]).T[..., None]
    origin = [placed.pos[k][owners] + scale * dot(turn[k], at) for k in range(3)]
    gap = [centre[k] - origin[k][:, None] for k in range(3)]
    # The pieces' axes in the world, over the owners' scales.
    axes = [[dot(turn[k], own[:, a]) / scale for k in range(3)] for a in range(3)]
    return [dot(gap, [part[:, None] for part in axis]) for axis in axes]


def _near(kind: str, local: list[Array], group: PieceGroup) -> Float[Array, "piece block pop"]:
    """Bound the distance of points in the pieces' frames, at scale 1, to each piece from below."""
    size = [group.size[:, k, None, None] for k in range(3)]
    planes = jnp.transpose(group.planes, (1, 2, 0))[..., None, None]
    return bound(kind, local, size, lambda f, c: planes[f, c], group.planes.shape[1])


def members(
    mask: Bool[Array, " flat"],
) -> tuple[Int[Array, ""], Callable[[Int[Array, " n"]], Int[Array, " n"]]]:
    """Return how many entries are true, and what finds the flat index of the n-th that is.

    Only what is asked for is looked up, by words of 32 bits, which is many times faster on a CPU
    than `jnp.nonzero`. A number past the end gives some index.
    """
    bits = jnp.pad(mask, (0, -mask.size % WORD)).reshape(-1, WORD).astype(jnp.uint32)
    words = jnp.sum(bits << jnp.arange(WORD, dtype=jnp.uint32), axis=1, dtype=jnp.uint32)
    upto = jnp.cumsum(_ones(words))

    def member(number: Int[Array, " n"]) -> Int[Array, " n"]:
        at = jnp.minimum(jnp.searchsorted(upto, number, side="right"), words.size - 1)
        word = words[at]
        left = number - (upto[at] - _ones(word))
        bit = jnp.zeros_like(number)
        for width in (16, 8, 4, 2, 1):
            low = _ones(word & jnp.uint32((1 << width) - 1))
            above = left >= low
            left = jnp.where(above, left - low, left)
            word = jnp.where(above, word >> width, word)
            bit = jnp.where(above, bit + width, bit)
        return jnp.minimum(at * WORD + bit, mask.size - 1).astype(number.dtype)

    return upto[-1], member


def _ones(word: UInt32[Array, " n"]) -> Int[Array, " n"]:
    return lax.population_count(word).astype(jnp.int32)
