"""The search moves only infeasible objects, and ends early if an object always falls."""

import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.measure import measured
from neoworld_mjx.physics.exact import snap_exactly
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.scene_arrays import on_device
from neoworld_mjx.refinement import evaluation, feasibility, refine
from neoworld_mjx.refinement.algorithm import SearchState
from neoworld_mjx.refinement.cem import CEMState
from neoworld_mjx.refinement.feasibility import FARTHER_FACTOR, offset_from_support, search_farther
from neoworld_mjx.spec import Box, Box2D, bounds, world_poses
from tests.support import scenes
from tests.support.scenes import on_table, single


def block(name, size=(0.06, 0.06, 0.06)):
    return single(name, (Box(size=size), (0, 0, 0)))


def options(**cem):
    return RefineOptions.model_validate(
        {
            "cem": {"population": 64, "first": 32, "iterations": 8, **cem},
            "rollout": {"samples_per_object": 64},
            "check_duration_s": 0.5,
        }
    )


OVERLAPPING = on_table(
    (block("left"), (0.0, -0.2), 0.0, {}),
    (block("one"), (0.0, 0.1), 0.0, {}),
    (block("two"), (0.0, 0.15), 0.0, {}),
)
"""Two blocks that overlap by 1 cm, and a separate one."""


def test_a_valid_scene_is_returned_unchanged():
    scene = snap_exactly(scenes.blocks())
    lines = []
    refined = refine(scene, options(), engine="native", progress=lines.append)
    assert refined.passed and refined.rollouts == 1
    assert set(refined.kept) == {"low", "high", "ball"}
    assert all((np.asarray(getattr(refined.layout, k)) == 0).all() for k in ("xy", "yaw"))
    assert lines == ["all 3 objects are valid in the initial layout"]


def test_an_object_that_fails_the_final_check_is_not_feasible(monkeypatch):
    """The final check lasts longer than a rollout."""

    def check(scene, o):
        measure = measured(scene, o)
        return measure.model_copy(update={"tilt_deg": measure.tilt_deg | {"high": 9.0}})

    monkeypatch.setattr(evaluation, "measured", check)
    refined = refine(snap_exactly(scenes.blocks()), options(), engine="native")
    assert set(refined.kept) == {"low", "ball"}
    assert refined.before.tilt_deg["high"] == 9.0


def test_only_overlapping_objects_are_moved():
    refined = refine(OVERLAPPING, options(), engine="native")
    assert refined.passed
    assert refined.kept == ("left",)
    moved = np.abs(np.asarray(refined.layout.xy[0])).max(axis=1)
    names = [item.name for item in OVERLAPPING.objects]
    assert moved[names.index("left")] == 0.0
    assert moved[names.index("one")] + moved[names.index("two")] > 0.002
    drawn = refined.history["xy"][:, :, names.index("left")]
    assert np.nanmax(np.abs(drawn)) == 0.0


def test_objects_that_agree_with_the_photograph_have_smaller_yaw_and_scale_deviations():
    names = [item.name for item in OVERLAPPING.objects]
    pixel = OVERLAPPING.camera.project(np.array([[0.5, 0.25, 0.03]]))[0][0]
    x, y = (float(v) for v in pixel)
    box = Box2D(x0=x - 40, y0=y - 40, x1=x + 40, y1=y + 40)
    objects = tuple(
        item.model_copy(update={"box2d": box}) if item.name == "two" else item
        for item in OVERLAPPING.objects
    )
    scene = OVERLAPPING.model_copy(update={"objects": objects})
    refined = refine(scene, options(iterations=1), engine="native")
    one, two = names.index("one"), names.index("two")
    share = options().cem.sigma_agreeing
    assert share < 0.5
    for drawn, sigma in (
        (refined.history["yaw"][0], np.radians(15)),
        (refined.history["log_scale"][0], 0.1),
    ):
        spread = np.nanstd(drawn, axis=0)
        assert 0.6 * share * sigma < spread[one] < 1.4 * share * sigma
        assert 0.7 * sigma < spread[two] < 1.3 * sigma


def test_all_objects_move_without_keep_sound():
    refined = refine(OVERLAPPING, options(keep_sound=False), engine="native")
    assert refined.passed and not refined.kept
    drawn = refined.history["xy"][:, :, 1]
    assert np.nanmax(np.abs(drawn)) > 0.001


def test_an_object_that_disagrees_with_the_photograph_is_moved():
    scene = snap_exactly(
        on_table((block("a"), (0.0, -0.2), 0.0, {}), (block("b"), (0, 0.1), 0, {}))
    )
    truth = refine(scene, options(), engine="native")
    assert truth.rollouts == 1
    pixel = scene.camera.project(np.array([[0.5, 0.05, 0.03]]))[0][0]
    x, y = (float(v) for v in pixel)
    box = Box2D(x0=x - 40, y0=y - 40, x1=x + 40, y1=y + 40)
    objects = [o.model_copy(update={"box2d": box}) if o.name == "b" else o for o in scene.objects]
    moved = refine(scene.model_copy(update={"objects": tuple(objects)}), options(), engine="native")
    assert "a" in moved.kept and "b" not in moved.kept
    b, share = moved.history["object_names"].tolist().index("b"), options().cem.sigma_agreeing
    # Its position varies, while yaw and scale keep the reduced deviation.
    for name, sigma in (("yaw", np.radians(15)), ("log_scale", 0.1)):
        assert 0.0 < np.nanstd(moved.history[name][0, :, b]) < 1.4 * share * sigma


def test_objects_that_only_disagree_with_the_photograph_move_after_a_valid_candidate():
    names = [item.name for item in OVERLAPPING.objects]
    pixel = OVERLAPPING.camera.project(np.array([[0.5, -0.17, 0.03]]))[0][0]
    x, y = (float(v) for v in pixel)
    box = Box2D(x0=x - 40, y0=y - 40, x1=x + 40, y1=y + 40)
    objects = tuple(
        item.model_copy(update={"box2d": box}) if item.name == "left" else item
        for item in OVERLAPPING.objects
    )
    lines = []
    scene = OVERLAPPING.model_copy(update={"objects": objects})
    refined = refine(scene, options(), engine="native", progress=lines.append)
    assert refined.passed and "moving one, two, then to match the photograph left" in lines[0]
    drawn = np.abs(refined.history["xy"][:, :, names.index("left")])
    valid = refined.history["valid"].any(axis=1)
    first = int(np.flatnonzero(np.nanmax(drawn, axis=(1, 2)) > 0)[0])
    assert first > int(np.flatnonzero(valid)[0])


def test_a_search_with_an_always_falling_object_ends_early_and_names_it():
    picture = block("picture", (0.02, 0.2, 0.2))
    scene = on_table(
        (block("box"), (0.0, 0.1), 0.0, {}),
        (picture, (0.0, -0.2), 0.0, {"relation": "attached", "z": 0.8}),
    )
    refined = refine(scene, options(), engine="native")
    assert not refined.passed
    assert refined.iterations <= 2
    (line,) = [f for f in refined.fallbacks if "ended after" in f]
    assert "picture" in line and "box" not in line


@pytest.mark.parametrize("stop_by", ["best", "elites"])
def test_both_convergence_rules_stop_the_search(stop_by):
    refined = refine(OVERLAPPING, options(stop_by=stop_by, stop_gain=10.0), engine="native")
    assert refined.iterations < 8


def test_the_search_is_widened_for_objects_that_always_fall():
    sigma = Layout.zero(1, 4)
    sigma = Layout(sigma.xy + 0.01, sigma.yaw + 0.1, sigma.log_scale + 0.1)
    nothing = on_device((np.int32(0), -np.inf, -np.inf, np.inf, False, np.int32(0)))
    state = SearchState(CEMState(Layout.zero(1, 4), sigma), *nothing)
    # The scene has three objects, padded to four.
    spec = on_table((block("low"), (0.0, 0.0), 0.0, {}), (block("other"), (0.0, 0.3), 0.0, {}))
    far = search_farther(state, sigma, np.array([False, True, False]), spec)
    np.testing.assert_allclose(
        np.asarray(far.optimizer.std.xy)[0, :, 0], [0.01, 0.01 * FARTHER_FACTOR, 0.01, 0.01]
    )
    np.testing.assert_allclose(np.asarray(far.optimizer.std.yaw), 0.1)
    # On the table it is already over its support.
    assert not np.asarray(far.optimizer.mean.xy).any()


def off_support(offset):
    """A peg composed in the air, at an offset [m] from the post that supports it."""
    post, peg = block("post", (0.04, 0.06, 0.1)), block("peg", (0.03, 0.03, 0.04))
    on_post = {"parent": "post", "z": 0.1}
    return on_table((post, (0.0, 0.0), 0.3, {}), (peg, (offset, 0.02), 0.2, on_post))


def test_the_mean_of_a_falling_object_moves_over_its_support():
    scene = off_support(0.12)
    off = offset_from_support(scene, scene.object("peg"), np.zeros(2))
    # Its center may be a quarter of the post's depth, 1 cm, from the post's center.
    np.testing.assert_allclose(off, [0.11, 0.005], atol=1e-6)
    np.testing.assert_allclose(
        offset_from_support(scene, scene.object("peg"), -off), 0.0, atol=1e-9
    )
    assert not offset_from_support(scene, scene.object("post"), np.zeros(2)).any()


def test_an_object_parsed_off_its_support_is_placed_on_it(monkeypatch):
    found = refine(off_support(0.12), options(), engine="native")
    assert found.passed and found.scene.object("peg").parent == "post"
    low = bounds(found.scene.object("peg").spec)[0][2]
    assert world_poses(found.scene)["peg"].pos[2] + low > 0.09
    # Without the offset no valid candidate is found, although the search is widened.
    monkeypatch.setattr(feasibility, "offset_from_support", lambda *of: np.zeros(2))
    assert not refine(off_support(0.12), options(), engine="native").passed
