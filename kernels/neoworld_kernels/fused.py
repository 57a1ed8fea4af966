"""Deepest penetration in one Pallas kernel, for NVIDIA GPUs from Hopper on."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental import pallas as pl
from jaxtyping import Array, Float, Int

from .coarse_distance import depths, distance_bound, to_depth
from .convex_pieces import SPARE, Colliders

GRANULE = 4
"""Number of samples whose coordinates are adjacent in memory."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairDepthTuning:
    """Block sizes of the kernel."""

    block: int = 256
    """Number of candidates per Pallas program. A thread processes block / 128 candidates."""
    unroll: int = 8
    """Number of samples per loop iteration."""
    fused: bool = True
    """If True, one kernel processes all kinds of colliders; otherwise, each kind has a kernel."""

    def __post_init__(self) -> None:
        """Raise a ValueError unless `block` is a multiple of 128 and `unroll` a multiple of 8."""
        if self.block < 128 or self.block % 128:
            raise ValueError(f"block must be a positive multiple of 128, got {self.block}")
        if self.unroll < 8 or self.unroll % 8:
            raise ValueError(f"unroll must be a positive multiple of 8, got {self.unroll}")


class _Pieces(NamedTuple):
    """Pieces of one kind, sorted by owner."""

    kind: str
    first: Int[Array, " distance_bound"]
    """Index of each object's first piece, followed by the number of pieces."""
    table: Float[Array, "piece column"]
    """Columns: pos (3), rot by rows (9), size (3), number of planes without padding (1), planes (4
    each)."""


def _pieces(colliders: Colliders, count: int) -> list[_Pieces]:
    pieces = []
    for kind, group in zip(Colliders._fields, colliders, strict=True):
        n = group.owner.shape[0]
        if n == 0:
            continue
        order = jnp.argsort(group.owner)
        first = jnp.searchsorted(group.owner[order], jnp.arange(count + 1)).astype(jnp.int32)
        faces = jnp.sum(group.planes[..., 3] < SPARE / 2, axis=1, keepdims=True)
        columns = [group.pos, group.rot.reshape(n, 9), group.size, faces]
        columns.append(group.planes.reshape(n, -1))
        table = jnp.concatenate(columns, axis=1)[order].astype(jnp.float32)
        pieces.append(_Pieces(kind, first, table))
    return pieces


def pair_depth_kernel(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
    *,
    tuning: PairDepthTuning | None = None,
    interpret: bool = False,
) -> Float[Array, "pop object object"]:
    """Compute `pair_depth` in one Pallas kernel.

    A Pallas program processes a block of candidates, one per lane, and one ordered pair (i, j) of
    objects. For each piece of j, it composes the transform from i's frame into the piece's frame
    once. It skips the piece if i's bounding sphere is outside the piece in all candidates of the
    block, and otherwise loops over the samples, which all lanes share. Per candidate, it reads only
    poses and writes only depths.
    """
    t = tuning or PairDepthTuning()
    pop, count = scale.shape
    blocks = -(-pop // t.block)
    groups = _pieces(colliders, count)
    if not groups or pop == 0 or count == 0:
        return jnp.zeros((pop, count, count), jnp.float32)
    # A pose has 13 rows: rotation by rows, position, scale.
    pose = jnp.concatenate([rot.reshape(pop, count, 9), pos, scale[..., None]], axis=-1)
    pose = jnp.pad(pose, ((0, blocks * t.block - pop), (0, 0), (0, 0)), mode="edge")
    pose = jnp.transpose(pose, (1, 2, 0)).astype(jnp.float32)
    points, sphere = _pad_samples(samples, t.unroll)
    shape = jax.ShapeDtypeStruct((count, count, blocks * t.block), jnp.float32)
    launch = _launch_interpreted if interpret else _launch_on_hopper
    depths_by_kind = []
    for batch in [groups] if t.fused else [[g] for g in groups]:
        body = functools.partial(
            _pair_depth_kernel,
            kinds=[g.kind for g in batch],
            samples=points.shape[1] * GRANULE,
            tuning=t,
        )
        tables = [x for g in batch for x in (g.first, g.table)]
        depths_by_kind.append(
            launch(body, (blocks, count, count), shape)(pose, points, sphere, *tables)
        )
    depth = functools.reduce(jnp.maximum, depths_by_kind)
    return jnp.transpose(depth[..., :pop], (2, 0, 1))


def _pad_samples(
    samples: Float[Array, "object sample 3"], unroll: int
) -> tuple[Float[Array, "object granule 3 four"], Float[Array, "object 4"]]:
    """Return the samples in granules, padded to a multiple of `unroll`, and bounding spheres."""
    spare = -samples.shape[1] % unroll
    points = jnp.pad(samples, ((0, 0), (0, spare), (0, 0)), mode="edge").astype(jnp.float32)
    centre = (points.min(axis=1) + points.max(axis=1)) / 2
    radius = jnp.sqrt(jnp.max(jnp.sum((points - centre[:, None]) ** 2, axis=-1), axis=1))
    # The radius is slightly enlarged, so that rounding never culls a contact.
    sphere = jnp.concatenate([centre, radius[:, None] * 1.00001 + 1e-6], axis=1)
    points = points.reshape(len(points), -1, GRANULE, 3)
    return jnp.swapaxes(points, 2, 3), sphere


def _launch_interpreted(body: Callable, grid: tuple[int, ...], shape: Any) -> Callable:
    def program(*refs: Any) -> None:
        body(*(pl.program_id(k) for k in range(3)), *refs)

    whole = pl.BlockSpec(memory_space=pl.ANY)
    return lambda *inputs: pl.pallas_call(
        program,
        grid=grid,
        in_specs=[whole] * len(inputs),
        out_specs=whole,
        out_shape=shape,
        interpret=True,
    )(*inputs)


def _launch_on_hopper(body: Callable, grid: tuple[int, ...], shape: Any) -> Callable:
    # Mosaic GPU is used, since the Triton backend of Pallas is deprecated.
    import jax.experimental.pallas.mosaic_gpu as plgpu

    names = ("block", "of", "into")

    def program(*refs: Any) -> None:
        body(*(lax.axis_index(name) for name in names), *refs)

    return plgpu.kernel(
        program,
        out_type=shape,
        grid=grid,
        grid_names=names,
        compiler_params=plgpu.CompilerParams(
            approx_math=True, lowering_semantics=plgpu.LoweringSemantics.Lane
        ),
    )


def _pair_depth_kernel(
    b: Array,
    i: Array,
    o: Array,
    pose_ref: Any,  # [object, 13, pop]
    points_ref: Any,  # [object, sample / 4, 3, 4]
    sphere_ref: Any,  # [object, 4]
    *refs: Any,  # of each kind: first [object + 1], table [piece, column]; last: out [i, o, pop]
    kinds: list[str],
    samples: int,
    tuning: PairDepthTuning,
) -> None:
    out_ref = refs[-1]
    lanes = pl.ds(b * tuning.block, tuning.block)
    out_ref[i, o, lanes] = jnp.zeros((tuning.block,), jnp.float32)

    @pl.when(i != o)
    def _() -> None:
        load = lambda index, row: pose_ref[index, row, lanes]
        ri, ro = ([load(obj, r) for r in range(9)] for obj in (i, o))
        gap = [load(i, 9 + r) - load(o, 9 + r) for r in range(3)]
        size = load(o, 12)
        shrink = 1.0 / size
        ratio = load(i, 12) * shrink
        # From i's frame at scale 1 into o's: x -> turn x + shift.
        turn = [
            [ratio * sum(ro[3 * k + r] * ri[3 * k + c] for k in range(3)) for c in range(3)]
            for r in range(3)
        ]
        shift = [shrink * sum(ro[3 * k + r] * gap[k] for k in range(3)) for r in range(3)]
        centre = [sphere_ref[i, c] for c in range(3)]
        reach = sphere_ref[i, 3] * ratio
        # Computed zeros have the layout of loaded values, which loops must preserve.
        depth = size * 0.0
        for g, kind in enumerate(kinds):
            first_ref, table_ref = refs[2 * g], refs[2 * g + 1]

            def piece(
                k: Array,
                depth: Array,
                kind: str = kind,
                table_ref: Any = table_ref,
            ) -> Array:
                p = [table_ref[k, c] for c in range(15)]
                faces = table_ref[k, 15].astype(jnp.int32)
                plane = lambda f, c: table_ref[k, 16 + 4 * f + c]
                offset = [shift[r] - p[r] for r in range(3)]
                transform = [
                    (
                        [sum(p[3 + 3 * m + r] * turn[m][c] for m in range(3)) for c in range(3)],
                        sum(p[3 + 3 * m + r] * offset[m] for m in range(3)),
                    )
                    for r in range(3)
                ]
                at = lambda x: [
                    ((end + row[0] * x[0]) + row[1] * x[1]) + row[2] * x[2]
                    for row, end in transform
                ]
                near = distance_bound(kind, at(centre), p[12:15], plane, faces)

                def deepest(depth: Array) -> Array:
                    # Constant last indices avoid address arithmetic in the loop.
                    granules = tuning.unroll // GRANULE

                    def update(s: Array, best: Array) -> Array:
                        local = [
                            at([points_ref[i, s * granules + g, c, u] for c in range(3)])
                            for g in range(granules)
                            for u in range(GRANULE)
                        ]
                        for value in depths(kind, local, p[12:15], plane, faces):
                            best = jnp.maximum(best, value)
                        return best

                    low = size * 0.0 - 1e6
                    best = lax.fori_loop(0, samples // (granules * GRANULE), update, low)
                    return jnp.maximum(depth, to_depth(kind, best, p[12:15]) * size)

                # A pose with NaN counts as touching, so that its depth is NaN.
                touched = jnp.max(jnp.where(near >= reach, 0.0, 1.0)) > 0.0
                return lax.cond(touched, deepest, lambda depth: depth, depth)

            depth = lax.fori_loop(first_ref[o], first_ref[o + 1], piece, depth)
        out_ref[i, o, lanes] = depth
