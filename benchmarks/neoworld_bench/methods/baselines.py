"""Baselines of a refinement, as options of its loop: Algorithm 1, random search and CMA-ES."""

import math
from typing import Any

from neoworld_mjx.config import RefineOptions, list_options, merged

CMA_POPULATION = 16
"""Population of CMA-ES; 4 + 3 ln n is 13 to 15 for its 16 to 40 variables."""


def algorithm1(options: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1: every option that differs from the paper has its value.

    As in configs/paper.yaml, but S_sem is geometric.
    """
    values: dict[str, Any] = {}
    for option in list_options(RefineOptions):
        if option.difference is None or option.path.startswith("semantic."):
            continue
        group = values
        *groups, name = option.path.split(".")
        for part in groups:
            group = group.setdefault(part, {})
        group[name] = option.difference.value
    values["cem"] |= {"patience": 1}
    return RefineOptions.model_validate(merged(options.model_dump(mode="json"), values))


def with_budget(options: RefineOptions, optimizer: str, rollouts: int) -> RefineOptions:
    """Return the options of another optimizer with at least as many rollouts, all of them made.

    Random search draws `cem.population` candidates at once or a few less, CMA-ES CMA_POPULATION.

    Args:
        options: of the refinement that it is compared with.
        optimizer: `random` or `cma_es`.
        rollouts: of that refinement.
    """
    population = CMA_POPULATION if optimizer == "cma_es" else options.cem.population
    iterations = max(1, math.ceil(rollouts / population))
    if optimizer == "random":
        population = math.ceil(rollouts / iterations)
    cem = {"population": max(2, population), "iterations": iterations, "patience": iterations + 1}
    cem |= {"widest": 1000.0}
    return options.model_copy(
        update={"optimizer": optimizer, "cem": options.cem.model_copy(update=cem)}
    )
