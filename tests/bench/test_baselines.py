"""Options of the baselines: Algorithm 1 of the paper, and optimizers with a rollout budget."""

import pytest
from neoworld_bench.methods.baselines import CMA_POPULATION, algorithm1, with_budget

from neoworld_mjx.config import (
    CEMOptions,
    RefineOptions,
    RolloutOptions,
    list_options,
    option_values,
)

OPTIONS = RefineOptions(
    cem=CEMOptions(population=24, iterations=2),
    rollout=RolloutOptions(duration_s=0.4, samples_per_object=64),
)


def test_algorithm_1_keeps_sizes_and_weights():
    o = algorithm1(OPTIONS)
    assert (o.cem.population, o.cem.iterations) == (24, 2)
    for name in ("w_sem", "w_pen", "w_drift", "d_pen_cap_m", "d_drift_cap"):
        assert getattr(o.reward, name) == getattr(OPTIONS.reward, name)
    assert o.rollout.model_copy(update={"early_stop": True}) == OPTIONS.rollout
    assert o.semantic == OPTIONS.semantic


def test_algorithm_1_has_the_papers_value_of_every_option_of_the_search():
    values = option_values(algorithm1(OPTIONS))
    for option in list_options(RefineOptions):
        if option.difference is not None and not option.path.startswith("semantic."):
            assert values[option.path] == option.difference.value, option.path


@pytest.mark.parametrize("rollouts", [1, 50, 48])
def test_random_search_exceeds_its_budget_by_less_than_one_per_iteration(rollouts):
    cem = with_budget(OPTIONS, "random", rollouts).cem
    assert cem.population <= OPTIONS.cem.population and cem.patience > cem.iterations
    assert 0 <= cem.population * cem.iterations - rollouts < max(2, cem.iterations)


def test_cma_es_has_a_population_of_its_own():
    o = with_budget(OPTIONS, "cma_es", 50)
    assert o.optimizer == "cma_es"
    assert (o.cem.population, o.cem.iterations) == (CMA_POPULATION, 4)
