"""Distribution of candidates or runs over several devices that compute independently."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

SHARDED, REPLICATED = PartitionSpec("part"), PartitionSpec()
"""Partition specifications: SHARDED splits an array along its leading axis, REPLICATED copies it.
"""


def device_mesh(devices: Sequence[Any]) -> Mesh | None:
    """Return a mesh of several devices, or None for a single device."""
    return Mesh(np.array(devices), ("part",)) if len(devices) > 1 else None


def put(tree: Any, mesh: Mesh, spec: PartitionSpec) -> Any:
    """Put all arrays of a tree on the devices of a mesh."""
    return jax.device_put(tree, NamedSharding(mesh, spec))


def over_devices(tree: Any) -> Any:
    """Shard arrays [pop, ...] over the local devices, or return them unchanged.

    They are unchanged on a single device, if `jax.default_device` is set, and if the population is
    not a multiple of the number of devices.
    """
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    mesh = device_mesh(jax.local_devices() if chosen is None else [chosen])
    if mesh is None or len(jax.tree.leaves(tree)[0]) % mesh.size:
        return tree
    return put(tree, mesh, SHARDED)


def map_shards(fn: Callable[..., Any], mesh: Mesh | None, *specs: Any) -> Callable[..., Any]:
    """Return a function that calls `fn` on every device with that device's part of the arguments.

    The parts must not depend on each other. With automatic sharding instead, XLA would compute some
    operations, such as `top_k`, for all parts on every device, and the devices would wait for each
    other in every step.

    Args:
        fn: function of arrays. Its results must have the leading axis that is split.
        mesh: the devices; if None, there is a single device, and `fn` itself is returned.
        specs: for each argument, SHARDED, REPLICATED, or a tree of both.
    """
    if mesh is None:
        return fn
    return jax.shard_map(fn, mesh=mesh, in_specs=specs, out_specs=SHARDED, check_vma=False)
