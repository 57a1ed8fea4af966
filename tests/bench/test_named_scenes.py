"""Named scenes of sweeps: bench:NAME and crowded:N."""

from pathlib import Path

import pytest

from neoworld_mjx.errors import SpecError
from neoworld_mjx.sweeps import case
from neoworld_mjx.sweeps.plan import Ablation, Plan, points, read_plan

CONFIGS = Path(__file__).parents[2] / "configs"
PLANS = sorted(CONFIGS.glob("*/*.yaml"))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("bench:dominos", "scene bench:dominos: .*did you mean 'dominoes'"),
        ("bench:tents@al", "scene bench:tents@al: noise got 'al', valid are: exact, layout"),
        ("bench:tents#one", "scene bench:tents#one: #START takes the number"),
        ("crowded:many", "number of objects from 1 to 100"),
        ("bensh:dominoes", "did you mean 'bench'"),
        ("nowhere", "nor is it one of bench:NAME, crowded:NAME"),
    ],
)
def test_unknown_names_are_refused(name, message):
    with pytest.raises(SpecError, match=message):
        case(name)


@pytest.mark.slow
def test_bench_scene_is_an_initial_scene_with_errors_against_the_ground_truth():
    result = case("bench:tents")
    errors = result.errors(result.scene)
    assert result.scene.camera is not None and result.start is None
    assert set(errors) == {"xy_m", "yaw_deg", "scale"} and errors["xy_m"] > 1e-3
    assert case("bench:tents@all").scene == result.scene
    exact = case("bench:tents@exact")
    assert exact.errors(exact.scene)["xy_m"] < 0.5 * result.errors(result.scene)["xy_m"]


@pytest.mark.parametrize("path", PLANS, ids=lambda path: path.name)
def test_plans_of_the_repository_name_existing_scenes(path):
    plan = read_plan(path, Ablation if path.parent.name == "ablations" else Plan)
    assert len(points(plan)) > 1
    for name in plan.scenes:
        kind, colon, inner = name.partition("#")[0].partition("@")[0].partition(":")
        if not colon:
            assert (CONFIGS.parent / name).is_file()
        elif kind == "bench":
            assert (
                CONFIGS.parent / f"benchmarks/neoworld_bench/dataset/scenes/{inner}.yaml"
            ).is_file()
        else:
            assert case(name).name == name
