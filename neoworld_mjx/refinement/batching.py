"""Mapping of pure functions over runs, and rollouts of the candidates of all runs together."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh

from ..cache import computes_on_cpu
from ..config import RefineOptions
from ..physics.array_types import AnyArray
from ..physics.engine import EarlyStop, Engine, Rollout, zero_duration_rollout
from ..physics.layout import Poses
from ..physics.model import SceneModel
from ..physics.scene_arrays import SceneArrays, pad_axis, pad_objects
from ..physics.settling import settle
from ..physics.sharding import REPLICATED, SHARDED, device_mesh, map_shards, put

TILE = 8192
"""Number of candidates that are sampled and scored at once on an accelerator."""
MAX_BATCH_SIZES = 4
"""Largest number of batch sizes for which rollouts are compiled as runs finish.

Each batch size is half of the previous one.
"""


def tile_size(runs: int, population: int) -> int:
    """Return the number of runs that are sampled and scored at once, over all devices."""
    if computes_on_cpu():
        return 1
    count = len(devices())
    tile = max(1, min(runs, count * TILE // population))
    return tile if tile == 1 else -(-tile // count) * count


def devices() -> list[Any]:
    """Return the devices that share the work: one if `jax.default_device` is set, else all."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    return jax.local_devices() if chosen is None else jax.local_devices()[:1]


def shard(tree: Any, length: int) -> Any:
    """Shard the arrays whose leading axis has a given length over the devices; replicate the rest.

    If there is one device, or if the length is not a multiple of the number of devices, return the
    tree unchanged.
    """
    mesh = device_mesh(devices())
    if mesh is None or length < 1 or length % mesh.size:
        return tree
    arrays, rest = eqx.partition(tree, _is_array)
    spec_of = lambda x: SHARDED if np.shape(x)[:1] == (length,) else REPLICATED
    return eqx.combine(jax.tree.map(lambda x: put(x, mesh, spec_of(x)), arrays), rest)


def map_runs(
    fn: Callable[..., Any],
    scene: SceneArrays,
    rows: Sequence[tuple[Any, ...]],
    tile: int,
    population: int = 0,
) -> list[Any]:
    """Call `fn(scene, *row)` for the row of every run, with `vmap` over `tile` runs at a time.

    The last tile is padded by repeating its last row, so that only one shape is compiled. If a tile
    is a single run, `fn` is called without `vmap`, as in a single refinement. If there are several
    devices, they share the runs of a tile, or the candidates of a single run.

    Args:
        fn: pure function of a scene and a row.
        scene: the scene's arrays.
        rows: arguments of `fn` for each run.
        tile: number of runs that are batched.
        population: number of candidates of a run; 0 if no argument has a population axis.
    """
    if tile == 1 or len(rows) == 1:
        return [jax.device_get(fn(scene, *shard(row, population))) for row in rows]
    mapped = _map_compiled(fn, device_mesh(devices()))
    results = []
    for first in range(0, len(rows), tile):
        tile_rows = list(rows[first : first + tile])
        stacked_rows = stack([*tile_rows, *[tile_rows[-1]] * (tile - len(tile_rows))])
        stacked_results = jax.device_get(mapped(scene, shard(stacked_rows, tile)))
        results += [
            jax.tree.map(lambda x, k=k: x[k], stacked_results) for k in range(len(tile_rows))
        ]
    return results


@functools.cache
def _map_compiled(fn: Callable[..., Any], mesh: Mesh | None) -> Callable[..., Any]:
    def mapped(scene: SceneArrays, rows: Any) -> Any:
        parts, rest = eqx.partition((scene, rows), eqx.is_array)

        def part(scene_arrays: Any, row_arrays: Any) -> Any:
            scene, rows = eqx.combine((scene_arrays, row_arrays), rest)
            return eqx.filter_vmap(lambda row: fn(scene, *row))(rows)

        return map_shards(part, mesh, REPLICATED, SHARDED)(*parts)

    return eqx.filter_jit(mapped)


def stack(rows: Sequence[Any]) -> Any:
    """Stack the arrays of pytrees, such as problems or states of runs, on a new leading axis.

    Leaves that are not arrays, such as the functions of terms, are taken from the first tree.
    Arrays are stacked on the host, so each stacked array is transferred to the device once.

    Raises:
        ValueError: the trees differ in structure, for example because a static option differs.
    """
    structure = jax.tree.structure(rows[0])
    if any(jax.tree.structure(row) != structure for row in rows[1:]):
        raise ValueError("stack: the trees differ in structure, for example in a static option")
    arrays, rest = zip(*(eqx.partition(row, _is_array) for row in rows), strict=True)
    return eqx.combine(jax.tree.map(lambda *x: np.stack(x), *arrays), rest[0])


def _is_array(x: Any) -> bool:
    return isinstance(x, jax.Array | np.ndarray | np.generic)


def take(tree: Any, rows: np.ndarray | slice) -> Any:
    """Select candidates of a population on the host."""
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def concatenate_candidates(parts: Sequence[Any]) -> Any:
    """Concatenate candidates along their leading axis on the host."""
    return jax.tree.map(lambda *x: np.concatenate([np.asarray(leaf) for leaf in x]), *parts)


def roll_out(
    scene: SceneModel,
    poses: Sequence[Poses],
    engine: Engine,
    o: RefineOptions,
    runs: int,
) -> list[Rollout]:
    """Roll out the placed candidates of several runs at once.

    Args:
        scene: the compiled scene.
        poses: poses of each run's candidates, on the host, including padded objects.
        engine: physics engine.
        o: options of the rollouts.
        runs: number of runs at the start of the search.

    Returns:
        One rollout per run, on the host and without padded objects.
    """
    all_poses, rows = _concatenate(poses, len(scene.names), runs)
    r = o.rollout
    if r.duration_s:
        rollout = engine.rollout(
            scene,
            all_poses,
            duration=r.duration_s,
            record_every=r.record_every_s,
            early_stop=early_stop_rule(o) if r.early_stop else None,
        )
    else:
        rollout = zero_duration_rollout(scene, all_poses)
    host = jax.device_get(rollout)
    by_run = []
    for run_rows in rows:
        part = jax.tree.map(lambda x, index=run_rows: x[index], host)
        by_run.append(eqx.tree_at(lambda r: r.time, part, host.time))
    return by_run


def settle_candidates(
    scene: SceneModel, poses: Sequence[Poses], engine: Engine, o: RefineOptions, runs: int
) -> list[Poses]:
    """Settle the placed candidates of several runs at once; the arguments are as in `roll_out`."""
    object_count = len(scene.names)
    all_poses, rows = _concatenate(poses, object_count, runs)
    ends = settle(scene, all_poses, engine, o.settle)
    return [
        jax.tree.map(
            lambda whole, end, index=index: with_replaced(
                whole, end[index], np.s_[:, :object_count]
            ),
            placed,
            ends,
        )
        for placed, index in zip(poses, rows, strict=True)
    ]


def _concatenate(poses: Sequence[Poses], object_count: int, runs: int) -> tuple[Poses, list[slice]]:
    """Concatenate the candidates of several runs, without padded objects.

    The result is padded with candidates of NaN, which no engine simulates, so that only a few
    shapes are compiled as runs finish.

    Args:
        poses: poses of each run's candidates, on the host.
        object_count: number of objects without padding.
        runs: number of runs at the start of the search.

    Returns:
        The poses of all candidates, and for each run the slice of its candidates.
    """
    counts = [len(placed.scale) for placed in poses]
    candidate_count, sizes = (
        sum(counts),
        [-(-runs // 2**k) * max(counts) for k in range(MAX_BATCH_SIZES)],
    )
    padding = min(size for size in sizes if size >= candidate_count) - candidate_count

    def concatenate(*arrays: np.ndarray) -> np.ndarray:
        whole = np.concatenate([x[:, :object_count] for x in arrays])
        widths = [(0, padding), *[(0, 0)] * (whole.ndim - 1)]
        return np.pad(whole, widths, constant_values=np.nan)

    all_poses = jax.tree.map(concatenate, *poses)
    ends = np.cumsum(counts)
    return all_poses, [slice(end - n, end) for end, n in zip(ends, counts, strict=True)]


def with_replaced(whole: np.ndarray, part: np.ndarray, index: Any) -> np.ndarray:
    """Return a copy of an array in which `part` replaces the entries at `index`."""
    copied = np.array(whole)
    copied[index] = part
    return copied


def pad_rollout(rollout: Rollout, scene: SceneArrays) -> Rollout:
    """Pad a rollout on the host to the size of a padded scene; padded objects do not move."""
    objects, joints = scene.count, len(scene.joint_object)
    start = pad_objects(rollout.start, objects)

    def pad(x: AnyArray, length: int) -> np.ndarray:
        return np.moveaxis(pad_axis(np.moveaxis(np.asarray(x), 2, 0), length), 0, 2)

    return Rollout(
        time=rollout.time,
        pos=pad(rollout.pos, objects),
        quat=pad(rollout.quat, objects),
        joint_shift=pad(rollout.joint_shift, joints),
        status=rollout.status,
        start=start,
        steps=rollout.steps,
    )


def early_stop_rule(o: RefineOptions) -> EarlyStop:
    """Return the rule by which rollouts stop early, from the bounds and the cap of D_drift.

    Drift beyond the cap changes neither the validity nor the reward of a candidate.
    """
    distance, angle = o.reward.drift_scale_m, float(np.radians(o.reward.tilt_scale_deg))
    cap = o.reward.d_drift_cap
    return EarlyStop(distance=distance, angle=angle, drift=cap * distance, tilt=cap * angle)
