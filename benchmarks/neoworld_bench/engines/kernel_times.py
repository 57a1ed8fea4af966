"""Times of the implementations of the penetration term, and their errors against the reference.

One row for each implementation; the row of one that cannot run on this device has the reason.
"""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from neoworld_kernels import Colliders, pair_depth, pair_depth_culled, pair_depth_reference

from neoworld_mjx.errors import ConfigError, EngineError
from neoworld_mjx.io.files import write_atomic
from neoworld_mjx.physics.array_types import AnyArray
from neoworld_mjx.physics.layout import Poses, rotation
from neoworld_mjx.physics.model import SceneModel, compile_scene

from ..rows import Row
from .table_scenes import Noise, crowded, noisy_layouts

REPEATS = 7
CALLS = 10
"""Consecutive calls per measured time, so that the device does not wait for the host."""
TOLERANCE = 1e-5
"""Difference from the reference [m] above which a row has no time."""

Depth = Callable[..., Float[Array, "pop object object"]]


class KernelRow(Row):
    """Result of one implementation at one size; None where it cannot run."""

    implementation: str
    objects: int
    """Number of objects, including the table."""
    population: int
    samples: int
    pieces: int
    """Number of convex pieces of all objects."""
    compile_s: float | None = None
    """Time of the first call minus that of a steady one."""
    ms: float | None = None
    """Median time for a population."""
    gradient_ms: float | None = None
    """Median time of the summed depth with its gradient with respect to positions."""
    distances_per_s: float | None = None
    """Rate of signed distances of one sample and one piece; culled pairs count."""
    over_reference: float | None = None
    """Speedup over the reference."""
    max_error_m: float | None = None
    status: str = "ok"


def implementations() -> dict[str, Depth]:
    """Return the implementations of `pair_depth`, the reference first, the dispatched one last."""
    return {
        "jnp": pair_depth_reference,
        "culled": pair_depth_culled,
        "auto": pair_depth,
    }


def dispatch(rows: Sequence[KernelRow]) -> dict[str, Any]:
    """Return the entry of `penetration_measured.json` for these rows.

    The kernel is used from the smallest work size (candidates x objects x samples x pieces) from
    which on it is faster in every row.

    Raises:
        EngineError: no row timed both implementations.
    """
    times = {}
    for row in rows:
        if row.ms is not None:
            work = row.population * row.objects * row.samples * row.pieces
            times.setdefault((work, row.population, row.objects), {})[row.implementation] = row.ms
    both = [
        {"objects": objects, "population": population, "work": work, "jnp_ms": t["jnp"]}
        | {"pallas_ms": t["pallas"]}
        for (work, population, objects), t in sorted(times.items())
        if {"jnp", "pallas"} <= t.keys()
    ]
    if not both:
        raise EngineError("no size was timed with both jnp and pallas; run this on an NVIDIA GPU")
    slower = [row["work"] for row in both if row["pallas_ms"] >= row["jnp_ms"]]
    faster = [row["work"] for row in both if row["work"] > max(slower, default=0)]
    return {"pallas_from": min(faster) if faster else None, "jax": jax.__version__, "rows": both}


def update_dispatch_table(file: Path, rows: Sequence[KernelRow]) -> None:
    """Add or replace this device's entry in a JSON table of measured devices.

    Raises:
        ConfigError: the file is not such a table, or cannot be written.
        EngineError: see `dispatch`.
    """
    entry = dispatch(rows)
    try:
        table = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"devices": {}}
        table["devices"][jax.devices()[0].device_kind] = entry
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{file} is no table of measured devices: {error}") from None
    try:
        write_atomic(file, (json.dumps(table, indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"cannot write {file}: {error.strerror}") from None


def kernels(
    objects: Sequence[int] = (3, 10, 40),
    populations: Sequence[int] = (256, 4096),
    *,
    samples: int = 256,
    seed: int = 0,
    budget: float = 60.0,
) -> Iterator[KernelRow]:
    """Time every implementation of `pair_depth`.

    Args:
        objects: numbers of objects on the table.
        populations: numbers of candidates.
        samples: surface samples of each object.
        seed: of scenes and layouts.
        budget: time limit of the calls of a row [s]; a running call is not interrupted.
    """
    for count in objects:
        scene = compile_scene(crowded(count, seed=seed), samples=samples)
        for population in populations:
            layouts = noisy_layouts(scene, population, seed=seed, noise=Noise(xy=0.3))
            poses = jax.block_until_ready(scene.place(layouts))
            reference: tuple[Array, float] | None = None
            for name, depth in implementations().items():
                row, depths = _row(name, depth, scene, poses, samples, reference, budget)
                if name == "jnp" and depths is not None and row.ms is not None:
                    reference = (depths, row.ms)
                yield row


def _row(
    name: str,
    depth: Depth,
    scene: SceneModel,
    poses: Poses,
    samples: int,
    reference: tuple[Array, float] | None,
    budget: float,
) -> tuple[KernelRow, Array | None]:
    colliders: Colliders = scene.colliders
    pieces = sum(len(group.owner) for group in colliders)
    pop, objects = poses.scale.shape
    row = KernelRow(
        implementation=name, objects=objects, population=pop, samples=samples, pieces=pieces
    )

    def total(pos: Array, rot: Array, scale: Array) -> Array:
        return jnp.sum(depth(pos, rot, scale, scene.samples, colliders))

    arguments = (poses.pos, rotation(poses.quat), poses.scale)
    call = jax.jit(lambda pos, rot, scale: depth(pos, rot, scale, scene.samples, colliders))
    try:
        depths, first, ms = _timed(call, arguments, budget / 2)
        _, _, gradient = _timed(jax.jit(jax.value_and_grad(total)), arguments, budget / 2)
    except Exception as error:  # Compilers raise exceptions of many types.
        text = str(error).splitlines()[0][:160] if str(error) else ""
        return row.model_copy(update={"status": f"skipped: {type(error).__name__}: {text}"}), None
    gap = 0.0 if reference is None else float(np.abs(np.asarray(depths - reference[0])).max())
    if not np.isfinite(np.asarray(depths)).all() or gap > TOLERANCE:
        return row.model_copy(
            update={"max_error_m": gap, "status": "invalid: differs from the reference"}
        ), depths
    return row.model_copy(
        update={
            "compile_s": first,
            "ms": ms,
            "gradient_ms": gradient,
            "distances_per_s": pop * (objects - 1) * samples * pieces / (ms / 1e3),
            "over_reference": None if reference is None else reference[1] / ms,
            "max_error_m": gap,
        }
    ), depths


def _timed(call: Any, arguments: tuple[AnyArray, ...], budget: float) -> tuple[Any, float, float]:
    """Return the result, the extra time of the first call [s], and a call's median time [ms]."""
    began = time.perf_counter()
    result = jax.block_until_ready(call(*arguments))
    first = time.perf_counter() - began
    times: list[float] = []
    while len(times) < REPEATS and (not times or time.perf_counter() - began < budget):
        t0 = time.perf_counter()
        jax.block_until_ready([call(*arguments) for _ in range(CALLS)])
        times.append((time.perf_counter() - t0) / CALLS)
    steady = float(np.median(times))
    return result, max(first - steady, 0.0), 1e3 * steady
