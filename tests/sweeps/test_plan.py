from pathlib import Path

import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError
from neoworld_mjx.sweeps.plan import Ablation, Plan, points, read_plan

CONFIGS = Path(__file__).parents[2] / "configs"


def grid(**axes):
    return points(Plan(axes={name.replace("__", "."): values for name, values in axes.items()}))


def test_a_grid_is_every_combination_in_order():
    result = grid(refine__cem__sigma_xy=[0.03, 0.05], refine__reward__w_pen=[1, 2, 3])
    assert len(result) == 6
    assert result[0].label == "cem.sigma_xy 0.03, reward.w_pen 1"
    assert result[-1].values == {"refine.cem.sigma_xy": 0.05, "refine.reward.w_pen": 3.0}
    assert result[-1].options.cem.sigma_xy == 0.05
    assert result[-1].options.reward.w_pen == 3


def test_points_override_the_file_and_the_base():
    plan = Plan(
        config=CONFIGS / "paper.yaml",
        base={"refine": {"cem": {"population": 12}, "semantic": {"scorer": "geometric"}}},
        axes={"refine.reward.w_pen": [2]},
    )
    (result,) = points(plan)
    assert result.options.reward.normalisation == "iteration"
    assert (result.options.cem.population, result.options.reward.w_pen) == (12, 2)


def test_custom_terms_are_replaced_as_a_whole():
    terms = [{}, {"math:floor": 0.5}]
    result = points(Plan(base={"refine": {"reward": {"terms": {"math:ceil": 1}}}},
                        axes={"refine.reward.terms": terms}))  # fmt: skip
    assert [point.options.reward.terms for point in result] == terms


@pytest.mark.parametrize(
    ("axes", "said"),
    [
        ({"refine.cem.sigma_x": [1]}, "the nearest are refine.cem.sigma_xy, "),
        ({"refine.cm.sigma_xy": [1]}, "the nearest are refine.cem.sigma_xy, "),
        ({"refine.cem.sigma_xy.deep": [1]}, "sigma_xy.deep is no option of the search"),
        ({"refine.cem": [{}]}, "refine.cem is no option of the search"),
        ({"render.width": [100]}, "render.width is no option of the search"),
        ({"refine.cem.sigma_xy": []}, "refine.cem.sigma_xy has no values"),
        ({"refine.cem.sigma_xy": ["wide"]}, "refine.cem.sigma_xy: Input should be a valid number"),
        ({"refine.cem.sigma_xy": [0.1, -1]}, "greater than or equal to 0, got -1"),
        ({"refine.cem.sigma_xy": [1, 1.0]}, "appears twice"),
        ({"refine.cem.stop_by": ["nobody"]}, "refine.cem.stop_by: Input should be"),
    ],
)
def test_invalid_axes_are_rejected(axes, said):
    with pytest.raises(ConfigError, match="axes: ") as error:
        points(Plan(axes=axes))
    assert said in str(error.value)


def test_variants_override_the_base():
    plan = Ablation(variants={"free": {"refine.reward.w_drift": 0}})
    base, free = points(plan)
    assert base.options == RefineOptions()
    assert (free.label, free.options.reward.w_drift) == ("free", 0)
    for variants, message in (
        ({}, "name at least one"),
        ({"nothing": {}}, "changes nothing"),
        ({"same": {"refine.reward.w_drift": 1}}, "equals the base"),
        ({"base": {"refine.reward.w_drift": 0}}, "reserved for the options without changes"),
        ({"typo": {"refine.reward.w_drft": 0}}, "the nearest are refine.reward.w_drift, "),
    ):
        with pytest.raises(ConfigError, match=message):
            points(Ablation(variants=variants))


def test_invalid_plans_are_rejected(tmp_path):
    path = tmp_path / "plan.yaml"
    for text, message in (
        ("[1]", "must be a mapping"),
        ("a: [", "not valid YAML"),
        ("axis: {}", "unknown key axis: got 'axis', valid are: .*; did you mean 'axes'"),
        ("seeds: []", "seeds: Tuple should have at least 1 item"),
        ("seeds: [0, 0]", "seeds must be different"),
        ("seeds: [-1]", "not negative"),
    ):
        path.write_text(text)
        with pytest.raises(ConfigError, match=message):
            read_plan(path, Plan)
    with pytest.raises(ConfigError, match="cannot read"):
        read_plan(tmp_path / "none.yaml", Plan)


XY, PEN, N = "refine.cem.sigma_xy", "refine.reward.w_pen", "refine.cem.population"


def test_a_range_has_evenly_spaced_values_or_logarithms():
    axes = {
        XY: {"low": 0.01, "high": 0.16, "log": True, "n": 5},
        PEN: {"low": 1, "high": 2, "n": 3},
    }
    found = points(Plan(axes=axes))
    assert [point.values[XY] for point in found[::3]] == pytest.approx(
        [0.01, 0.02, 0.04, 0.08, 0.16]
    )
    assert [point.values[PEN] for point in found[:3]] == [1.0, 1.5, 2.0]
    whole = points(Plan(axes={N: {"low": 8, "high": 64, "log": True, "n": 3}}))
    assert [point.options.cem.population for point in whole] == [8, 23, 64]


def test_axes_advance_together():
    axes = {XY: [0.03, 0.05], N: [8, 16, 32], PEN: [1, 2]}
    found = points(Plan(axes=axes, zip=((XY, PEN),)))
    assert [(p.values[XY], p.values[PEN], p.values[N]) for p in found] == [
        (xy, pen, n) for xy, pen in ((0.03, 1.0), (0.05, 2.0)) for n in (8, 16, 32)
    ]


def test_values_are_drawn_and_more_samples_keep_the_first_ones():
    axes = {XY: {"low": 0.01, "high": 0.1, "log": True}, N: {"low": 8, "high": 64}, PEN: [1, 2]}
    found = points(Plan(axes=axes, samples=40))
    assert len(found) == 80
    drawn = [(p.values[XY], p.values[N]) for p in found]
    assert drawn[:40] == drawn[40:] and len(set(drawn)) == 40
    assert all(0.01 <= xy <= 0.1 and 8 <= n <= 64 for xy, n in drawn)
    assert 12 <= sum(xy < 0.01**0.5 * 0.1**0.5 for xy, _ in drawn[:40]) <= 28
    fewer = points(Plan(axes=axes, samples=10))
    assert [p.values[XY] for p in fewer[:10]] == [xy for xy, _ in drawn[:10]]
    other = points(Plan(axes=axes, samples=10, draw_seed=1))
    assert other[0].values[XY] != fewer[0].values[XY]
