"""Many refinements as one computation: points and seeds folded into the population axis.

Options that are traced become arrays with a leading [run] axis; drawing, scoring and fitting are one
program mapped over it, and rollouts take the candidates of all runs at once. A run that has stopped
keeps its state and is not computed any more.

On accelerators the map is a `vmap`, in tiles. On a CPU nothing is gained by that, and sums would round
differently than in a refinement by itself: there a tile is one run, and with the engine `native` every
number is that of a separate refinement, to the last bit.
"""

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..physics.engine import Engine, Rollout, RolloutStatus
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel
from ..refinement.cem import CEM, CEMParams, CEMState
from ..refinement.credit import shared
from ..refinement.loop import Search
from ..refinement.outcome import Round
from ..refinement.rewards import Scores, Term, Weights, placed, score

TILE = 8192
"""Candidates that are drawn and scored at once, on accelerators."""
FILLS = 4
"""Rollouts of fewer and fewer runs have at most so many shapes, each half of the one before."""
_log = logging.getLogger(__name__)


class Run(NamedTuple):
    """One refinement of a scene."""

    options: RefineOptions
    seed: int
    start: Layout | None = None
    """Pop axis of length 1; None is the composed scene."""


class Searched(NamedTuple):
    """What a run's search found, before the exact check."""

    rounds: list[Round]
    """Of each iteration the candidates that may be finalists, in the order of the population."""
    iterations: int
    rollouts: int


class _Runs(eqx.Module):
    """Traced halves of all runs, leading axis [run]."""

    key: jax.Array
    state: CEMState
    params: CEMParams
    w: Weights
    partners: jax.Array | None
    seen_valid: jax.Array


def search_folded(
    model: SceneModel, runs: Sequence[Run], engine: Engine
) -> tuple[list[Searched], dict[str, float]]:
    """Search for all runs at once, without pruning.

    Args:
        model: the compiled scene.
        runs: whose options differ in traced ones and those of `grouping.HOST` alone.
        engine: what rolls candidates out.

    Returns:
        What each run found, and seconds spent by step.
    """
    clock: dict[str, float] = dict.fromkeys(("descent", "rollout"), 0.0)
    began = time.perf_counter()
    searches = _opened(model, runs, engine, clock)
    one = searches[0]
    largest = max(one.method(0).population, one.method(1).population)
    tile = tile_of(len(runs), largest)
    tiles = -(-len(runs) // tile)
    every = _stacked(searches, runs)
    found = [Searched([], 0, 0) for _ in runs]
    live = list(range(len(runs)))
    for t in range(max(run.options.cem.iterations for run in runs)):
        live = [k for k in live if t < runs[k].options.cem.iterations]
        if not live:
            break
        cem, count = one.method(t), jnp.asarray(len(live))
        order = np.zeros(tiles * tile, np.int32)
        order[: len(live)] = live
        layouts = _draw(cem, every, jnp.asarray(order), count, jnp.asarray(t), tile)
        layouts = _projected(searches, live, layouts, t)
        rollout = _rolled(one, layouts, len(live))
        every, scores, poses = _judge(
            model,
            cem,
            one.terms,
            every,
            layouts,
            rollout,
            jnp.asarray(order),
            count,
            tile,
            one.o.cem.credit == "auto",
        )
        host = jax.tree.map(np.asarray, (layouts, poses, scores))
        gain = np.asarray(every.state.gain)
        still = []
        for row, k in enumerate(live):
            mine = jax.tree.map(lambda x, row=row: x[row], host)
            kept = _finalists(mine, runs[k].options.finalists)
            before = found[k]
            found[k] = Searched([*before.rounds, kept], t + 1, before.rollouts + len(mine[0].yaw))
            if not searches[k].enough(bool(mine[2].valid.any()), float(gain[k])):
                still.append(k)
        _log.info(
            "iteration %d: %d runs x %d candidates, %d runs go on",
            *(t + 1, len(live), cem.population, len(still)),
        )
        live = still
    return found, clock | {"search": time.perf_counter() - began}


def tile_of(runs: int, population: int) -> int:
    """Return how many runs are drawn and scored at once."""
    if jax.default_backend() == "cpu":
        return 1
    return max(1, min(runs, TILE // population))


def _opened(
    model: SceneModel, runs: Sequence[Run], engine: Engine, clock: dict[str, float]
) -> list[Search]:
    """Open a search for each run; those that start alike share one descent."""
    # Not a vmap over starts: its gradients round differently, and Adam carries that on.
    known: dict[Any, Layout] = {}
    found = []
    for run in runs:
        c, at = run.options.cem, jax.tree.leaves(run.start)
        alike = (c.sigma_xy, c.sigma_yaw_deg, c.sigma_log_scale)
        alike += tuple(np.asarray(leaf).tobytes() for leaf in at)
        search = Search(model, run.options, engine, clock, run.start, known.get(alike))
        known.setdefault(alike, search.state.mean)
        found.append(search)
    return found


def _stacked(searches: Sequence[Search], runs: Sequence[Run]) -> _Runs:
    stack: Callable[..., Any] = lambda *rows: jnp.asarray(np.stack([np.asarray(r) for r in rows]))
    together = lambda name: jax.tree.map(stack, *(getattr(s, name) for s in searches))
    partners = [s.partners for s in searches]
    return _Runs(
        jnp.stack([jax.random.key(run.seed) for run in runs]),
        together("state"),
        together("params"),
        together("w"),
        None if partners[0] is None else stack(*partners),
        jnp.zeros(len(runs), bool),
    )


def _tiled(f: Callable[..., Any], xs: Any, count: jax.Array, tile: int) -> Any:
    """Map `f` over the leading axis, `tile` at once; tiles that begin beyond `count` are skipped."""
    total = jax.tree.leaves(xs)[0].shape[0]
    if tile == 1:
        many = lambda *x: jax.tree.map(lambda y: y[None], f(*jax.tree.map(lambda y: y[0], x)))
    else:
        many = jax.vmap(f)
    cut = jax.tree.map(lambda x: x.reshape(total // tile, tile, *x.shape[1:]), xs)
    shape = jax.eval_shape(many, *jax.tree.map(lambda x: x[0], cut))
    nothing = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape)
    first = jnp.arange(total // tile) * tile
    found = jax.lax.map(
        lambda x: jax.lax.cond(x[0] < count, lambda: many(*x[1]), lambda: nothing),
        (first, cut),
    )
    return jax.tree.map(lambda x: x.reshape(total, *x.shape[2:]), found)


@eqx.filter_jit
def _draw(
    cem: CEM, every: _Runs, order: jax.Array, count: jax.Array, t: jax.Array, tile: int
) -> Layout:
    """Draw the populations of the first `count` runs of `order`; leading axes [row, pop]."""
    one = lambda key, state, params: cem.ask(jax.random.fold_in(key, t), state, params)
    taken = jax.tree.map(lambda x: x[order], (every.key, every.state, every.params))
    return _tiled(one, taken, count, tile)


def _projected(searches: Sequence[Search], live: Sequence[int], layouts: Layout, t: int) -> Layout:
    """Move the candidates of those runs whose options say so out of interpenetration."""
    moved = jax.tree.map(np.array, layouts)
    changed = False
    for row, k in enumerate(live):
        drawn = Layout(*(jnp.asarray(leaf[row]) for leaf in jax.tree.leaves(moved)))
        mine = searches[k].project(drawn, t)
        if mine is drawn:
            continue
        changed = True
        for whole, part in zip(jax.tree.leaves(moved), jax.tree.leaves(mine), strict=True):
            whole[row] = np.asarray(part)
    return jax.tree.map(jnp.asarray, moved) if changed else layouts


def _rolled(search: Search, layouts: Layout, count: int) -> Rollout:
    """Roll the candidates of the first `count` rows out at once; the others' poses are zeros.

    They are filled up with candidates that no engine simulates, so that few shapes are compiled.
    """
    rows, pop = layouts.yaw.shape[:2]
    most = min(m for m in (-(-rows // 2**k) for k in range(FILLS)) if m >= count)
    host = jax.tree.map(lambda x: np.array(x[:most]).reshape(most * pop, *x.shape[2:]), layouts)
    for leaf in jax.tree.leaves(host):
        leaf[count * pop :] = np.nan
    found = search.rollout(search.model.place(jax.tree.map(jnp.asarray, host)))

    def spread(x: Any) -> jax.Array:
        x = np.asarray(x)
        whole = np.zeros((rows, pop, *x.shape[1:]), x.dtype)
        whole[:count] = x.reshape(most, pop, *x.shape[1:])[:count]
        return jnp.asarray(whole)

    status = np.full((rows, pop), int(RolloutStatus.FAILED), np.int32)
    status[:count] = np.asarray(found.status).reshape(most, pop)[:count]
    return Rollout(
        time=jnp.asarray(np.tile(np.asarray(found.time), (rows, 1))),
        pos=spread(found.pos),
        quat=spread(found.quat),
        joint_shift=spread(found.joint_shift),
        status=jnp.asarray(status),
        start=jax.tree.map(spread, found.start),
        steps=spread(found.steps),
    )


@eqx.filter_jit
def _judge(
    model: SceneModel,
    cem: CEM,
    terms: tuple[Term, ...],
    every: _Runs,
    layouts: Layout,
    rollout: Rollout,
    order: jax.Array,
    count: jax.Array,
    tile: int,
    auto: bool,
) -> tuple[_Runs, Scores, Poses]:
    """Score the populations of the first `count` runs of `order` and fit their Gaussians.

    With `auto` elites are by objects until a run has seen something valid.

    Returns:
        The runs, and scores and places with leading axes [row, pop].
    """

    def one(z: Layout, rolled: Rollout, run: _Runs) -> tuple[CEMState, jax.Array, Scores, Poses]:
        before = placed(model, z, run.w)
        found = score(model, z, rolled, run.w, terms, before)
        seen = run.seen_valid | jnp.any(found.valid)
        credit = None
        if run.partners is not None:
            credit = shared(found, run.partners, by_object=~seen if auto else True)
        state = cem.tell(run.state, z, found.reward, found.absolute, run.params, credit)
        return state, seen, found, before.start

    taken = jax.tree.map(lambda x: x[order], every)
    state, seen, found, poses = _tiled(one, (layouts, rollout, taken), count, tile)
    runs = every.key.shape[0]
    # Rows beyond `count` go nowhere.
    to = jnp.where(jnp.arange(len(order)) < count, order, runs)
    put = lambda old, new: old.at[to].set(new, mode="drop")
    changed = jax.tree.map(put, (every.state, every.seen_valid), (state, seen))
    return eqx.tree_at(lambda e: (e.state, e.seen_valid), every, changed), found, poses


def _finalists(round_: Round, most: int) -> Round:
    """Keep the candidates of an iteration that may be among the best `most` of all."""
    layouts, poses, scores = round_
    best = np.lexsort((-np.asarray(scores.absolute), ~np.asarray(scores.valid)))[:most]
    best = np.sort(best)  # Equal ones are taken in the order of the population.
    few = Scores(
        **{
            name: getattr(scores, name)[..., best] if name != "credit" else scores.credit[best]
            for name in scores.__dataclass_fields__
        }
    )
    return jax.tree.map(lambda x: x[best], layouts), jax.tree.map(lambda x: x[best], poses), few
