"""Baselines of a refinement, as options of its loop: Algorithm 1, random search and CMA-ES."""

import math

from neoworld_mjx.config import RefineOptions

CMA_POPULATION = 16
"""Population of CMA-ES; 4 + 3 ln n is 13 to 15 for its 16 to 40 variables."""


def algorithm1(options: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1 as in the paper, with the given N, T, weights and terms."""
    o = options
    cem = {"first": 0, "credit": "scene", "prune": False, "zero_candidate": False}
    cem |= {"sigma_floor": 0.0, "smoothing": 0.0, "patience": 1}
    return o.model_copy(
        update={
            "cem": o.cem.model_copy(update=cem),
            "descent": o.descent.model_copy(update={"warm_steps": 0, "project": "never"}),
            "reward": o.reward.model_copy(update={"normalisation": "iteration"}),
            "rollout": o.rollout.model_copy(update={"early_stop": False}),
            "settle": "never",
        }
    )


def with_budget(options: RefineOptions, optimizer: str, rollouts: int) -> RefineOptions:
    """Return the options of another optimizer with at least as many rollouts, all of them made.

    Random search draws `cem.batch` candidates at once or a few less, CMA-ES CMA_POPULATION. Neither
    stops before its budget is spent.

    Args:
        options: of the refinement that it is compared with.
        optimizer: `random` or `cma_es`.
        rollouts: of that refinement.
    """
    population = CMA_POPULATION if optimizer == "cma_es" else options.cem.batch
    iterations = max(1, math.ceil(rollouts / population))
    if optimizer == "random":
        population = math.ceil(rollouts / iterations)
    cem = {"population": max(2, population), "iterations": iterations, "patience": iterations + 1}
    cem |= {"first": 0, "credit": "scene", "prune": False}
    return options.model_copy(
        update={"optimizer": optimizer, "cem": options.cem.model_copy(update=cem)}
    )
