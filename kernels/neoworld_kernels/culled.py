"""Deepest penetration, looked for only where something can touch: for CPUs.

Objects of a scene are mostly apart, and of two that touch most surface samples are far from the
contact. Samples are cut into compact blocks, and a block is looked at, for a piece and a candidate,
only if its bounding sphere reaches the piece. Those that are left are collected into chunks of a
fixed size, so that vectors stay full however few candidates a pair of objects touches in.

The search says which sample is deepest in which piece. Its depth is then computed anew, which makes
the result differentiable at the cost of one distance a pair of objects.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .blocks import Blocks, ObjectPoses, dot, members, sample_blocks, touching
from .coarse_distance import depths, finished, folded
from .convex_pieces import Colliders, PieceGroup, distance

BLOCK = 32
"""Samples in a block, at most."""
CHUNK = 2048
"""Blocks that are looked at together, each for its own piece and candidate."""
LUMP = 4
"""Samples of a block that one pass over a chunk looks at."""
SLAB = 512
"""Candidates that are searched together, which bounds the memory."""

Index = Int[Array, "object object pop"]


class Deepest(NamedTuple):
    """Which sample of i is deepest in which piece of j; all zero where none is inside."""

    inside: Bool[Array, "object object pop"]
    sample: Index
    piece: Index
    """Counted through all kinds."""
    face: Index
    """Plane of a polytope that the sample is next to."""


def pair_depth_culled(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "pop object object"]:
    """Compute what `pair_depth_reference` does, culling by bounding spheres. Differentiable.

    Of samples that are equally deep one gives the gradient. Every depth of an object whose pose is
    not finite is NaN.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m]; repeat a point to pad.
        colliders: convex pieces in object frames at scale 1.
    """
    pop, count = scale.shape
    if not any(len(group.owner) for group in colliders) or not pop or not samples.size:
        return jnp.zeros((pop, count, count), pos.dtype)
    placed = ObjectPoses(jnp.transpose(pos, (2, 1, 0)), jnp.transpose(rot, (2, 3, 1, 0)), scale.T)
    fixed = jax.tree.map(lax.stop_gradient, (placed, samples, colliders))
    depth = _depth_at(_search_slabs(*fixed), placed, samples, colliders)
    finite = jnp.isfinite(jnp.sum(placed.pos, 0) + jnp.sum(placed.rot, (0, 1)) + placed.scale)
    depth = jnp.where(finite[:, None] & finite, depth, jnp.nan)
    return jnp.transpose(depth, (2, 0, 1))


def _search_slabs(
    placed: ObjectPoses, samples: Float[Array, "object sample 3"], colliders: Colliders
) -> Deepest:
    pop = placed.scale.shape[-1]
    search = functools.partial(_search, blocks=sample_blocks(samples, BLOCK), colliders=colliders)
    slabs = -(-pop // SLAB)
    if slabs == 1:
        return search(placed)
    each = -(-pop // slabs)

    def cut(x: Array) -> Array:
        x = jnp.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, each * slabs - pop)], mode="edge")
        return jnp.moveaxis(x.reshape(*x.shape[:-1], slabs, each), -2, 0)

    deepest = lax.map(search, jax.tree.map(cut, placed))
    whole = lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], -1)[..., :pop]
    return jax.tree.map(whole, deepest)


def _search(placed: ObjectPoses, blocks: Blocks, colliders: Colliders) -> Deepest:
    count, pop = placed.scale.shape
    number = len(blocks.radius)
    mask = touching(placed, blocks, colliders)
    _, member = members(mask.reshape(-1))
    # Kinds follow one another; each starts a chunk of its own, since chunks are of one kind.
    groups = [(k, g) for k, g in zip(Colliders._fields, colliders, strict=True) if len(g.owner)]
    lengths = [len(g.owner) for _, g in groups]
    cuts = [sum(lengths[:k]) for k in range(1, len(groups))]
    sums = jnp.stack([jnp.sum(part, dtype=jnp.int32) for part in jnp.split(mask, cuts)])
    ends = jnp.cumsum(sums)
    chunk = min(CHUNK, mask.size)
    chunks = jnp.cumsum(-(-sums // chunk))
    first = jnp.asarray([0, *cuts], jnp.int32)
    owner = jnp.concatenate([g.owner for _, g in groups])
    own_pos = jnp.concatenate([g.pos for _, g in groups]).T
    own_rot = jnp.transpose(jnp.concatenate([g.rot for _, g in groups]), (1, 2, 0))
    poses = ObjectPoses(*(x.reshape(*x.shape[:-2], -1) for x in placed))

    def address(index: Array) -> tuple[Array, ...]:
        here = member(index)
        candidate, block = here % pop, here // pop % number
        piece = here // (pop * number)
        i, o = block // (number // count), owner[piece]
        slot = (i * count + o) * pop + candidate
        return block, piece, i * pop + candidate, o * pop + candidate, slot

    def compose(piece: Array, one: Array, two: Array) -> tuple[Any, ...]:
        one_, two_ = (ObjectPoses(*(x[..., k] for x in poses)) for k in (one, two))
        return *_motion(one_, two_, own_pos[:, piece], own_rot[..., piece]), two_.scale

    def look(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        k, depth, sample, of_piece, of_face = carry
        kind = jnp.searchsorted(chunks, k, side="right")
        begun = jnp.where(kind > 0, chunks[kind - 1], 0)
        index = ends[kind] - sums[kind] + (k - begun) * chunk + jnp.arange(chunk)
        block, piece, one, two, slot = _apart(k, address, index)
        turn, shift, scale = _apart(k, compose, piece, one, two)
        inside = [functools.partial(_inside, name, blocks, group) for name, group in groups]
        value, which, face = lax.switch(kind, inside, turn, shift, block, piece - first[kind])
        value = jnp.where(index < ends[kind], value * scale, 0.0)
        depth = depth.at[slot].max(value)
        wins = (value > 0) & (value >= depth[slot])
        to = jnp.where(wins, slot, depth.size)
        new = ((sample, which), (of_piece, piece), (of_face, face))
        return k + 1, depth, *(old.at[to].set(x, mode="drop") for old, x in new)

    none = jnp.zeros(count * count * pop, jnp.int32)
    start = (jnp.int32(0), none.astype(jnp.float32), none, none, none)
    _, *best = lax.while_loop(lambda carry: carry[0] < chunks[-1], look, start)
    depth, *where = (x.reshape(count, count, pop) for x in best)
    return Deepest(depth > 0, *where)


def _apart(k: Array, stage: Callable[..., Any], *inputs: Array) -> Any:
    """Compute a stage in a computation of its own.

    XLA would fuse it into all that follows and compute it for every sample anew. It does not see
    that the condition always holds.
    """
    shapes = jax.eval_shape(stage, *inputs)
    zeros = lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return lax.cond(k >= 0, stage, zeros, *inputs)


def _motion(
    one: ObjectPoses, two: ObjectPoses, pos: Float[Array, "3 item"], rot: Float[Array, "3 3 item"]
) -> tuple[list[list[Array]], list[Array]]:
    """Compose x -> turn x + shift, from one's frame at scale 1 into a piece's of two."""
    gap, ratio = one.pos - two.pos, one.scale / two.scale
    turn = [[ratio * dot(two.rot[:, m], one.rot[:, c]) for m in range(3)] for c in range(3)]
    shift = [dot(two.rot[:, m], gap) / two.scale - pos[m] for m in range(3)]
    axes = range(3)
    return [[dot(rot[:, a], turn[c]) for c in axes] for a in axes], [
        dot(rot[:, a], shift) for a in axes
    ]


def _inside(
    kind: str,
    blocks: Blocks,
    group: PieceGroup,
    turn: list[list[Array]],
    shift: list[Array],
    block: Int[Array, " item"],
    row: Int[Array, " item"],
) -> tuple[Float[Array, " item"], Int[Array, " item"], Int[Array, " item"]]:
    """Find the sample of each block that is deepest in each piece: depth, sample, nearest face."""
    number = len(blocks.points)
    lump = math.gcd(LUMP, number)
    faces = group.planes.shape[1]
    planes = jnp.transpose(group.planes, (1, 2, 0))[..., row]
    size = list(group.size.T[:, row])
    at = lambda x: [dot(turn[a], x) + shift[a] for a in range(3)]

    def some(g: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        best, which = carry
        points = lax.dynamic_slice_in_dim(blocks.points, g * lump, lump)
        local = at([points[:, c, block] for c in range(3)])
        (values,) = depths(kind, [local], size, lambda f, c: planes[f, c], faces)
        top, at_top = jnp.max(values, axis=0), jnp.argmax(values, axis=0).astype(which.dtype)
        return jnp.maximum(best, top), jnp.where(top > best, g * lump + at_top, which)

    low = (jnp.full(block.shape, -1e6), jnp.zeros_like(block))
    best, which = lax.fori_loop(0, number // lump, some, low)
    face = jnp.zeros_like(block)
    if faces:
        x, y, z = at([blocks.points[which, c, block] for c in range(3)])
        if kind == "sector":
            x, y = folded(x, y, size[0])
        gap = planes[:, 3] - planes[:, 0] * x - planes[:, 1] * y - planes[:, 2] * z
        face = jnp.argmin(gap, axis=0).astype(face.dtype)
    return finished(kind, best, size), blocks.which[which, block], face


def _depth_at(
    deepest: Deepest,
    placed: ObjectPoses,
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "object object pop"]:
    """Compute the depth of the deepest samples, as `pair_depth_reference` does of all."""
    who = jnp.arange(len(samples))[:, None, None]
    x = jnp.moveaxis(samples[who, deepest.sample], -1, 0)
    groups = [(k, g) for k, g in zip(Colliders._fields, colliders, strict=True) if len(g.owner)]
    pos = jnp.concatenate([g.pos for _, g in groups]).T[:, deepest.piece]
    rot = jnp.transpose(jnp.concatenate([g.rot for _, g in groups]), (1, 2, 0))
    rot = rot[..., deepest.piece]
    size = jnp.concatenate([g.size for _, g in groups]).T[:, deepest.piece]
    # Sums of products, since matrix products may be TF32. World to piece: undo the owner's pose and
    # scale, then the piece's own pose.
    turn = placed.rot[:, :, None]
    point = jnp.sum(placed.rot[:, :, :, None] * x, axis=1) * placed.scale[:, None]
    origin = jnp.sum(turn * pos, axis=1) * placed.scale
    d = (point + placed.pos[:, :, None]) - (origin + placed.pos[:, None])
    d = jnp.sum(turn * d[:, None], axis=0) / placed.scale
    local = jnp.sum(rot * d[:, None], axis=0)
    depth = jnp.zeros_like(local[0])
    first = 0
    for kind, group in groups:
        number, faces = group.planes.shape[:2]
        row = deepest.piece - first
        here = deepest.inside & (row >= 0) & (row < number)
        planes = jnp.zeros((0, 4, *row.shape))
        if faces:
            planes = jnp.moveaxis(group.planes[row, deepest.face], -1, 0)[None]
        # Sizes of other kinds may be zero, by which gradients would not be numbers.
        piece = PieceGroup(row, pos, rot, jnp.where(here, size, 1.0), planes)
        inside = -distance(kind, local[0], local[1], local[2], piece) * placed.scale
        depth = jnp.where(here, jnp.maximum(inside, 0.0), depth)
        first += number
    return depth
