"""What a refinement is held against: sequential Algorithm 1, random search and CMA-ES."""

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from ..config import RefineOptions
from ..errors import EngineError
from ..physics.engine import EarlyStop, Engine, Rollout, record_steps, unplaceable
from ..physics.layout import Layout, Poses
from ..physics.mjcf import to_mjspec
from ..physics.model import SceneModel
from ..physics.recorder import Recorder, joined
from ..refinement.loop import Search
from ..refinement.outcome import Round, choose
from ..refinement.rewards import Scores, placed, score
from ..spec import SceneSpec
from ..spec.scene import rearranged
from .verdicts import started

CMA_POPULATION = 16
"""Candidates that CMA-ES draws at once; 4 + 3 ln n is 13 to 15 for its 16 to 40 numbers."""


class OneByOne:
    """The obvious engine: compile a candidate's scaled model, step it to the end, take the next."""

    name = "sequential"

    def rollout(
        self,
        scene: SceneModel,
        poses: Poses,
        *,
        duration: float = 1.0,
        record_every: float = 0.1,
        early_stop: EarlyStop | None = None,
    ) -> Rollout:
        """Simulate every candidate on one thread; see `Engine.rollout`. Nothing stops early."""
        timestep = scene.static.mjm.opt.timestep
        records, every = record_steps(timestep, duration, record_every)
        poses = jax.tree.map(lambda leaf: np.asarray(leaf, float), poses)
        failed = unplaceable(poses)
        parts = []
        for k in range(len(failed)):
            one = slice(k, k + 1)
            recorder = Recorder(scene.static, poses[one], records, every, None, failed[one])
            if not failed[k]:
                model, data = started(to_mjspec(_placed_scene(scene, poses, k), timestep=timestep))
                for t in range(records):
                    mujoco.mj_step(model, data, nstep=every)
                    recorder.record(t, data.qpos[None], None, None)
                    if not len(recorder.active):
                        break
            parts.append(recorder.rollout())
        return joined(parts, len(failed))


def _placed_scene(scene: SceneModel, poses: Poses, k: int) -> SceneSpec:
    """Describe candidate k with every object placed in the world instead of on its parent."""
    alone = {"parent": None, "parent_link": None, "xy": (0.0, 0.0), "yaw": 0.0}
    objects = tuple(
        item.model_copy(update={**alone, "base_tilt": tuple(poses.quat[k, i].tolist())})
        for i, item in enumerate(scene.spec.objects)
    )
    flat = scene.spec.model_copy(update={"objects": objects})
    yaw, pos = np.zeros(len(objects)), poses.pos[k]
    return rearranged(flat, pos[:, :2], yaw, np.log(poses.scale[k]), pos[:, 2])


def algorithm1(options: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1 as the paper has it, with the N, T, weights and terms given."""
    o = options
    cem = {"first": 0, "credit": "scene", "prune": False, "zero_candidate": False}
    cem |= {"sigma_floor": 0.0, "smoothing": 0.0, "patience": 1}
    return o.model_copy(
        update={
            "cem": o.cem.model_copy(update=cem),
            "descent": o.descent.model_copy(update={"warm_steps": 0, "project": "never"}),
            "reward": o.reward.model_copy(update={"normalisation": "iteration"}),
            "rollout": o.rollout.model_copy(update={"early_stop": False}),
        }
    )


class Searched(NamedTuple):
    """What a baseline found."""

    best: float
    """Highest absolute reward."""
    passed: bool
    layout: Layout
    to_valid_s: float
    total_s: float
    rollouts: int


def random_search(
    scene: SceneModel, o: RefineOptions, engine: Engine, start: Layout, *, rollouts: int, seed: int
) -> Searched:
    """Draw candidates from the initial Gaussian about the start, and take the best."""
    search = _Baseline(scene, o, engine, start)
    key = jax.random.key(seed)
    t = 0
    while search.rollouts < rollouts:
        state = search.search.state
        cem = search.search.cem
        drawn = cem.ask(jax.random.fold_in(key, t), state, search.search.params)
        search.judge(drawn[: min(o.cem.batch, rollouts - search.rollouts)])
        t += 1
    return search.found()


def cma_es(
    scene: SceneModel, o: RefineOptions, engine: Engine, start: Layout, *, rollouts: int, seed: int
) -> Searched:
    """Run CMA-ES (evosax) on the absolute reward, in units of the initial deviations.

    Raises:
        EngineError: evosax is not installed.
    """
    try:
        from evosax.algorithms import CMA_ES
    except ImportError:
        raise EngineError("baseline cma_es needs evosax: install neoworld-mjx[baselines]") from None
    search = _Baseline(scene, o, engine, start)
    params, mean = search.search.params, search.search.state.mean
    flat, unflat = _unit(params.sigma, mean)
    es: Any = CMA_ES(population_size=CMA_POPULATION, solution=flat)
    hyper = es.default_params
    key = jax.random.key(seed)
    state = es.init(jax.random.fold_in(key, 0), flat, hyper)
    t = 0
    while search.rollouts < rollouts:
        t += 1
        drawn, state = es.ask(jax.random.fold_in(key, 2 * t), state, hyper)
        found = search.judge(jax.vmap(unflat)(drawn))
        loss = jnp.where(jnp.isfinite(found.absolute), -found.absolute, 1e3)
        state, _ = es.tell(jax.random.fold_in(key, 2 * t + 1), drawn, loss, state, hyper)
    return search.found()


def _unit(sigma: Layout, mean: Layout) -> tuple[jax.Array, Any]:
    """Return zero in units of sigma over what moves, and the map from there to a layout."""
    leaves, tree = jax.tree.flatten(jax.tree.map(lambda x: x[0], sigma))
    about = jax.tree.leaves(jax.tree.map(lambda x: x[0], mean))
    free = [np.flatnonzero(np.asarray(leaf).ravel() > 0) for leaf in leaves]
    ends = np.cumsum([0, *(len(f) for f in free)])

    def unflat(x: jax.Array) -> Layout:
        made = []
        for leaf, middle, rows, a, b in zip(leaves, about, free, ends[:-1], ends[1:], strict=True):
            moved = middle.ravel().at[rows].add(x[a:b] * leaf.ravel()[rows])
            made.append(moved.reshape(leaf.shape))
        return jax.tree.unflatten(tree, made)

    return jnp.zeros(int(ends[-1])), unflat


class _Baseline:
    """Scores, clock and choice as a refinement has them, for a search that draws by itself."""

    def __init__(self, scene: SceneModel, o: RefineOptions, engine: Engine, start: Layout) -> None:
        self.scene, self.o = scene, o
        clock: dict[str, float] = dict.fromkeys(("descent", "rollout", "score"), 0.0)
        self.search = Search(scene, o, engine, clock, start)
        self.rounds: list[Round] = []
        self.rollouts = 0
        self.start = start

    def judge(self, layouts: Layout) -> Scores:
        s = self.search
        layouts = s.project(layouts, len(self.rounds))
        before = placed(self.scene, layouts, s.w)
        found = score(self.scene, layouts, s.rollout(before.start), s.w, (), before)
        s.note(jax.block_until_ready(found))
        self.rounds.append((layouts, before.start, found))
        self.rollouts += layouts.yaw.shape[0]
        return found

    def found(self) -> Searched:
        total = time.perf_counter() - self.search.began
        chosen = choose(self.scene, self.rounds, self.o, self.start)
        t, k = chosen.index
        best = max(float(np.asarray(s.absolute).max()) for _, _, s in self.rounds)
        layout = self.rounds[t][0][k : k + 1] if t >= 0 else self.start
        to_valid = self.search.first_valid_s
        return Searched(best, chosen.passed, layout, to_valid, total, self.rollouts)
