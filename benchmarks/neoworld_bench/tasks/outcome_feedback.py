"""Refinement of a layout by the outcome of a plan (Section 4.4 of the paper).

The paper says: "We use this execution outcome as a feedback signal to iteratively refine the scene
layout until the placement succeeds"; it does not state the method. Here the Cross-Entropy Method
of the scene refinement moves the objects that the task names. A candidate's reward is the progress
of the plan executed in it, plus 1 on success, less the prior. The resulting layout may differ from
the ground truth; the same plan in the ground-truth scene measures that.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from neoworld_mjx.config import CEMOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.refinement.cem import initial_sigma, open_cem
from neoworld_mjx.spec import SceneSpec

from .execution import Outcome, execute
from .plan_format import TaskPlan
from .predicates import Predicate, named_objects

PRIOR_WEIGHT = 0.02
"""Loss of a layout one standard deviation away; progress is worth up to 1."""


@dataclass(frozen=True)
class FeedbackResult:
    """Layout with the highest progress of a plan."""

    scene: SceneSpec
    outcome: Outcome
    executions: int


def refine_by_outcome(
    scene: SceneSpec,
    plan: TaskPlan,
    predicate: Predicate,
    *,
    options: CEMOptions | None = None,
    seed: int = 0,
) -> FeedbackResult:
    """Move the objects that a task names until a plan succeeds.

    Args:
        scene: the scene in which the plan fails.
        plan: the plan, which stays.
        predicate: what success is; the objects that it names are moved, but for the environment.
        options: of the Cross-Entropy Method; by default 24 candidates and at most 6 iterations.
        seed: of the draws.

    Returns:
        The first candidate that succeeds, else the best.
    """
    o = options or CEMOptions(population=24, iterations=6, elite_ratio=0.2, smoothing=0.2)
    model = compile_scene(scene)
    moves = np.array([name in named_objects(predicate) for name in model.names])
    fixed = replace(model, optimised=jnp.asarray(model.optimised) & moves)
    sigma = initial_sigma(fixed, o)
    cem = open_cem(model, o)
    cem = replace(cem, params=replace(cem.params, sigma=sigma))
    state, key = cem.init(), jax.random.key(seed)
    best: tuple[float, SceneSpec, Outcome] | None = None
    executions = 0
    for _ in range(o.iterations):
        key, now = jax.random.split(key)
        layouts = cem.ask(now, state, o.population)
        poses = model.place(layouts)
        prior = _prior(layouts, sigma)
        rewards = []
        for k in range(o.population):
            candidate = model.apply(layouts, k, poses)
            outcome = execute(candidate, plan, predicate)
            executions += 1
            reward = outcome.progress + outcome.success - PRIOR_WEIGHT * float(prior[k])
            rewards.append(reward)
            if best is None or reward > best[0]:
                best = (reward, candidate, outcome)
            if outcome.success:
                return FeedbackResult(candidate, outcome, executions)
        state = cem.tell(state, layouts, jnp.asarray(rewards))
    assert best is not None
    return FeedbackResult(best[1], best[2], executions)


def _prior(layouts: Layout, sigma: Layout) -> np.ndarray:
    """Return the mean squared displacement of the moved objects in standard deviations [pop]."""
    total, count = 0.0, 0
    for leaf, spread in zip(jax.tree.leaves(layouts), jax.tree.leaves(sigma), strict=True):
        moved = np.asarray(spread)[0] > 0
        ratio = np.asarray(leaf)[:, moved] / np.asarray(spread)[:, moved]
        total = total + np.sum(ratio.reshape(len(ratio), -1) ** 2, axis=1)
        count += int(np.sum(moved))
    return np.asarray(total) / max(count, 1)
