"""Candidates or runs shared by several devices, each of which computes its part alone."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

PART, WHOLE = PartitionSpec("part"), PartitionSpec()
"""Specifications of an array that is split along its leading axis, and of one that is copied."""


def mesh_of(devices: Sequence[Any]) -> Mesh | None:
    """Return the mesh of several devices, None for a single one."""
    return Mesh(np.array(devices), ("part",)) if len(devices) > 1 else None


def put(tree: Any, mesh: Mesh, spec: PartitionSpec) -> Any:
    """Put all arrays of a tree on the devices of a mesh."""
    return jax.device_put(tree, NamedSharding(mesh, spec))


def by_part(fn: Callable[..., Any], mesh: Mesh | None, *specs: Any) -> Callable[..., Any]:
    """Return a function that calls `fn` on every device with that device's part of the arguments.

    The parts must not depend on each other. Without it, XLA would compute some operations, such as
    `top_k`, for all parts on every device, which then wait for each other in every step.

    Args:
        fn: function of arrays whose results have the leading axis that is split.
        mesh: the devices; None for a single one, which calls `fn` itself.
        specs: PART or WHOLE for each argument, or a tree of them.
    """
    if mesh is None:
        return fn
    return jax.shard_map(fn, mesh=mesh, in_specs=specs, out_specs=PART, check_vma=False)
