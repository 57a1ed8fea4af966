"""Options with which a refinement is one of the baselines Algorithm 1, random search and CMA-ES."""

import math
from typing import Any

from neoworld_mjx.config import RefineOptions, list_options, merged

CMA_POPULATION = 16
"""Population of CMA-ES. The usual 4 + 3 ln n is 13 to 15 for the 16 to 40 variables of a scene."""


def algorithm1(options: RefineOptions) -> RefineOptions:
    """Return the options of Algorithm 1, with the paper's value of every option that differs.

    They are the options of configs/paper.yaml, except that S_sem is geometric.
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
    """Return the options of another optimizer that makes at least the given number of rollouts.

    The optimizer does not stop early. Random search samples `cem.population` candidates or a few
    less per iteration, and CMA-ES samples CMA_POPULATION.

    Args:
        options: options of the refinement with which the optimizer is compared.
        optimizer: name of the optimizer, such as `random` or `cma_es`.
        rollouts: number of rollouts of that refinement.
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
