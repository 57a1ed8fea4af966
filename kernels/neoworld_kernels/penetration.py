"""Deepest penetration of surface samples into convex solids, for a population of poses.

`pair_depth` answers, for every candidate and every ordered pair of objects (i, j), how deep the
deepest surface sample of i lies inside a solid of j. It is a maximum over samples and solids of the
negated signed distance, clipped at zero, and differentiable almost everywhere.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.experimental import pallas as pl
from jaxtyping import Array, Float, Int

from .solids import Group, Solids, distance

__all__ = ["PairDepthTuning", "choose", "pair_depth", "pair_depth_reference"]

Impl = Literal["auto", "jnp", "pallas"]

MEASURED = json.loads((Path(__file__).parent / "penetration_measured.json").read_text())
"""Where the kernel beats plain XLA, measured; see the file."""

GRANULE = 4
"""Samples that lie side by side in memory."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PairDepthTuning:
    """How the kernel is cut up."""

    block: int = 256
    """Candidates a program works on; a thread holds block / 128 of them."""
    unroll: int = 8
    """Samples a loop iteration works on."""
    fused: bool = True
    """Whether one kernel takes all kinds of solids, rather than one each."""

    def __post_init__(self) -> None:
        """Check the cut.

        Raises:
            ValueError: block is no multiple of 128, or unroll none of 8.
        """
        if self.block < 128 or self.block % 128:
            raise ValueError(f"block must be a positive multiple of 128, got {self.block}")
        if self.unroll < 8 or self.unroll % 8:
            raise ValueError(f"unroll must be a positive multiple of 8, got {self.unroll}")


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
            turn = [[_dot(rot[o, i], piece.rot[:, k]) for k in range(3)] for i in range(3)]
            origin = [pos[o, i] + scale[o] * _dot(rot[o, i], piece.pos) for i in range(3)]
            d = [points[i] - origin[i] for i in range(3)]
            local = [sum(d[i] * turn[i][k] for i in range(3)) / scale[o] for k in range(3)]
            inside = -distance(kind, local[0], local[1], local[2], piece)
            return jnp.maximum(jnp.max(inside, axis=0) * scale[o], 0.0)

        found = jax.lax.map(deepest, group)
        depth = depth.at[:, group.owner].max(jnp.moveaxis(found, 0, 1))
    apart = 1.0 - jnp.eye(count, dtype=pos.dtype)
    return jnp.moveaxis(depth, -1, 0) * apart


def _dot(a: Array, b: Array) -> Array:
    # Not a matrix product: those are TF32 on recent NVIDIA GPUs, 0.1 mm off at the size of a table.
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


class _Pieces(NamedTuple):
    """One kind's pieces, in the order of their owners."""

    kind: str
    first: Int[Array, " bound"]
    """Index of each object's first piece; one more entry for the end."""
    table: Float[Array, "piece column"]
    """pos 3, rot 9 by rows, size 3, 1 spare so that planes are aligned, then 4 a plane."""
    faces: int


def _pieces(solids: Solids, count: int) -> list[_Pieces]:
    found = []
    for kind, group in zip(Solids._fields, solids, strict=True):
        n = group.owner.shape[0]
        if n == 0:
            continue
        order = jnp.argsort(group.owner)
        first = jnp.searchsorted(group.owner[order], jnp.arange(count + 1)).astype(jnp.int32)
        columns = [group.pos, group.rot.reshape(n, 9), group.size, jnp.zeros((n, 1))]
        columns.append(group.planes.reshape(n, -1))
        table = jnp.concatenate(columns, axis=1)[order].astype(jnp.float32)
        found.append(_Pieces(kind, first, table, group.planes.shape[1]))
    return found


def pair_depth_kernel(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    solids: Solids,
    *,
    tuning: PairDepthTuning | None = None,
    interpret: bool = False,
) -> Float[Array, "pop object object"]:
    """Compute what `pair_depth_reference` does, in one Pallas kernel.

    A program takes a block of candidates, one to a lane, and one ordered pair of objects. It
    composes the motion from i's frame into each of j's pieces once, culls the piece if i's bounding
    sphere is outside of it for the whole block, and else runs through the samples, which all lanes
    share. Nothing but poses is read per candidate and nothing but depths is written.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m].
        solids: convex pieces in object frames at scale 1.
        tuning: how the work is cut up.
        interpret: run it on any device, slowly; for tests.
    """
    t = tuning or PairDepthTuning()
    pop, count = scale.shape
    blocks = -(-pop // t.block)
    groups = _pieces(solids, count)
    if not groups or pop == 0 or count == 0:
        return jnp.zeros((pop, count, count), jnp.float32)
    # A pose is 13 rows: rotation by rows, position, scale.
    pose = jnp.concatenate([rot.reshape(pop, count, 9), pos, scale[..., None]], axis=-1)
    pose = jnp.pad(pose, ((0, blocks * t.block - pop), (0, 0), (0, 0)), mode="edge")
    pose = jnp.transpose(pose, (1, 2, 0)).astype(jnp.float32)
    points, sphere = _padded(samples, t.unroll)
    shape = jax.ShapeDtypeStruct((count, count, blocks * t.block), jnp.float32)
    launch = _interpreted if interpret else _on_hopper
    found = []
    for some in [groups] if t.fused else [[g] for g in groups]:
        body = functools.partial(
            _pair_depth_kernel,
            kinds=[(g.kind, g.faces) for g in some],
            samples=points.shape[1] * GRANULE,
            tuning=t,
        )
        tables = [x for g in some for x in (g.first, g.table)]
        found.append(launch(body, (blocks, count, count), shape)(pose, points, sphere, *tables))
    depth = functools.reduce(jnp.maximum, found)
    return jnp.transpose(depth[..., :pop], (2, 0, 1))


def _padded(
    samples: Float[Array, "object sample 3"], unroll: int
) -> tuple[Float[Array, "object granule 3 four"], Float[Array, "object 4"]]:
    """Samples in granules, their number a multiple of `unroll`, and their bounding spheres."""
    spare = -samples.shape[1] % unroll
    points = jnp.pad(samples, ((0, 0), (0, spare), (0, 0)), mode="edge").astype(jnp.float32)
    centre = (points.min(axis=1) + points.max(axis=1)) / 2
    radius = jnp.sqrt(jnp.max(jnp.sum((points - centre[:, None]) ** 2, axis=-1), axis=1))
    # A hair more, so that rounding never culls what touches.
    sphere = jnp.concatenate([centre, radius[:, None] * 1.00001 + 1e-6], axis=1)
    points = points.reshape(len(points), -1, GRANULE, 3)
    return jnp.swapaxes(points, 2, 3), sphere


def _interpreted(body: Callable, grid: tuple[int, ...], shape: Any) -> Callable:
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


def _on_hopper(body: Callable, grid: tuple[int, ...], shape: Any) -> Callable:
    # Mosaic GPU: the Triton backend of Pallas is deprecated.
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
    kinds: list[tuple[str, int]],
    samples: int,
    tuning: PairDepthTuning,
) -> None:
    out_ref = refs[-1]
    here = pl.ds(b * tuning.block, tuning.block)
    out_ref[i, o, here] = jnp.zeros((tuning.block,), jnp.float32)

    @pl.when(i != o)
    def _() -> None:
        load = lambda who, row: pose_ref[who, row, here]
        ri, ro = ([load(who, r) for r in range(9)] for who in (i, o))
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
        # Computed zeros have the layout of what is loaded, which loops must keep.
        depth = size * 0.0
        for g, (kind, faces) in enumerate(kinds):
            first_ref, table_ref = refs[2 * g], refs[2 * g + 1]

            def piece(
                k: Array,
                depth: Array,
                kind: str = kind,
                faces: int = faces,
                table_ref: Any = table_ref,
            ) -> Array:
                p = [table_ref[k, c] for c in range(15)]
                plane = lambda f, c: table_ref[k, 16 + 4 * f + c]
                own = [shift[r] - p[r] for r in range(3)]
                move = [
                    (
                        [sum(p[3 + 3 * m + r] * turn[m][c] for m in range(3)) for c in range(3)],
                        sum(p[3 + 3 * m + r] * own[m] for m in range(3)),
                    )
                    for r in range(3)
                ]
                at = lambda x: [
                    ((end + row[0] * x[0]) + row[1] * x[1]) + row[2] * x[2] for row, end in move
                ]
                near = _bound(kind, at(centre), p[12:15], plane, faces)

                def deepest(depth: Array) -> Array:
                    # Constant last indices keep address arithmetic out of the loop.
                    granules = tuning.unroll // GRANULE

                    def some(s: Array, best: Array) -> Array:
                        local = [
                            at([points_ref[i, s * granules + g, c, u] for c in range(3)])
                            for g in range(granules)
                            for u in range(GRANULE)
                        ]
                        for value in _depths(kind, local, p[12:15], plane, faces):
                            best = jnp.maximum(best, value)
                        return best

                    low = size * 0.0 - 1e6
                    best = lax.fori_loop(0, samples // (granules * GRANULE), some, low)
                    return jnp.maximum(depth, _finished(kind, best, p[12:15]) * size)

                touched = jnp.max(reach - near) > 0.0
                return lax.cond(touched, deepest, lambda depth: depth, depth)

            depth = lax.fori_loop(first_ref[o], first_ref[o + 1], piece, depth)
        out_ref[i, o, here] = depth


def _root(square: Array) -> Array:
    return square * lax.rsqrt(jnp.maximum(square, 1e-24))


def _depths(
    kind: str, local: list[list[Array]], size: list[Array], plane: Callable, faces: int
) -> list[Array]:
    """Depths below the surface of points given by components; rough or unfinished outside.

    What is outside does not matter, so norms to edges and corners are left out, and for a capsule
    minus the squared distance to the axis is returned; see `_finished`.
    """
    if kind == "box":
        return [
            jnp.minimum(
                jnp.minimum(size[0] - jnp.abs(x), size[1] - jnp.abs(y)), size[2] - jnp.abs(z)
            )
            for x, y, z in local
        ]
    if kind == "capsule":
        found = []
        for x, y, z in local:
            over = jnp.maximum(jnp.abs(z) - size[1], 0.0)
            found.append(-(x * x + y * y + over * over))
        return found
    if kind == "cylinder":
        return [
            jnp.minimum(size[0] - _root(x * x + y * y), size[1] - jnp.abs(z)) for x, y, z in local
        ]
    if kind == "ellipsoid":
        inverse = [1.0 / s for s in size]
        least = jnp.minimum(jnp.minimum(size[0], size[1]), size[2])
        found = []
        for point in local:
            a = [v * w for v, w in zip(point, inverse, strict=True)]
            near = _root(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
            b = [v * w for v, w in zip(a, inverse, strict=True)]
            steep = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
            depth = near * (1.0 - near) * lax.rsqrt(jnp.maximum(steep, 1e-18))
            found.append(jnp.where(steep > 1e-18, depth, least))
        return found
    if kind == "sector":
        local = [[*_folded(x, y, size[0]), z] for x, y, z in local]

    def one(f: Array, far: tuple[Array, ...]) -> tuple[Array, ...]:
        a, b, c, d = (plane(f, k) for k in range(4))
        return tuple(
            jnp.minimum(value, ((d - a * x) - b * y) - c * z)
            for value, (x, y, z) in zip(far, local, strict=True)
        )

    start = tuple(x * 0.0 + 1e6 for x, _, _ in local)
    return list(lax.fori_loop(0, faces, one, start))


def _bound(kind: str, point: list[Array], size: list[Array], plane: Callable, faces: int) -> Array:
    """Bound the distance to the surface from below; grows no faster than the way covered."""
    if kind == "capsule":
        return -_finished(kind, _depths(kind, [point], size, plane, faces)[0], size)
    if kind == "ellipsoid":
        x, y, z = (v / s for v, s in zip(point, size, strict=True))
        square = x * x + y * y + z * z
        least = jnp.minimum(jnp.minimum(size[0], size[1]), size[2])
        return least * (_root(square) - 1.0)
    return -_depths(kind, [point], size, plane, faces)[0]


def _finished(kind: str, best: Array, size: list[Array]) -> Array:
    return size[0] - _root(-best) if kind == "capsule" else best


def _folded(x: Array, y: Array, times: Array) -> tuple[Array, Array]:
    """Turn points about z into the sector from 0 to 2 pi / times."""
    inverse = times * (1 / (2 * math.pi))
    # Mosaic GPU has no floor; angles are shifted so that cutting off rounds down.
    index = (_angle(y, x) * inverse + times).astype(jnp.int32).astype(jnp.float32) - times
    turn = index * (2 * math.pi / times)
    c, s = jnp.cos(turn), jnp.sin(turn)
    return c * x + s * y, c * y - s * x


def _angle(y: Array, x: Array) -> Array:
    """Compute atan2, which Mosaic GPU lacks, to 1e-5 (Abramowitz and Stegun, 4.4.47).

    That is enough to tell sectors apart: both give the same depth where they meet.
    """
    across, along = jnp.abs(x), jnp.abs(y)
    large = jnp.maximum(jnp.maximum(across, along), 1e-15)
    ratio = jnp.minimum(across, along) * lax.rsqrt(large * large)
    square = ratio * ratio
    found = square * 0.0208351 - 0.0851330
    for factor in (0.1801410, -0.3302995, 0.9998660):
        found = found * square + factor
    found = found * ratio
    found = jnp.where(along > across, math.pi / 2 - found, found)
    found = jnp.where(x < 0.0, math.pi - found, found)
    return jnp.where(y < 0.0, -found, found)


@functools.partial(jax.custom_vjp, nondiff_argnums=(5, 6))
def _fast(pos, rot, scale, samples, solids, tuning, interpret):
    return pair_depth_kernel(pos, rot, scale, samples, solids, tuning=tuning, interpret=interpret)


def _fast_forward(pos, rot, scale, samples, solids, tuning, interpret):
    inputs = (pos, rot, scale, samples, solids)
    return _fast(*inputs, tuning, interpret), inputs


def _fast_backward(tuning, interpret, inputs, grad):
    # The reference is differentiated: it finds the same deepest samples, up to rounding.
    return jax.vjp(pair_depth_reference, *inputs)[1](grad)


_fast.defvjp(_fast_forward, _fast_backward)


def pair_depth(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    solids: Solids,
    *,
    impl: Impl = "auto",
    tuning: PairDepthTuning | None = None,
    interpret: bool = False,
) -> Float[Array, "pop object object"]:
    """Compute the depth [m] of i's samples in j's solids, at [candidate, i, j]. Differentiable.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m]; repeat a point to pad.
        solids: convex pieces in object frames at scale 1.
        impl: `jnp` is plain XLA, `pallas` the kernel for NVIDIA GPUs from Hopper on, `auto` the
            one that was measured to be faster; see `choose`.
        tuning: of the kernel.
        interpret: run the kernel on any device, slowly.

    Returns:
        Depths, zero where nothing penetrates; the diagonal is zero.
    """
    if impl == "auto":
        impl = choose(scale.shape[0], scale.shape[1], samples.shape[1], solids)
    if impl == "jnp":
        return pair_depth_reference(pos, rot, scale, samples, solids)
    return _fast(pos, rot, scale, samples, solids, tuning, interpret)


def choose(pop: int, objects: int, samples: int, solids: Solids) -> Literal["jnp", "pallas"]:
    """Pick the faster implementation on JAX's default device, from `MEASURED`.

    Devices that were not measured take plain XLA.

    Args:
        pop: number of candidates.
        objects: number of objects.
        samples: surface samples of each.
        solids: the pieces.
    """
    if jax.default_backend() != "gpu":
        return "jnp"
    found = MEASURED["devices"].get(jax.devices()[0].device_kind)
    pieces = sum(group.owner.shape[0] for group in solids)
    work = pop * objects * samples * pieces
    return "pallas" if found is not None and work >= found["pallas_from"] else "jnp"
