"""Plans tested in the scenes that a photograph allows: predicted success, and the most robust plan.

The samples are draws of `nw.sample` about the reconstruction. As in the ground truth, the offset
that all objects of a draw share is removed: a robot is calibrated to its camera. Masses, frictions
and losses vary in the samples, so they vary in the ground truth, too.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from neoworld_mjx.environments.samples import SceneSamples, sample
from neoworld_mjx.spec import SceneSpec

from ..methods.layout_errors import offsets
from .catalogue import find_task
from .execution import Outcome, execute
from .plan_format import TaskPlan
from .task import ManipulationTask

ALTERNATIVES = 4
"""Number of draws in which plans are made in addition to that of the reconstruction."""


class SampledPlans(NamedTuple):
    """Success of plans in draws, and of the chosen plan in the ground truth."""

    predicted: float | None
    """Share of the draws in which the plan of the reconstruction succeeds; None without a plan."""
    on_truths: float | None
    """Share of the draws of the ground truth's physics in which it does."""
    chosen_predicted: float
    """Share of the draws in which the chosen plan succeeds, the one that does in the most."""
    chosen_on_truth: Outcome
    """Outcome of the chosen plan in the ground truth."""


def sampled_plans(
    task: ManipulationTask,
    reconstructed: SceneSpec,
    plan: TaskPlan | None,
    draws: Sequence[SceneSpec],
    truths: Sequence[SceneSpec],
    shift: NDArray,
) -> SampledPlans | None:
    """Execute plans in draws, and in the ground truth the plan that succeeds in the most draws.

    Of equal plans, that of the reconstruction is chosen.

    Args:
        task: what is to be done.
        reconstructed: the scene about which was drawn, moved to where the task's scene is.
        plan: the plan made in it; None if there is none.
        draws: the draws, moved likewise.
        truths: draws of the physics of the ground truth, as from `truth_samples`.
        shift: common offset of the reconstruction from the ground truth [2] m.

    Returns:
        The shares and the outcome; None without draws or without any plan.
    """
    names = [item.name for item in reconstructed.objects if not item.environment]
    common = [np.median(offsets(draw, reconstructed, names), axis=0) for draw in draws]
    plans = [] if plan is None else [plan]
    for draw, offset in zip(draws[:ALTERNATIVES], common, strict=False):
        try:
            plans.append(task.plan_in(draw).shifted(_vector(-offset)))
        except Exception:  # Whatever a draw lacks, there is no plan for it.
            continue
    if not plans or not draws:
        return None
    pairs = list(zip(draws, common, strict=True))
    works = [[_works(task, draw, p.shifted(_vector(by))) for draw, by in pairs] for p in plans]
    shares = [float(np.mean(row)) for row in works]
    best = int(np.argmax(shares))
    back = _vector(-shift)
    outcome = execute(task.scene, plans[best].shifted(back), task.predicate)
    if plan is None or not truths:
        return SampledPlans(None if plan is None else shares[0], None, shares[best], outcome)
    there = [execute(truth, plan.shifted(back), task.predicate).success for truth in truths]
    return SampledPlans(shares[0], float(np.mean(there)), shares[best], outcome)


@lru_cache(maxsize=2)
def truth_samples(name: str, n: int, seed: int) -> SceneSamples:
    """Return draws of the physical quantities of a task's ground truth."""
    return sample(find_task(name).scene, n, seed=seed, sizes=False)


def _works(task: ManipulationTask, draw: SceneSpec, plan: TaskPlan) -> bool:
    try:
        return execute(draw, plan, task.predicate_in(draw)).success
    except Exception:  # A plan that cannot be carried out in a draw does not work there.
        return False


def _vector(xy: NDArray) -> tuple[float, float, float]:
    return float(xy[0]), float(xy[1]), 0.0
