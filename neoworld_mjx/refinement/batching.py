"""Map pure functions over runs, and roll out the candidates of all runs together."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..config import RefineOptions
from ..physics.engine import EarlyStop, Engine, Rollout, unmoved
from ..physics.layout import Poses
from ..physics.model import SceneModel
from ..physics.scene_arrays import SceneArrays, pad_axis, pad_objects
from ..physics.settling import settle
from ..traces import computes_on_cpu

TILE = 8192
"""Candidates that are drawn and scored at once, on accelerators."""
SHAPES = 4
"""Rollouts of a falling number of runs have at most so many shapes, each half of the one before."""


def tile_of(runs: int, population: int) -> int:
    """Return how many runs are drawn and scored at once."""
    if computes_on_cpu():
        return 1
    return max(1, min(runs, TILE // population))


def map_runs(
    fn: Callable[..., Any], scene: SceneArrays, rows: Sequence[tuple[Any, ...]], tile: int
) -> list[Any]:
    """Call `fn(scene, *row)` for every run's row, `tile` runs at once by `vmap`.

    The last tile is filled up by repeating its last row, so that one shape is compiled. With a tile
    of one run `fn` is called as a single refinement calls it.
    """
    if tile == 1 or len(rows) == 1:
        return [jax.device_get(fn(scene, *row)) for row in rows]
    results = []
    for first in range(0, len(rows), tile):
        some = list(rows[first : first + tile])
        stacked_rows = _stack([*some, *[some[-1]] * (tile - len(some))])
        out = jax.device_get(_mapped(fn)(scene, stacked_rows))
        results += [jax.tree.map(lambda x, k=k: x[k], out) for k in range(len(some))]
    return results


@functools.cache
def _mapped(fn: Callable[..., Any]) -> Callable[..., Any]:
    return eqx.filter_jit(lambda scene, rows: eqx.filter_vmap(lambda row: fn(scene, *row))(rows))


def _stack(rows: Sequence[Any]) -> Any:
    """Stack the arrays of equal trees; what is no array is taken from the first.

    On the host, whence one array travels: on the device each row would be an operation of its own.
    """
    arrays, rest = zip(*(eqx.partition(row, _is_array) for row in rows), strict=True)
    return eqx.combine(jax.tree.map(lambda *x: np.stack(x), *arrays), rest[0])


def _is_array(x: Any) -> bool:
    return isinstance(x, jax.Array | np.ndarray | np.generic)


def take(tree: Any, rows: np.ndarray | slice) -> Any:
    """Take some candidates of a population on the host."""
    return jax.tree.map(lambda leaf: leaf[rows], tree)


def roll_out(
    scene: SceneModel,
    poses: Sequence[Poses],
    engine: Engine,
    o: RefineOptions,
    runs: int,
) -> list[Rollout]:
    """Roll the placed candidates of several runs out at once.

    Args:
        scene: the compiled scene.
        poses: of each run's candidates, on the host, of padded objects too.
        engine: what rolls them out.
        o: options of the rollouts.
        runs: how many there were at first.

    Returns:
        Rollouts on the host, without padded objects.
    """
    together, rows = _concatenate(poses, len(scene.names), runs)
    r = o.rollout
    if r.duration_s:
        rollout = engine.rollout(
            scene,
            together,
            duration=r.duration_s,
            record_every=r.record_every_s,
            early_stop=early_stop_rule(o) if r.early_stop else None,
        )
    else:
        rollout = unmoved(scene, together)
    host = jax.device_get(rollout)
    by_run = []
    for own_rows in rows:
        own = jax.tree.map(lambda x, at=own_rows: x[at], host)
        by_run.append(eqx.tree_at(lambda r: r.time, own, host.time))
    return by_run


def settled(
    scene: SceneModel, poses: Sequence[Poses], engine: Engine, o: RefineOptions, runs: int
) -> list[Poses]:
    """Let placed candidates of several runs come to rest, all at once; as `roll_out`."""
    real = len(scene.names)
    together, rows = _concatenate(poses, real, runs)
    ends = settle(scene, together, engine, o.rollout.duration_s)
    return [
        jax.tree.map(lambda whole, end, at=at: put(whole, end[at], np.s_[:, :real]), own, ends)
        for own, at in zip(poses, rows, strict=True)
    ]


def _concatenate(poses: Sequence[Poses], real: int, runs: int) -> tuple[Poses, list[slice]]:
    """Put the candidates of several runs together, without padded objects.

    They are filled up with candidates that no engine simulates, so that few shapes are compiled as
    runs stop.

    Args:
        poses: of each run's candidates, on the host.
        real: objects that are not padded.
        runs: how many there were at first.

    Returns:
        The candidates, and each run's rows of them.
    """
    counts = [len(own.scale) for own in poses]
    total, sizes = sum(counts), [-(-runs // 2**k) * max(counts) for k in range(SHAPES)]
    left = min(size for size in sizes if size >= total) - total
    fill = lambda x: np.pad(x, [(0, left), *[(0, 0)] * (x.ndim - 1)], constant_values=np.nan)
    together = jax.tree.map(lambda *x: fill(np.concatenate([a[:, :real] for a in x])), *poses)
    ends = np.cumsum(counts)
    return together, [slice(end - n, end) for end, n in zip(ends, counts, strict=True)]


def put(whole: np.ndarray, part: np.ndarray, at: Any) -> np.ndarray:
    """Return an array with another one at some of its entries."""
    copied = np.array(whole)
    copied[at] = part
    return copied


def pad_rollout(rollout: Rollout, scene: SceneArrays) -> Rollout:
    """Pad a rollout on the host to a padded scene: what is padded stays where it is."""
    objects, joints = scene.count, len(scene.joint_object)
    start = pad_objects(rollout.start, objects)
    pad = lambda x, n: np.moveaxis(pad_axis(np.moveaxis(x, 2, 0), n), 0, 2)
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
    """Return when rollouts may end early: past what the verdict and the reward tell apart."""
    distance, angle = o.reward.drift_scale_m, float(np.radians(o.reward.tilt_scale_deg))
    cap = o.reward.d_drift_cap
    return EarlyStop(distance=distance, angle=angle, drift=cap * distance, tilt=cap * angle)
