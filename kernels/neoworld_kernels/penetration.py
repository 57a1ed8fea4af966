"""Deepest penetration of surface samples into convex colliders, for a population of poses.

For every candidate and ordered pair of objects (i, j), `pair_depth` is the depth of the deepest
surface sample of i in the convex pieces of j: the maximum over samples and pieces of the negated
signed distance, clipped at zero. On CPUs it is computed with culling by bounding volumes.

Most objects of a scene are apart. If two objects touch, most of their samples are far from the
contact. A piece is tested against an object only if, in some candidate, the bounding box of the
piece intersects the bounding sphere of the object. The samples of the object form blocks of BLOCK
consecutive samples, and only blocks whose bounding spheres intersect the box are tested.
Consecutive samples should therefore be close together; see `sorted_samples`.

The search returns the deepest sample of each pair of objects, and the piece that contains it. The
gradient is computed from these samples alone, at the cost of one distance per pair of objects.

Loops run only over pairs that are near at run time, so padding costs almost nothing. Since XLA's
compile time grows with the number of branches, there are only two families of pieces. For pieces
defined by sizes, the formulas of all kinds are evaluated, and one result is selected. All other
pieces are defined by planes.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import NDArray

from .convex_pieces import (
    SPARE,
    Colliders,
    ObjectPoses,
    PieceGroup,
    coarse_depth,
    distance,
    dot,
    fold_into_sector,
    pair_depth_reference,
    true_indices,
)

BLOCK = 32
"""Largest number of samples in a block."""
UNROLL = 4
"""Number of planes that are evaluated per pass over the samples of a block."""
PAIRS = 32
"""Number of pairs of objects whose gradients are computed at once."""
SIZE_KINDS = ("box", "capsule", "cylinder", "ellipsoid")
"""Kinds of pieces that are defined by sizes. The other kinds, polytopes and sectors, are defined by
planes."""

Index = Int[Array, "object object pop"]


class Blocks(NamedTuple):
    """Samples of all objects in blocks, with bounding spheres."""

    points: Float[Array, "object block sample 3"]
    centre: Float[Array, "object block 3"]
    radius: Float[Array, "object block"]


class Pieces(NamedTuple):
    """Pieces of all kinds: first the pieces defined by sizes, then the pieces defined by planes."""

    all: PieceGroup
    """The pieces, without their planes."""
    code: Int[Array, " round"]
    """Index in SIZE_KINDS of each piece defined by sizes."""
    planes: Float[Array, "flat face 4"]
    repeats: Float[Array, " flat"]
    """Number of repeats of each polytope about the z axis of its frame."""
    faces: Int[Array, " flat"]
    """Number of planes of each polytope, without padding."""


class Deepest(NamedTuple):
    """Deepest sample of object i in the pieces of object j, at [i, j]; zeros if none is inside."""

    depth: Float[Array, "object object pop"]
    sample: Index
    piece: Index
    """Index of the piece that contains the sample, over all kinds."""
    face: Index
    """Index of the plane of a polytope that is nearest to the sample."""


def sorted_samples(
    samples: Float[NDArray, "object sample 3"],
) -> Float[NDArray, "object sample 3"]:
    """Reorder each object's samples so that each block of BLOCK consecutive samples is compact.

    The first 2 * BLOCK samples are the most important ones. They stay in front and are reordered
    among themselves.
    """
    first = 2 * BLOCK

    def split_in_half(points: NDArray) -> NDArray:
        if len(points) <= BLOCK:
            return points
        order = np.argsort(points[:, np.argmax(np.ptp(points, axis=0))], kind="stable")
        half = -(-len(points) // (2 * BLOCK)) * BLOCK
        return np.concatenate(
            [split_in_half(points[order[:half]]), split_in_half(points[order[half:]])]
        )

    return np.stack(
        [np.concatenate([split_in_half(x[:first]), split_in_half(x[first:])]) for x in samples]
    )


def sample_blocks(samples: Float[Array, "object sample 3"]) -> Blocks:
    """Split the samples of each object into blocks of consecutive samples."""
    count, number, _ = samples.shape
    size = min(BLOCK, number)
    points = jnp.pad(samples, ((0, 0), (0, -number % size), (0, 0)), mode="edge")
    points = points.reshape(count, -1, size, 3)
    return Blocks(points, *bounding_sphere(points))


def bounding_sphere(points: Float[Array, "... sample 3"]) -> tuple[Array, Array]:
    """Return the centers [..., 3] and radii [...] of spheres that bound points [m]."""
    centre = (points.min(axis=-2) + points.max(axis=-2)) / 2
    radius = jnp.sqrt(jnp.max(jnp.sum((points - centre[..., None, :]) ** 2, axis=-1), axis=-1))
    # The radius is slightly enlarged, so that rounding never culls a contact.
    return centre, radius * 1.00001 + 1e-6


def pair_depth(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "pop object object"]:
    """Compute the depth of i's deepest sample in j's colliders [m], at [candidate, i, j].

    On CPUs only pairs that can touch are evaluated, on accelerators all pairs. Differentiable
    almost everywhere.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m]. Repeat points for padding.
        colliders: convex pieces in object frames at scale 1.

    Returns:
        Depths, zero for pairs that do not penetrate and on the diagonal.
    """
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    device = jax.devices(chosen)[0] if chosen is None or isinstance(chosen, str) else chosen
    depth = pair_depth_culled if device.platform == "cpu" else pair_depth_reference
    return depth(pos, rot, scale, samples, colliders)


def pair_depth_culled(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
) -> Float[Array, "pop object object"]:
    """Compute `pair_depth` with culling by bounding volumes. Differentiable.

    If several samples are equally deep, one of them determines the gradient. All depths of an
    object whose pose is not finite are NaN.
    """
    pop, count = scale.shape
    if not any(len(group.owner) for group in colliders) or not pop or not samples.size:
        return jnp.zeros((pop, count, count), pos.dtype)
    placed = ObjectPoses(jnp.transpose(pos, (1, 2, 0)), jnp.transpose(rot, (1, 2, 3, 0)), scale.T)
    pieces = join_pieces(colliders)
    deepest = _search(*jax.tree.map(lax.stop_gradient, (placed, sample_blocks(samples), pieces)))
    depth = _value(deepest, placed, samples, pieces)
    finite = jnp.isfinite(jnp.sum(placed.pos, 1) + jnp.sum(placed.rot, (1, 2)) + placed.scale)
    depth = jnp.where(finite[:, None] & finite, depth, jnp.nan)
    return jnp.transpose(depth, (2, 0, 1))


def join_pieces(colliders: Colliders) -> Pieces:
    """Join the pieces of all kinds, in the order of `Colliders`."""
    flat = (colliders.polytope, colliders.sector)
    width = max(g.planes.shape[1] for g in flat)
    width += -width % UNROLL
    spare = np.array([0.0, 0.0, 0.0, SPARE], np.float32)
    fill = lambda g: jnp.broadcast_to(spare, (len(g.owner), width - g.planes.shape[1], 4))
    planes = jnp.concatenate([jnp.concatenate([g.planes, fill(g)], axis=1) for g in flat])
    join = lambda leaf: jnp.concatenate([getattr(group, leaf) for group in colliders])
    counts = [len(getattr(colliders, kind).owner) for kind in SIZE_KINDS]
    return Pieces(
        all=PieceGroup(
            join("owner"), join("pos"), join("rot"), join("size"), planes[:, :0], join("extent")
        ),
        code=jnp.asarray(np.repeat(np.arange(len(SIZE_KINDS), dtype=np.int32), counts)),
        planes=planes,
        repeats=jnp.concatenate(
            [jnp.ones(len(colliders.polytope.owner)), colliders.sector.size[:, 0]]
        ),
        faces=jnp.sum(planes[..., 3] < SPARE / 2, axis=1, dtype=jnp.int32),
    )


def touching(
    placed: ObjectPoses, blocks: Blocks, pieces: PieceGroup
) -> Bool[Array, "piece object"]:
    """Return a mask of pieces and objects whose bounding volumes intersect in any candidate.

    The bounding box of each piece is tested against the bounding sphere of each other object. An
    object whose pose is NaN touches nothing.
    """
    centre, radius = bounding_sphere(blocks.points.reshape(blocks.points.shape[0], -1, 3))
    at = jnp.sum(placed.rot * centre[:, None, :, None], axis=2) * placed.scale[:, None] + placed.pos
    owner = pieces.owner
    turn, size = placed.rot[owner], placed.scale[owner]
    middle = pieces.pos + jnp.sum(pieces.rot * jnp.mean(pieces.extent, axis=1)[:, None], axis=-1)
    axes = [jnp.sum(turn * pieces.rot[:, None, :, a, None], axis=2) for a in range(3)]
    origin = jnp.sum(turn * middle[:, None, :, None], axis=2) * size[:, None] + placed.pos[owner]
    half = (pieces.extent[:, 1] - pieces.extent[:, 0])[..., None] / 2 * size[:, None]
    gap = [at[:, k] - origin[:, None, k] for k in range(3)]
    square = 0.0
    for a in range(3):
        along = sum(gap[k] * axes[a][:, None, k] for k in range(3))
        beyond = jnp.maximum(jnp.abs(along) - half[:, None, a], 0.0)
        square = square + beyond * beyond
    near = jnp.any(square < (radius[:, None] * placed.scale) ** 2, axis=-1)
    return near & (owner[:, None] != jnp.arange(len(radius)))


def _search(placed: ObjectPoses, blocks: Blocks, pieces: Pieces) -> Deepest:
    count, pop = placed.scale.shape
    size_count = len(pieces.code)
    near = touching(placed, blocks, pieces.all)
    none = jnp.zeros((count, count, pop), jnp.int32)
    deepest = Deepest(none.astype(jnp.float32), none, none, none)
    for first, last in ((0, size_count), (size_count, len(near))):
        if last > first:
            pairs, number = true_indices(near[first:last])

            def search(k: Array, deepest: Deepest, pairs: Array = pairs, first: int = first):
                piece, i = first + pairs[k] // count, pairs[k] % count
                return _update_deepest(
                    deepest, placed, blocks, pieces, piece, i, planes=first == size_count
                )

            deepest = lax.fori_loop(0, number, search, deepest)
    return deepest


DepthOf = Callable[[list[Array]], Array]
"""Function of points in a piece's frame, given by separate coordinates, that returns their depths
below the piece's surface."""


def _update_deepest(
    deepest: Deepest,
    placed: ObjectPoses,
    blocks: Blocks,
    pieces: Pieces,
    piece: Int[Array, ""],
    i: Int[Array, ""],
    planes: bool,
) -> Deepest:
    """Update the deepest samples of all candidates with the samples of object i in one piece."""
    o = pieces.all.owner[piece]
    pos, rot, size = pieces.all.pos[piece], pieces.all.rot[piece], placed.scale[o]
    low, high = pieces.all.extent[piece]
    # From i's frame at scale 1 into the piece's: x -> turn x + shift.
    ratio = placed.scale[i] / size
    one, two = placed.rot[i], placed.rot[o]
    between = [[ratio * dot(two[:, m], one[:, c]) for m in range(3)] for c in range(3)]
    gap = placed.pos[i] - placed.pos[o]
    away = [dot(two[:, m], gap) / size - pos[m] for m in range(3)]
    turn = [[dot(rot[:, a], between[c]) for c in range(3)] for a in range(3)]
    shift = [dot(rot[:, a], away) for a in range(3)]
    at = lambda x: [dot(turn[a], x) + shift[a] for a in range(3)]
    spheres = at([blocks.centre[i, :, c, None] for c in range(3)])
    beyond = [
        jnp.maximum(jnp.maximum(x - h, lo - x), 0.0)
        for x, lo, h in zip(spheres, low, high, strict=True)
    ]
    near = dot(beyond, beyond) < (blocks.radius[i, :, None] * ratio) ** 2
    near = jnp.any(near, axis=1)

    depth_of = _by_planes(pieces, piece) if planes else _by_size(pieces, piece)

    def search(b: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        points = blocks.points[i, b]
        number = len(points)
        values = depth_of(at([points[:, c, None] for c in range(3)]))
        top = jnp.max(values, axis=0)
        index = jnp.arange(number, dtype=jnp.int32)[:, None]
        deepest_index = b * number + jnp.min(jnp.where(values == top, index, number - 1), axis=0)
        best, sample = carry
        return jnp.maximum(best, top), jnp.where(top > best, deepest_index, sample)

    none = jnp.zeros(size.shape, jnp.int32)
    best, sample = lax.fori_loop(
        0,
        len(near),
        lambda b, carry: lax.cond(near[b], search, lambda _, carry: carry, b, carry),
        (none.astype(jnp.float32), none),
    )
    face = none
    if planes:
        points = blocks.points[i].reshape(-1, 3)
        face = _nearest_plane(pieces, piece, at([points[sample, c] for c in range(3)]))
    best = best * size
    is_deeper = best > deepest.depth[i, o]
    new = (best, sample, jnp.broadcast_to(piece, best.shape), face)
    return Deepest(
        *(
            old.at[i, o].set(jnp.where(is_deeper, x, old[i, o]))
            for old, x in zip(deepest, new, strict=True)
        )
    )


def _by_size(pieces: Pieces, piece: Array) -> DepthOf:
    size, code = pieces.all.size[piece], pieces.code[piece]
    # Ellipsoids divide by sizes, which may be zero for other kinds.
    safe = jnp.where(code == SIZE_KINDS.index("ellipsoid"), size, 1.0)

    def depth(local: list[Array]) -> Array:
        x, y, z = local
        value = jnp.zeros_like(x)
        for c, kind in enumerate(SIZE_KINDS):
            sizes = list(safe if kind == "ellipsoid" else size)
            kind_depth = coarse_depth(kind, x, y, z, sizes)
            value = jnp.where(code == c, kind_depth, value)
        return value

    return depth


def _by_planes(pieces: Pieces, piece: Array) -> DepthOf:
    row = piece - len(pieces.code)
    planes, times = pieces.planes[row], pieces.repeats[row]

    def depth(local: list[Array]) -> Array:
        x, y, z = lax.cond(times > 1.0, lambda p: _fold_into_sector(p, times), list, local)

        def clip_by_planes(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            least, loaded = carry
            for a, b, c, d in loaded:
                least = jnp.minimum(least, ((d - a * x) - b * y) - c * z)
            return least, load_planes(k + 1)

        # Load planes one iteration ahead: XLA does not vectorize a loop with a dynamic index.
        load_planes = lambda k: lax.dynamic_slice_in_dim(planes, k * UNROLL, UNROLL)
        iterations = -(-pieces.faces[row] // UNROLL)
        return lax.fori_loop(0, iterations, clip_by_planes, (x * 0.0 + SPARE, load_planes(0)))[0]

    return depth


def _nearest_plane(
    pieces: Pieces, piece: Array, local: list[Float[Array, " pop"]]
) -> Int[Array, " pop"]:
    """Return the index of the piece's plane that is nearest to each point in the piece's frame."""
    row = piece - len(pieces.code)
    planes, times = pieces.planes[row], pieces.repeats[row]
    x, y, z = lax.cond(times > 1.0, lambda p: _fold_into_sector(p, times), list, local)
    n = planes[:, :, None]
    return jnp.argmin(((n[:, 3] - n[:, 0] * x) - n[:, 1] * y) - n[:, 2] * z, axis=0)


def _fold_into_sector(local: list[Array], times: Array) -> list[Array]:
    x, y, z = local
    return [*fold_into_sector(x, y, times), z]


@jax.custom_vjp
def _value(
    deepest: Deepest, placed: ObjectPoses, samples: Float[Array, "object sample 3"], pieces: Pieces
) -> Float[Array, "object object pop"]:
    """Return the depths that the search found. The gradient is that of `_depth_at`."""
    del placed, samples, pieces
    return deepest.depth


def _value_forward(*inputs: Any) -> tuple[Array, tuple[Any, ...]]:
    return inputs[0].depth, inputs


def _value_backward(inputs: tuple[Any, ...], grad: Array) -> tuple[Any, ...]:
    deepest, placed, samples, pieces = inputs
    count = len(samples)
    pairs, number = true_indices(jnp.any(deepest.depth > 0, axis=-1))

    def add(turn: Array, total: tuple[ObjectPoses, Array]) -> tuple[ObjectPoses, Array]:
        rows = turn * PAIRS + jnp.arange(PAIRS)
        pair = pairs[jnp.minimum(rows, len(pairs) - 1)]
        i, j = pair // count, pair % count
        of_pairs = Deepest(*(x[i, j] for x in deepest))
        pullback = jax.vjp(lambda p, s: _depth_at(of_pairs, i, j, p, s, pieces), placed, samples)[1]
        gradient = pullback(jnp.where((rows < number)[:, None], grad[i, j], 0.0))
        return jax.tree.map(jnp.add, total, gradient)

    none = jax.tree.map(jnp.zeros_like, (placed, samples))
    return None, *lax.fori_loop(0, -(-number // PAIRS), add, none), None


_value.defvjp(_value_forward, _value_backward)


def _depth_at(
    deepest: Deepest,
    i: Int[Array, " pair"],
    j: Int[Array, " pair"],
    placed: ObjectPoses,
    samples: Float[Array, "object sample 3"],
    pieces: Pieces,
) -> Float[Array, "pair pop"]:
    """Compute the depths of the deepest samples of pairs (i, j) of objects."""
    first = lambda x: jnp.moveaxis(x, -1, 0)
    x = first(samples[i[:, None], deepest.sample])
    # One row per piece, since a CPU gathers rows much faster than single numbers.
    a = pieces.all
    cut, flat = len(pieces.code), len(pieces.repeats)
    code = jnp.concatenate([pieces.code.astype(a.pos.dtype), jnp.full(flat, -1.0)])
    times = jnp.concatenate([jnp.ones(cut), pieces.repeats])
    columns = [a.pos, a.rot.reshape(-1, 9), a.size, code[:, None], times[:, None]]
    row = first(jnp.concatenate(columns, axis=1)[deepest.piece])
    pos, rot, size = row[:3], row[3:12].reshape(3, 3, *row.shape[1:]), row[12:15]
    code, times = row[15], row[16]
    # Sums of products, since matrix products may use TF32. World to piece: invert the owner's pose
    # and scale, then the piece's pose.
    one, two = (
        jnp.transpose(placed.rot[i], (1, 2, 0, 3)),
        jnp.transpose(placed.rot[j], (1, 2, 0, 3)),
    )
    at_one, at_two = jnp.swapaxes(placed.pos[i], 0, 1), jnp.swapaxes(placed.pos[j], 0, 1)
    point = jnp.sum(one * x, axis=1) * placed.scale[i]
    origin = jnp.sum(two * pos, axis=1) * placed.scale[j]
    d = (point + at_one) - (origin + at_two)
    d = jnp.sum(two * d[:, None], axis=0) / placed.scale[j]
    local = jnp.sum(rot * d[:, None], axis=0)
    far = jnp.zeros_like(local[0])
    for c, kind in enumerate(SIZE_KINDS if cut else ()):
        # Zero sizes of other kinds would make gradients NaN.
        sizes = jnp.where(code == c, size, 1.0)
        group = PieceGroup(code, pos, rot, sizes, code, code)
        far = jnp.where(code == c, distance(kind, local[0], local[1], local[2], group), far)
    if flat:
        b, c, z = _fold_into_sector(list(local), times)
        x, y = jnp.where(times > 1.0, b, local[0]), jnp.where(times > 1.0, c, local[1])
        width = pieces.planes.shape[1]
        index = jnp.maximum(deepest.piece - cut, 0) * width + deepest.face
        n = first(pieces.planes.reshape(-1, 4)[index])
        beyond = n[0] * x + n[1] * y + n[2] * z - n[3]
        far = jnp.where(code < 0, beyond, far)
    return jnp.where(deepest.depth > 0, jnp.maximum(-far * placed.scale[j], 0.0), 0.0)
