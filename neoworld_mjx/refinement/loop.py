"""Refining a composed scene: the loop of Algorithm 1 with what makes it faster, each an option."""

import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..config import RefineOptions
from ..errors import ConfigError
from ..mllm import Panel, Picture
from ..physics.engine import EarlyStop, Engine, Rollout, unmoved
from ..physics.layout import Layout, Poses
from ..physics.model import SceneModel, compile_scene
from ..physics.simulate import on_cpu, open_engine
from ..spec import SceneSpec
from .cem import CEM, CEMParams, CEMState, open_cem
from .credit import partners, shared
from .descent import descend
from .outcome import Refined, Round, choose, outcome, ranked, stacked
from .prune import score_elites
from .rewards import Placed, Scores, Term, Weights, bound, placed, score, user_terms, weights
from .scorer import Mark, SemanticScorer

FILLED = 16
"""How many times its candidates an iteration may evaluate to spare a compilation."""


def refine(
    scene: SceneSpec | SceneModel,
    options: RefineOptions | None = None,
    *,
    seed: int = 0,
    start: Layout | None = None,
    engine: Engine | None = None,
    photo: Picture | None = None,
    panel: Panel | None = None,
    scores: Path | None = None,
    recorded: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Refined:
    """Refine a composed scene by CEM (paper Section 3.3, Step 5).

    Stops after T iterations, or when the elites have gained less than `stop_gain` for `patience`
    iterations and a valid candidate has been seen. The winner is the best valid candidate by
    absolute reward that also passes an exact check; when none does, the best one that was tried is
    returned with `passed` False.

    Args:
        scene: the composed scene; one that is compiled already saves that time again.
        options: of the search, the rewards, the rollouts and the check.
        seed: of the population draws.
        start: the layout that the search starts at, pop axis of length 1; zero by default.
        engine: what rolls candidates out; opened from the options by default.
        photo: the photograph, for semantic scores by a model.
        panel: who gives them.
        scores: file to log them in.
        recorded: log of an earlier run whose scores, and their order of arrival, are followed.
        progress: called with one line an iteration.

    Raises:
        ConfigError: options that exclude each other, or scores by a model without a photograph.
        EngineError: the engine cannot run here.
    """
    o = options or RefineOptions()
    clock: dict[str, float] = dict.fromkeys(
        ("compile", "descent", "rollout", "score", "wait", "check"), 0.0
    )
    began = time.perf_counter()
    model = scene if isinstance(scene, SceneModel) else compiled(scene, o)
    search = Search(model, o, engine or open_engine(o.rollout.engine), clock, start)
    clock["compile"] = time.perf_counter() - began
    scorer = None
    if o.semantic.scorer == "mllm":
        scorer = SemanticScorer(
            model, photo, panel, o.semantic, cem=o.cem, log=scores, recorded=recorded
        )
    rounds: list[Round] = []
    marks: list[np.ndarray] = []
    key = jax.random.key(seed)
    try:
        for t in range(o.cem.iterations):
            layouts = search.ask(jax.random.fold_in(key, t), t)
            found, poses, how = search.judge(t, layouts, scorer)
            search.tell(t, layouts, found)
            rounds.append((layouts, poses, found))
            marks.append(how)
            if progress is not None:
                progress(_line(t, o.cem.iterations, found, search.state))
            if search.enough(bool(np.any(found.valid)), float(search.state.gain)):
                break
        clock["search"] = time.perf_counter() - search.began
        began = time.perf_counter()
        if scorer is not None:
            finalists = [index for index, _ in ranked(rounds)][: o.finalists]
            scorer.await_for(finalists)
            for t, (layouts, poses, found) in enumerate(rounds):
                rounds[t] = layouts, poses, _with_late(scorer, t, found, marks[t], o)
        clock["wait"] += time.perf_counter() - began
    finally:
        if scorer is not None:
            scorer.close()
    began = time.perf_counter()
    chosen = choose(model, rounds, o, start)
    clock["check"] = time.perf_counter() - began
    return outcome(
        model,
        rounds,
        chosen,
        o,
        start=start,
        engine=search.engine.name,
        clock=clock | {"to_valid": search.first_valid_s},
        semantic=None if scorer is None else stacked(marks, 0),
        scoring=None if scorer is None else scorer.summary(),
        fallbacks=() if scorer is None else scorer.fallbacks,
    )


def compiled(scene: SceneSpec, o: RefineOptions) -> SceneModel:
    """Compile a scene as a refinement with these options needs it; the same scene again is kept."""
    reach = max(1 / 3, 6.7 * o.cem.sigma_xy)
    return _compiled(scene.to_json(), o.rollout.timestep_s, o.rollout.samples_per_object, reach)


@functools.lru_cache(maxsize=4)
def _compiled(scene: str, timestep: float, samples: int, reach: float) -> SceneModel:
    # JAX compiles anew for another SceneModel, however equal.
    spec = SceneSpec.model_validate_json(scene)
    return compile_scene(spec, timestep=timestep, samples=samples, reach=reach)


class Search:
    """One refinement's state: the method, its weights, and how candidates are judged."""

    def __init__(
        self,
        model: SceneModel,
        o: RefineOptions,
        engine: Engine,
        clock: dict[str, float],
        start: Layout | None = None,
        mean: Layout | None = None,
    ) -> None:
        """Start at a layout, the composed scene by default, or where descent from it leads.

        Args:
            model: the compiled scene.
            o: of the search, the rewards and the rollouts.
            engine: what rolls candidates out.
            clock: seconds spent, by step; added to.
            start: the layout to start at, pop axis of length 1.
            mean: where descent leads from there, if that is known already.

        Raises:
            ConfigError: options that exclude each other.
        """
        _compatible(o)
        self.model, self.o, self.engine, self.clock = model, o, engine, clock
        self.cem, self.params = open_cem(model, o.cem)
        self.w: Weights = weights(o)
        self.terms: tuple[Term, ...] = user_terms(o.reward)
        by_object = o.cem.credit != "scene" and not self.terms and o.semantic.scorer != "mllm"
        self.partners = partners(model, o.cem) if by_object else None
        self.prunes = o.cem.prune and self.w.normalisation == "fixed"
        """A user's own terms have no known bound, and credit by objects has other elites."""
        self.prunes &= not self.terms and o.cem.credit in ("auto", "scene")
        self.began = time.perf_counter()
        self.first_valid_s = float("nan")
        self._seen_valid, self._stalled = False, 0
        if mean is None:
            leaves = jax.tree.leaves(self.params.sigma if start is None else start)
            scale = 0.0 if start is None else 1.0
            begin = Layout(*(scale * jnp.asarray(x, jnp.float32) for x in leaves))
            steps = o.descent.warm_steps
            mean = self._descend(begin, steps, photo=True) if steps else begin
        self.w = eqx.tree_at(lambda w: w.origin, self.w, mean, is_leaf=lambda x: x is None)
        self.state: CEMState = self.cem.init(model, self.params, mean)

    def ask(self, key: jax.Array, t: int) -> Layout:
        """Draw iteration t's population, and move it out of interpenetration."""
        return self.project(_ask(self.method(t), key, self.state, self.params), t)

    def project(self, drawn: Layout, t: int) -> Layout:
        """Move iteration t's candidates out of interpenetration, if the options say so."""
        d = self.o.descent
        needed = d.project == "needed" and t > 0 and not self._seen_valid
        if d.project == "always" or needed:
            return self._descend(drawn, d.project_steps, photo=False)
        return drawn

    def judge(
        self, t: int, layouts: Layout, scorer: SemanticScorer | None
    ) -> tuple[Scores, Poses, np.ndarray]:
        """Score a population.

        Returns:
            Scores, where candidates were placed, and how each S_sem came about (scorer.Mark).
        """
        marks = np.zeros(layouts.yaw.shape[0], np.int8)
        began, rolled = time.perf_counter(), self.clock["rollout"]
        before = self._placed(layouts)
        if self.prunes and scorer is None:
            found = score_elites(
                self.model,
                layouts,
                before,
                self.rollout,
                self.w,
                elites=self.method(t).elites,
                batch=self.o.cem.batch,
                until_valid=self.o.cem.credit == "auto" and not self._seen_valid,
                done=self.note,
            )
            rolled = self.clock["rollout"] - rolled
            self.clock["score"] += time.perf_counter() - began - rolled
            return found, before.start, marks
        self.clock["score"] += time.perf_counter() - began
        if scorer is not None:
            upper = bound(before, self.w)
            scorer.submit(t, scorer.best(np.asarray(upper)), layouts, before.start)
        rollout = self.rollout(before.start)
        if scorer is not None:
            began = time.perf_counter()
            scorer.collect(t)
            self.clock["wait"] += time.perf_counter() - began
            values, marks = scorer.fill(t, layouts, np.asarray(before.s_sem))
            before = with_semantic(before, values)
        found = score(self.model, layouts, rollout, self.w, self.terms, before)
        self.note(jax.block_until_ready(found))
        return found, before.start, marks

    def _placed(self, layouts: Layout) -> Placed:
        """Evaluate what needs no physics; a smaller first population is filled up to compile once."""
        pop, most = layouts.yaw.shape[0], self.cem.population
        if pop == most or most > FILLED * pop:
            return jax.block_until_ready(placed(self.model, layouts, self.w))
        fill = lambda x: np.resize(np.asarray(x), (most, *x.shape[1:]))
        found = placed(self.model, jax.tree.map(fill, layouts), self.w)
        return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[:pop]), found)

    def tell(self, t: int, layouts: Layout, found: Scores) -> None:
        """Fit the Gaussian to the elites."""
        credit = None
        if self.partners is not None:
            by_object = self.o.cem.credit != "auto" or not (
                self._seen_valid or bool(np.any(found.valid))
            )
            credit = shared(found, self.partners, by_object)
        self.state = _tell(self.method(t), self.state, layouts, found, self.params, credit)

    def enough(self, valid: bool, gain: float) -> bool:
        """Tell whether to stop after an iteration.

        Args:
            valid: whether it had a valid candidate.
            gain: of the elites, over those before.
        """
        self._seen_valid |= valid
        self._stalled = self._stalled + 1 if gain < self.o.cem.stop_gain else 0
        return self._seen_valid and self._stalled >= self.o.cem.patience

    def method(self, t: int) -> CEM:
        """Return the method with the population of iteration t."""
        first, population = self.o.cem.first, self.cem.population
        if t == 0 and first:
            population = min(first, population)
        return dataclasses.replace(self.cem, population=population, elites=self._elites(population))

    def _elites(self, population: int) -> int:
        return max(1, round(self.o.cem.elite_ratio * population))

    def _descend(self, layouts: Layout, steps: int, *, photo: bool) -> Layout:
        began = time.perf_counter()
        d = self.o.descent
        # With a single candidate a GPU does nothing but start kernels.
        with on_cpu() if layouts.yaw.shape[0] == 1 else contextlib.nullcontext():
            moved = descend(
                self.model,
                layouts,
                self.params.sigma,
                steps=steps,
                rate=d.rate,
                samples=d.samples,
                photo=photo,
            )
        self.clock["descent"] += time.perf_counter() - began
        return jax.block_until_ready(moved)

    def rollout(self, poses: Poses) -> Rollout:
        """Roll placed candidates out as the options say."""
        began = time.perf_counter()
        r = self.o.rollout
        if r.duration_s:
            found = self.engine.rollout(
                self.model,
                poses,
                duration=r.duration_s,
                record_every=r.record_every_s,
                early_stop=early_stop_rule(self.o) if r.early_stop else None,
            )
        else:
            found = unmoved(self.model, poses)
        jax.block_until_ready(found)
        self.clock["rollout"] += time.perf_counter() - began
        return found

    def note(self, found: Scores) -> None:
        """Note when the first valid candidate is known, at the end of its batch."""
        if np.isnan(self.first_valid_s) and bool(np.any(found.valid)):
            self.first_valid_s = time.perf_counter() - self.began


@eqx.filter_jit
def _ask(cem: CEM, key: jax.Array, state: CEMState, params: CEMParams) -> Layout:
    return cem.ask(key, state, params)


@eqx.filter_jit
def _tell(
    cem: CEM,
    state: CEMState,
    layouts: Layout,
    found: Scores,
    params: CEMParams,
    credit: jax.Array | None,
) -> CEMState:
    return cem.tell(state, layouts, found.reward, found.absolute, params, credit)


def with_semantic(before: Placed, values: np.ndarray) -> Placed:
    """Put a model's scores in the place of geometric ones."""
    s_sem = jnp.asarray(values, jnp.float32)
    return eqx.tree_at(lambda b: b.s_sem, before, s_sem)


def _with_late(
    scorer: SemanticScorer, t: int, found: Scores, marks: np.ndarray, o: RefineOptions
) -> Scores:
    """Enter an iteration's scores that came after its elites were taken."""
    change = np.zeros(len(marks), np.float32)
    for k in range(len(marks)):
        late = scorer.known((t, k))
        if late is not None and late.value is not None:
            change[k] = late.value - float(found.s_sem[k])
            marks[k] = Mark.SCORED
    gain = o.reward.w_sem * change
    more = (found.s_sem + change, found.reward + gain, found.absolute + gain)
    return eqx.tree_at(lambda f: (f.s_sem, f.reward, f.absolute), found, more)


def _compatible(o: RefineOptions) -> None:
    if o.cem.credit in ("auto", "scene"):
        return
    if o.reward.terms:
        raise ConfigError(
            "refine.cem.credit: a user's own terms are of the whole scene; choose auto or scene"
        )
    if o.semantic.scorer == "mllm":
        raise ConfigError(
            "refine.cem.credit: a model scores the whole scene; choose auto or scene, or scorer geometric"
        )


def early_stop_rule(o: RefineOptions) -> EarlyStop:
    """Return when rollouts may end early: past what the reward tells apart."""
    return EarlyStop(
        drift=o.reward.d_drift_cap * o.reward.drift_scale_m,
        tilt=float(np.radians(o.reward.d_drift_cap * o.reward.tilt_scale_deg)),
    )


def _line(t: int, most: int, scores: Scores, state: CEMState) -> str:
    rolled = np.isfinite(np.asarray(scores.d_drift))
    best = float(np.asarray(scores.absolute).max())
    share = float(np.asarray(scores.valid)[rolled].mean()) if rolled.any() else 0.0
    pruned = "" if rolled.all() else f", {1 - rolled.mean():.0%} pruned"
    return (
        f"iteration {t + 1}/{most}: best {best:.3f}, elites {float(state.elite_mean):.3f}, "
        f"{share:.0%} valid{pruned}"
    )
