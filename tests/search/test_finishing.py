"""Final scenes: what rests, what a search holds, and how bad a failing scene is."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import measured, passes
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_for_simulation
from neoworld_mjx.search import finishing
from neoworld_mjx.search.evaluation import Round
from neoworld_mjx.search.finishing import finish, settle_and_check
from neoworld_mjx.search.searched_scene import free_to_move, with_resting_fixed
from neoworld_mjx.spec import Ellipsoid, bounds
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = RefineOptions(check_duration_s=0.5)


def towers():
    """A plate that tips over a block's edge with a cube on it, and a tower that stands."""
    return scenes.on_table(
        (scenes.block("low", (0.1, 0.1, 0.06)), (0, 0), 0.0, {}),
        (scenes.block("plate", (0.1, 0.06, 0.02)), (0.06, 0.0), 0.0, {"parent": "low", "z": 0.06}),
        (scenes.block("cube", (0.02, 0.02, 0.02)), (0.0, 0.0), 0.0, {"parent": "plate", "z": 0.02}),
        (scenes.block("base"), (0.0, -0.25), 0.0, {}),
        (scenes.block("top", (0.04, 0.04, 0.04)), (0.0, 0.0), 0.0, {"parent": "base", "z": 0.06}),
        name="towers",
    )


@pytest.fixture(scope="module")
def initial():
    world = compile_for_simulation(towers())
    return world, settle_and_check(world, towers(), OPTIONS)


def named(model, mask):
    return {name for name, one in zip(model.names, mask, strict=True) if one}


def test_what_fell_does_not_rest(initial):
    model, found = initial
    away = {name for name, moved in found.measure.displacement.items() if moved > 1}
    assert not found.passed and {"plate", "cube"} <= away
    assert named(model, found.rests(OPTIONS)) == {"table", "low", "base", "top"}


def test_a_search_frees_what_does_not_rest_and_what_it_supports(initial):
    model, _ = initial
    rests = np.array([name != "plate" for name in model.names])
    assert named(model, free_to_move(model.spec, rests)) == {"plate", "cube"}
    rests = np.array([name != "base" for name in model.names])
    assert named(model, free_to_move(model.spec, rests)) == {"base", "top"}
    rests = np.array([name != "table" for name in model.names])
    assert not free_to_move(model.spec, rests).any()


def test_a_candidate_of_a_held_scene_is_finished_with_every_object_free(initial):
    model, found = initial
    searched = compile_scene(with_resting_fixed(model.spec, found, OPTIONS), samples=16)
    xy = np.zeros((1, len(model.names), 2), np.float32)
    xy[0, model.names.index("plate"), 0] = -0.06
    zero = np.zeros((1, len(model.names)), np.float32)
    smaller = zero.copy()
    smaller[0, model.names.index("cube")] = np.log(0.8)
    layouts = Layout(xy, zero, smaller)
    poses = jax.device_get(searched.place(layouts))
    done = finish(model, searched, Round(layouts, poses, None), 0, OPTIONS)
    assert done.passed and max(done.measure.displacement.values()) <= 1.0
    cube = bounds(done.scene.object("cube").spec)
    assert np.subtract(*cube[::-1]) == pytest.approx(np.full(3, 0.016))
    # As a scene that is compiled at its own sizes.
    again = measured(done.scene, OPTIONS)
    assert again.max_depth_m == pytest.approx(done.measure.max_depth_m, abs=1e-9)
    assert again.max_drift_m == pytest.approx(done.measure.max_drift_m, abs=1e-7)
    assert done.measure.movable == 5
    assert all(item.fixed_base is False for item in done.scene.objects)
    assert done.scene.object("plate").xy[0] == pytest.approx(0.0, abs=1e-3)


def test_an_object_on_an_unstable_side_is_taken_from_where_it_falls(monkeypatch):
    potato = scenes.single("potato", (Ellipsoid(radii=(0.03, 0.02, 0.018)), (0, 0, 0)))
    on_edge = {"base_tilt": tuple(from_axis_angle((1, 0, 0), np.radians(89.0)).tolist())}
    scene, o = scenes.on_table((potato, (0, 0), 0.0, on_edge)), RefineOptions()
    world = compile_for_simulation(scene)
    measure = settle_and_check(world, scene, o).measure
    assert passes(measure.model_copy(update={"displacement": None}), o)
    monkeypatch.setattr(finishing, "RELEASES", 0)
    assert settle_and_check(world, scene, o).measure.max_tilt_deg > 45.0


def test_each_kind_of_fault_names_its_objects(initial):
    model, found = initial
    names = model.names
    clean = found.measure.model_copy(
        update={
            "depths_m": {},
            "settled_depths_m": {},
            "drift_m": dict.fromkeys(names[1:], 0.0),
            "tilt_deg": dict.fromkeys(names[1:], 0.0),
            "joint_turn_deg": {},
            "joint_slide_m": {},
            "diverged": False,
            "displacement": {},
        }
    )
    faulty = lambda **update: (
        set(names)
        - named(model, found._replace(measure=clean.model_copy(update=update)).rests(OPTIONS))
    )
    zero = clean.drift_m
    assert faulty() == set()
    assert faulty(depths_m={"low|cube": 2e-3, "base|top": 5e-4}) == {"low", "cube"}
    assert faulty(settled_depths_m={"base|top": 2e-3}) == {"base", "top"}
    assert faulty(drift_m=zero | {"top": 0.011}) == {"top"}
    assert faulty(drift_m=zero | {"top": float("nan")}) == {"top"}
    assert faulty(tilt_deg=zero | {"cube": 5.1}) == {"cube"}
    assert faulty(joint_turn_deg={"base-lid": 6.0}) == {"base"}
    assert faulty(joint_slide_m={"low-tray": 0.02}) == {"low"}
    assert faulty(joint_slide_m={"low-tray": OPTIONS.max_drift_m}) == {"low"}
    assert faulty(displacement={"plate": 1.1, "top": 0.9}) == {"plate"}
    assert faulty(diverged=True) == set(names[1:])
