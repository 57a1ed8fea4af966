"""The order in which final scenes are checked, and that a search never makes a scene worse."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, SettleOptions
from neoworld_mjx.measure import SETTLED_AWAY, measured, passes, scene_checks
from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.physics.model import compile_for_simulation
from neoworld_mjx.search import finishing
from neoworld_mjx.search.algorithm import Scores
from neoworld_mjx.search.evaluation import Round
from neoworld_mjx.search.finishing import (
    INITIAL,
    choose_winner,
    rank_candidates,
    settle_and_check,
)
from neoworld_mjx.spec import Box, SceneSpec
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = RefineOptions(finalists=3, check_duration_s=0.5)
UNSETTLED = OPTIONS.model_copy(update={"settle": SettleOptions(enabled=False)})
FALLS, STANDS = 0.06, 0.03
"""Offsets of the plate's center from that of its support [m], whose edge is at 0.05."""
NEAR = [FALLS + 1e-4 * k for k in range(6)]


@pytest.fixture(scope="module")
def models():
    """A plate on a block, composed where it falls and where it stands."""
    low = scenes.block("low", (0.1, 0.1, 0.06))
    plate = scenes.block("plate", (0.1, 0.06, 0.02))
    on_low = {"parent": "low", "z": 0.06}
    return {
        x: compile_scene(
            scenes.on_table((low, (0, 0), 0.0, {}), (plate, (x, 0.0), 0.0, on_low), name="plate")
        )
        for x in (FALLS, 0.0)
    }


def searched(model, plate_x, valid):
    """An iteration with the plate at each of `plate_x`, best first."""
    composed = model.spec.object("plate").xy[0]
    pop, count = len(plate_x), len(model.names)
    xy = np.zeros((pop, count, 2), np.float32)
    xy[:, model.names.index("plate"), 0] = np.subtract(plate_x, composed)
    zero = np.zeros((pop, count), np.float32)
    layouts = Layout(xy, zero, zero)
    poses = jax.tree.map(np.asarray, model.place(layouts))
    better = -np.arange(pop, dtype=np.float32)
    rests, status = np.ones((pop, count), bool), np.zeros(pop, np.int32)
    rounds = [Round(layouts, poses, Scores({}, better, rests, np.array(valid), status))]
    return model, model, rounds, OPTIONS, settle_and_check(model, model.spec, OPTIONS)


@pytest.mark.parametrize("plate_x", [[STANDS, 0.0], [FALLS, STANDS], [FALLS, FALLS, STANDS]])
def test_the_first_candidate_that_passes_wins(models, plate_x):
    chosen = choose_winner(*searched(models[FALLS], plate_x, [True] * len(plate_x)))
    first = plate_x.index(STANDS)
    assert chosen.finished.passed and chosen.candidate == (0, first) and chosen.tried == first + 1
    assert len(chosen.layout.xy) == 1
    plate = chosen.finished.scene.object("plate").xy[0]
    assert plate == pytest.approx(STANDS, abs=2e-3)


def test_invalid_candidates_are_checked_after_valid_ones(models):
    chosen = choose_winner(*searched(models[FALLS], [FALLS, STANDS], [False, True]))
    assert chosen.finished.passed and chosen.candidate == (0, 1) and chosen.tried == 1


def test_if_no_candidate_passes_the_initial_layout_wins(models):
    world, model, rounds, o, initial = searched(models[FALLS], NEAR[:4], [True] * 4)
    chosen = choose_winner(world, model, rounds, o, initial)
    assert chosen.candidate == INITIAL and chosen.finished is initial and not initial.passed
    assert chosen.tried == o.finalists == 3
    assert chosen.rejected is not None and not chosen.rejected.passed
    assert chosen.rejected is not initial


def test_without_settling_the_best_candidate_is_returned_even_if_it_fails(models):
    world, model, rounds, _, _ = searched(models[FALLS], NEAR, [True] * 6)
    initial = settle_and_check(world, world.spec, UNSETTLED)
    chosen = choose_winner(world, model, rounds, UNSETTLED, initial)
    assert not chosen.finished.passed and chosen.candidate[0] == 0 and chosen.tried == 3
    nothing = choose_winner(world, model, [], UNSETTLED, initial)
    assert nothing.candidate == INITIAL and nothing.finished is initial


def test_what_does_not_rest_is_held_where_it_was_placed_and_the_rest_stands():
    """A plate over nothing, with a cube on it, beside a cube on the table."""
    cube = lambda name: scenes.block(name, (0.04, 0.04, 0.04))
    plate = scenes.block("plate", (0.2, 0.1, 0.02))
    scene = scenes.on_table(
        (plate, (0.0, 0.0), 0.0, {"z": 0.1}),
        (cube("top"), (0.05, 0.0), 0.0, {"parent": "plate", "z": 0.02}),
        (cube("beside"), (0.2, 0.0), 0.0, {}),
    )
    world = compile_for_simulation(scene)
    failed = settle_and_check(world, scene, OPTIONS)
    away = {
        item.name for item, at in zip(scene.objects, failed.rests(OPTIONS), strict=True) if not at
    }
    assert away == {"plate", "top"} and not failed.passed
    end = finishing.hold_failing(scene, failed, OPTIONS)
    assert [item.name for item in end.scene.objects if item.held] == ["plate"]
    assert end.scene.object("plate").z == 0.1 and not end.passed
    assert abs(end.scene.object("top").z - 0.02) < 1e-3
    (check,) = [check for check in scene_checks(end.measure, OPTIONS) if not check.passed]
    assert check.phrase() == "plate: fixed in place, since it does not rest there"
    again = measured(SceneSpec.model_validate_json(end.scene.to_json()), OPTIONS)
    assert again.held == ("plate",) and not passes(again, OPTIONS) and again.s_stab is False


def test_an_object_is_held_with_the_objects_that_carry_it():
    """A cube beside the plate that should carry it falls; the plate, which rests, is fixed."""
    cube = scenes.block("cube", (0.04, 0.04, 0.04))
    plate = scenes.block("plate", (0.2, 0.1, 0.02))
    on_plate = {"parent": "plate", "z": 0.1}
    scene = scenes.on_table((plate, (0, 0), 0.0, {}), (cube, (0.2, 0.0), 0.0, on_plate))
    failed = settle_and_check(compile_for_simulation(scene), scene, OPTIONS)
    end = finishing.hold_failing(scene, failed, OPTIONS)
    assert [item.name for item in end.scene.objects if item.held] == ["plate", "cube"]


def test_a_candidate_far_from_the_estimate_does_not_win(models):
    """The plate stands in both candidates, 9 and 1.2 cm from where the photograph shows it."""
    known = PoseUncertainty(along=0.015, across=0.002, yaw=0.1, log_scale=0.02)
    objects = [
        item.model_copy(update={"uncertainty": known}) if item.name == "plate" else item
        for item in models[FALLS].spec.objects
    ]
    scene = models[FALLS].spec.model_copy(update={"objects": tuple(objects)})
    near, far = 0.048, -STANDS
    for estimate, wins in ((models[FALLS].spec, (0, 0)), (scene, (0, 1))):
        world, model, rounds, o, initial = searched(
            compile_scene(estimate), [far, near], [True] * 2
        )
        chosen = choose_winner(world, model, rounds, o, initial)
        assert chosen.candidate == wins and chosen.finished.passed
    away = settle_and_check(world, model.apply(rounds[0].layouts, 0), OPTIONS)
    (failed,) = [check for check in scene_checks(away.measure, OPTIONS) if not check.passed]
    assert (failed.name, failed.failing) == (SETTLED_AWAY, ("plate",))
    # 9 cm toward the camera, in units of hypot(.015, .01) m, of which 4 are allowed.
    assert failed.value == pytest.approx(0.09 / 0.018 / 4, rel=0.03)
    end = finishing.hold_failing(scene, away, OPTIONS)
    assert end.scene.object("plate").held and not end.passed


def test_deviations_are_measured_along_and_across_the_view():
    """A block 50 cm from the camera; its center counts, at any size."""
    cube = scenes.single("cube", (Box(size=(0.02, 0.02, 0.02)), (0.1, 0, 0)))
    known = PoseUncertainty(along=0.02, across=0.005, yaw=None, log_scale=0.02)
    at = lambda xy, scale=1.0: scenes.on_table(
        (cube.scaled(scale), xy, 0.0, {"uncertainty": known})
    )
    estimate = at((0.0, 0.0))
    for shift, axis in (((0.03, 0.0), 0.02), ((0.0, 0.03), 0.005)):
        expected = 0.03 / np.hypot(axis, 0.01)
        found = finishing.deviations_from(estimate, at(shift), 0.01)
        assert found == {"cube": pytest.approx(expected, rel=1e-6)}
    assert finishing.deviations_from(estimate, at((0.0, 0.0), 2.0), 0.01)["cube"] < 1e-9
    unknown = scenes.on_table((cube, (0.0, 0.0), 0.0, {}))
    assert finishing.deviations_from(unknown, at((0.3, 0.0)), 0.01) == {}


def iteration(valid, reward):
    pop = len(valid)
    poses = Poses(*(np.zeros((pop, 1, *last), np.float32) for last in ((3,), (4,), (), ())))
    rests, status = np.ones((pop, 1), bool), np.zeros(pop, np.int32)
    scores = Scores({}, np.float32(reward), rests, np.array(valid), status)
    return Round(Layout.zero(pop, 1), poses, scores)


def test_valid_candidates_rank_before_all_others_and_the_reward_decides_among_them():
    first = iteration([False], [9.0])
    second = iteration([True, False, True, False, True], [1.0, 8.0, 3.0, -np.inf, np.nan])
    assert rank_candidates([first, second]) == [(1, 2), (1, 0), (0, 0), (1, 1)]
    assert rank_candidates([]) == []
