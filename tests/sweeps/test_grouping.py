import equinox as eqx
import jax
import numpy as np
import pytest

from neoworld_mjx.compilations import compilations
from neoworld_mjx.config import RefineOptions, list_options, option_values
from neoworld_mjx.refinement.algorithm import open_problem
from neoworld_mjx.refinement.cem import open_cem
from neoworld_mjx.refinement.compiling import reach_of
from neoworld_mjx.sweeps.grouping import STATIC, TRACED, group_points, grouping_reasons
from tests.support import scenes
from tests.support.scenes import compile_scene

MODEL = compile_scene(scenes.blocks(), samples=16)


def put(path, value):
    tree: dict = {}
    at = tree
    *heads, last = path.split(".")
    for name in heads:
        at = at.setdefault(name, {})
    at[last] = value
    return RefineOptions.model_validate(tree)


def traced(options):
    # Of one optimizer, as another one has other parameters.
    problem = open_problem(MODEL, options, optimizer=open_cem(MODEL, options.cem))
    return eqx.filter(problem, eqx.is_array)


HOST = [
    option.path
    for option in list_options(RefineOptions)
    if option.kind == "host" and not option.path.startswith("semantic.")
]


def test_every_static_option_has_a_reason():
    assert len(STATIC) > 10
    assert all(STATIC.values())


NAMED = {"merit": "absolute", "cem.stop_by": "elites", "cem.patience": 3}
"""Other values of traced options that are names or counts."""


@pytest.mark.parametrize("name", [name for name in TRACED if name != "reward.terms"])
def test_a_traced_option_is_an_array_leaf(name):
    default = option_values(RefineOptions())[name]
    other = NAMED[name] if name in NAMED else default * 0.75 + 0.01
    before, after = traced(RefineOptions()), traced(put(name, other))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    pairs = zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    assert any(not np.array_equal(a, b) for a, b in pairs)


def test_other_values_of_traced_options_compile_nothing():
    @eqx.filter_jit
    def use(parameters):
        return jax.tree.map(lambda leaf: leaf + 0, parameters)

    use(traced(RefineOptions()))
    count = compilations()
    use(traced(put("cem.sigma_floor", 0.1)))
    use(traced(put("reward.w_drift", 2.0)))
    assert compilations() == count
    use(traced(put("reward.normalisation", "iteration")))
    assert compilations() > count


def test_weights_of_terms_are_traced_and_their_names_are_not():
    first, second, three = (
        put("reward.terms", terms) for terms in ({"math:ceil": 1}, {"math:ceil": 2}, {})
    )
    assert jax.tree.structure(traced(first)) == jax.tree.structure(traced(second))
    assert float(traced(second).objective.terms[-1].weight) == 2
    assert [group.members for group in group_points([first, second, three])] == [(0, 1), (2,)]


OTHERS = {
    "optimizer": "random",
    "strategy": {"std_init": 0.5},
    "cem.population": 8,
    "cem.elite_ratio": 0.5,
    "cem.zero_candidate": False,
    "cem.credit": "scene",
    "settle.enabled": False,
    "reward.normalisation": "iteration",
    "rollout.engine": "native",
    "rollout.early_stop": False,
    "cem.hold_resting": False,
}
"""Of options without a number to change a little."""


@pytest.mark.parametrize("name", [*STATIC, *HOST])
def test_other_options_are_not_array_leaves(name):
    default = option_values(RefineOptions())[name]
    other = OTHERS[name] if name in OTHERS else type(default)(default * 1.5 + 0.01)
    changed = put(name, other)
    assert changed != RefineOptions()
    pairs = zip(*(jax.tree.leaves(traced(o)) for o in (RefineOptions(), changed)), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)
    split = len(group_points([RefineOptions(), changed])) == 2
    assert split == (name in STATIC)
    assert any(name in line for line in grouping_reasons([RefineOptions(), changed])) == split


def test_options_of_the_early_stop_rule_split_groups_only_with_early_stop():
    early = [RefineOptions(), put("reward.d_drift_cap", 5.0)]
    assert len(group_points(early)) == 2
    assert (
        "refine.reward.d_drift_cap = 3.0, 5.0 (sets the early-stop rule)"
        in grouping_reasons(early)[0]
    )
    late = [
        o.model_copy(update={"rollout": o.rollout.model_copy(update={"early_stop": False})})
        for o in early
    ]
    assert len(group_points(late)) == 1
    assert grouping_reasons(late) == []


def test_a_wider_sigma_xy_elsewhere_in_the_plan_changes_no_scene():
    narrow, usual, wide = (put("cem.sigma_xy", x) for x in (0.03, 0.05, 0.2))
    assert reach_of(narrow) == reach_of(usual) < 6.7 * 0.2 <= reach_of(wide)
    together = group_points([narrow, wide, usual])
    assert [group.members for group in together] == [(0, 2), (1,)]
    assert [group.compile_options for group in together] == [narrow, wide]
    assert "refine.cem.sigma_xy: larger values need" in grouping_reasons([narrow, wide])[0]
