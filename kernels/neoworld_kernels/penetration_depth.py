"""Deepest penetration of surface samples into convex colliders, for a population of poses.

For every candidate and ordered pair of objects (i, j), `pair_depth` is the depth of the deepest
surface sample of i in the convex pieces of j: the maximum over samples and pieces of the negated
signed distance, clipped at zero. It is differentiable almost everywhere.
"""

import functools
import json
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .convex_pieces import Colliders, PieceGroup, distance
from .culled import dot, pair_depth_culled
from .fused import PairDepthTuning, pair_depth_kernel

__all__ = [
    "PairDepthTuning",
    "choose",
    "pair_depth",
    "pair_depth_culled",
    "pair_depth_reference",
    "pair_gap",
]

Impl = Literal["auto", "jnp", "culled", "pallas"]

KERNEL_TIMES = json.loads((Path(__file__).parent / "penetration_measured.json").read_text())
"""Measured times of the kernel and of plain XLA for each GPU, and the problem size (`pallas_from`)
from which `choose` selects the kernel."""


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


@functools.partial(jax.custom_vjp, nondiff_argnums=(5, 6))
def _kernel_depth(pos, rot, scale, samples, colliders, tuning, interpret):
    return pair_depth_kernel(
        pos, rot, scale, samples, colliders, tuning=tuning, interpret=interpret
    )


def _kernel_depth_forward(pos, rot, scale, samples, colliders, tuning, interpret):
    inputs = (pos, rot, scale, samples, colliders)
    return _kernel_depth(*inputs, tuning, interpret), inputs


def _kernel_depth_backward(tuning, interpret, inputs, grad):
    # The reference has the same deepest samples, up to rounding.
    return jax.vjp(pair_depth_reference, *inputs)[1](grad)


_kernel_depth.defvjp(_kernel_depth_forward, _kernel_depth_backward)


def pair_depth(
    pos: Float[Array, "pop object 3"],
    rot: Float[Array, "pop object 3 3"],
    scale: Float[Array, "pop object"],
    samples: Float[Array, "object sample 3"],
    colliders: Colliders,
    *,
    impl: Impl = "auto",
    tuning: PairDepthTuning | None = None,
    interpret: bool = False,
) -> Float[Array, "pop object object"]:
    """Compute the depth of i's deepest sample in j's colliders [m], at [candidate, i, j].

    Differentiable.

    Args:
        pos: object origins in the world [m].
        rot: object rotations.
        scale: isotropic scale of each object about its origin.
        samples: surface points in object frames at scale 1 [m]. Repeat points for padding.
        colliders: convex pieces in object frames at scale 1.
        impl: `jnp` evaluates all pairs in plain XLA. `culled` evaluates only pairs that can touch.
            `pallas` is the kernel for NVIDIA GPUs from Hopper on. `auto` selects one of them; see
            `choose`.
        tuning: block sizes of the kernel; if None, the defaults are used.
        interpret: if True, run the kernel in Pallas's interpreter, on any device but slowly.

    Returns:
        Depths, zero for pairs that do not penetrate and on the diagonal.
    """
    if impl == "auto":
        impl = choose(scale.shape[0], scale.shape[1], samples.shape[1], colliders)
    if impl == "jnp":
        return pair_depth_reference(pos, rot, scale, samples, colliders)
    if impl == "culled":
        return pair_depth_culled(pos, rot, scale, samples, colliders)
    return _kernel_depth(pos, rot, scale, samples, colliders, tuning, interpret)


def choose(
    pop: int, objects: int, samples: int, colliders: Colliders
) -> Literal["jnp", "culled", "pallas"]:
    """Select the fastest implementation on JAX's default device, by `KERNEL_TIMES`.

    On CPUs, `culled` is selected. It is slower than `jnp` only for a single candidate, by a
    millisecond. On GPUs without measurements, `jnp` is selected.
    """
    pieces = sum(group.owner.shape[0] for group in colliders)
    work = pop * objects * samples * pieces
    device = _device()
    if device.platform == "cpu":
        return "culled"
    times = KERNEL_TIMES["devices"].get(device.device_kind) if device.platform == "gpu" else None
    least = None if times is None else times["pallas_from"]
    return "pallas" if least is not None and work >= least else "jnp"


def _device() -> Any:
    """Return the device on which JAX creates arrays; see `jax.default_device`."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    return jax.devices(chosen)[0] if chosen is None or isinstance(chosen, str) else chosen
