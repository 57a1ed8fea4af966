"""Guided settling: populations on an engine, and one scene exactly."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions, SettleOptions
from neoworld_mjx.measure import measured, resting
from neoworld_mjx.measure.scene_check import measures_of
from neoworld_mjx.physics.colliders import snap_exactly
from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.mjx_engine import MjxEngine
from neoworld_mjx.physics.model import compile_for_simulation
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import TILT_BOUND_LYING, settling_displacement
from neoworld_mjx.physics.rest import rest, settle, settle_scene, with_damped_joints
from neoworld_mjx.spec import with_world_poses, world_poses
from neoworld_mjx.spec.pose import from_axis_angle, pose
from tests.support import scenes
from tests.support.scenes import compile_scene

OPTIONS = SettleOptions()


def tilt_of(item):
    """Angle between an object's z axis and the vertical [deg]."""
    _, x, y, _ = item.base_tilt
    return np.degrees(2 * np.arcsin(np.hypot(x, y)))


def tilted(degrees=3.4):
    """A slab that stands on its edge, and a block."""
    slab = scenes.block("slab", (0.1, 0.1, 0.02))
    block = scenes.block("block", (0.04, 0.04, 0.06))
    tilt = tuple(from_axis_angle([1, 0, 0], np.radians(degrees)).tolist())
    return scenes.on_table(
        (slab, (0, 0), 0.0, {"base_tilt": tilt}), (block, (0.0, 0.2), 0.0, {}), name="tilted"
    )


def overlapping():
    """Two turned blocks that overlap by 1 cm."""
    block = lambda name: scenes.block(name, (0.06, 0.06, 0.06))
    return scenes.on_table(
        (block("one"), (0.0, 0.0), 0.3, {}),
        (block("two"), (0.0, 0.055), 0.3, {}),
        name="overlapping",
    )


@pytest.fixture(scope="module")
def settled():
    model = compile_scene(tilted(), samples=64)
    layouts = Layout.zero(3, len(model.names))
    logs = np.zeros((3, len(model.names)), np.float32)
    logs[1, model.names.index("slab")] = 0.2
    layouts = Layout(layouts.xy, layouts.yaw, jax.device_put(logs))
    start = jax.tree.map(np.array, model.place(layouts))
    start.pos[2, model.names.index("slab")] = np.nan
    return model, start, settle(model, start, NativeEngine(), OPTIONS)


def test_a_tilted_slab_comes_flat_and_a_block_stays(settled):
    model, start, end = settled
    slab, block = model.names.index("slab"), model.names.index("block")
    up = 1 - 2 * (end.quat[:2, slab, 1] ** 2 + end.quat[:2, slab, 2] ** 2)
    assert (np.degrees(np.arccos(np.clip(up, -1, 1))) < 0.3).all()
    assert np.abs(end.pos[:2, block] - start.pos[:2, block]).max() < 5e-4
    np.testing.assert_array_equal(end.scale, start.scale)
    np.testing.assert_array_equal(end.height, start.height)


def test_a_candidate_that_fails_stays_where_it_was_placed(settled):
    _, start, end = settled
    np.testing.assert_array_equal(end.pos[2], start.pos[2])
    np.testing.assert_array_equal(end.quat[2], start.quat[2])


def test_settling_is_measured_in_units_of_its_bounds(settled):
    model, start, end = settled
    shares = settling_displacement(
        model, *(jax.tree.map(lambda x: x[:1], p) for p in (start, end)), np
    )
    by = dict(zip(model.names, shares[0], strict=True))
    assert by["table"] == 0.0 and by["block"] < 0.05
    # The slab was placed tilted, but moves less in height than in angle.
    assert by["slab"] == pytest.approx(np.radians(3.4) / TILT_BOUND_LYING, rel=0.05)


@pytest.mark.slow  # tests/physics/test_engines.py compares the engines, too.
def test_native_and_mjx_settle_candidates_at_the_same_places():
    model = compile_scene(overlapping(), samples=16)
    xy = np.zeros((4, 3, 2), np.float32)
    xy[:, 2, 1] = [0.0, 0.002, 0.004, 0.03]
    layouts = Layout(xy, np.zeros((4, 3), np.float32), np.zeros((4, 3), np.float32))
    start = jax.tree.map(np.array, model.place(layouts))
    start.pos[3, 1, 2] += 0.05  # one falls on the table
    ours, theirs = (
        settle(model, start, engine, OPTIONS) for engine in (NativeEngine(), MjxEngine())
    )
    way = np.linalg.norm(ours.pos - start.pos, axis=-1)
    assert way[:3, 1:].max() > 0.003 and way[3, 1] > 0.04
    assert np.linalg.norm(ours.pos - theirs.pos, axis=-1).max() < 1e-3
    cosine = np.abs(np.sum(ours.quat * theirs.quat, axis=-1))
    turned = np.degrees(2 * np.arccos(np.minimum(cosine, 1.0))).max(axis=1)
    # The engines find other contact points in a deep overlap, which turn the blocks differently.
    assert turned[2:].max() < 0.5 and turned.max() < 1.5


def test_overlapping_blocks_come_apart_and_keep_their_headings():
    before = overlapping()
    assert measured(before, RefineOptions(check_duration_s=0.01)).max_depth_m > 0.004
    after = settle_scene(before, OPTIONS)
    measure = measured(after)
    assert measure.max_depth_m < 1e-3 and measure.max_drift_m < 1e-3
    for name in ("one", "two"):
        a, b = before.object(name), after.object(name)
        assert abs(a.yaw - b.yaw) < np.radians(1.0)
        assert np.hypot(*np.subtract(a.xy, b.xy)) < 0.012
        assert tilt_of(b) < 0.05


@pytest.mark.parametrize("degrees", [0.1, 3.4, 8.0])
def test_a_settled_slab_lies_flat_however_little_it_was_tilted(degrees):
    scene = settle_scene(tilted(degrees), OPTIONS)
    flat = tilt_of(scene.object("slab"))
    assert flat < 0.02
    ends = world_poses(scene)
    assert ends["slab"].pos[2] == pytest.approx(ends["block"].pos[2], abs=5e-4)


def test_a_tilt_that_is_no_error_remains():
    """A slab that leans on a block keeps a tilt of 0.1 degrees: nothing is rounded to upright."""
    slab = scenes.block("slab", (0.1, 0.1, 0.02))
    shim = scenes.block("shim", (0.02, 0.1, 0.0017))
    tilt = tuple(from_axis_angle([0, 1, 0], -np.radians(1.0)).tolist())
    scene = scenes.on_table(
        (shim, (0.045, 0.0), 0.0, {"fixed_base": True}),
        (slab, (0.0, 0.0), 0.0, {"base_tilt": tilt}),
    )
    rest = settle_scene(scene, OPTIONS).object("slab")
    assert tilt_of(rest) == pytest.approx(np.degrees(np.arctan2(0.0017, 0.085)), abs=0.15)


def test_joints_stay_while_their_object_settles():
    before = scenes.furnished()
    before = scenes.changed(before, "cabinet", z=before.object("cabinet").z + 0.02)
    after = settle_scene(before, OPTIONS)
    assert after.object("cabinet").joint_state == before.object("cabinet").joint_state
    assert world_poses(before)["cabinet"].pos[2] - world_poses(after)["cabinet"].pos[2] > 0.015


def test_held_joints_do_not_move_in_a_free_fall():
    model = compile_scene(scenes.lamp(), samples=16)
    poses = model.place_exactly(Layout.zero(1, len(model.names)))
    held = NativeEngine().rollout(with_damped_joints(model), poses, duration=1.0)
    free = NativeEngine().rollout(model, poses, duration=1.0)
    assert held.joint_shift.max() < 2e-3 < 1e-2 < free.joint_shift.max()
    assert with_damped_joints(model).static is with_damped_joints(model).static


def test_children_move_with_their_parent():
    scene = scenes.blocks()
    end = pose([0.3, 0.1, 0.5])
    there = with_world_poses(scene, {"low": end})
    before, after = world_poses(scene), world_poses(there)
    np.testing.assert_allclose(after["low"].pos, [0.3, 0.1, 0.5], atol=1e-12)
    np.testing.assert_allclose(after["ball"].pos, before["ball"].pos)
    relative = lambda at: at["low"].inverse().then(at["high"])
    np.testing.assert_allclose(relative(after).pos, relative(before).pos, atol=1e-12)
    np.testing.assert_allclose(relative(after).quat, relative(before).quat, atol=1e-12)


@pytest.fixture(scope="module")
def three():
    """The blocks as placed, the ball lifted by 30 cm, and a candidate that cannot be placed."""
    world = compile_for_simulation(snap_exactly(scenes.blocks()))
    poses = jax.tree.map(lambda leaf: np.repeat(leaf, 3, axis=0), world.poses())
    ball = world.names.index("ball")
    poses.pos[1, ball, 2] += 0.3
    poses.pos[2, ball] = np.nan
    return world, poses, rest(world, poses, hold=None, free_s=0.5)


def test_candidates_fall_from_their_poses_side_by_side(three):
    world, poses, rested = three
    ball = world.names.index("ball")
    assert rested.status.tolist() == [RolloutStatus.OK, RolloutStatus.OK, RolloutStatus.FAILED]
    assert rested.drift[0].max() < 1e-3
    assert rested.drift[1, ball] == pytest.approx(0.3, abs=0.01)
    assert np.delete(rested.drift[1], ball).max() < 1e-3
    assert np.isnan(rested.drift[2]).all() and rested.depths[2] == {}
    np.testing.assert_array_equal(rested.poses.pos, poses.pos)
    assert rested.depths[1] == rested.end_depths[2] == {}
    assert ("table", "ball") in rested.end_depths[1].keys() & rested.end_depths[0].keys()
    alone = rest(world, poses[:1], hold=None, free_s=0.5)
    np.testing.assert_array_equal(alone.drift[0], rested.drift[0])


def test_the_objects_of_each_candidate_that_rest_are_named(three):
    world, _, rested = three
    o = RefineOptions(check_duration_s=0.5)
    measures = measures_of(world, rested, o)
    at_rest = [resting(world.spec, measure, o) for measure in measures]
    ball, table = world.names.index("ball"), world.names.index("table")
    assert at_rest[0].all()
    assert np.flatnonzero(~at_rest[1]).tolist() == [ball]
    assert np.flatnonzero(at_rest[2]).tolist() == [table] and measures[2].diverged


def test_candidates_settle_before_they_fall_and_their_displacement_is_stated(three):
    world, poses, _ = three
    ball = world.names.index("ball")
    rested = rest(world, poses[:2], hold=OPTIONS, free_s=0.2, engine=NativeEngine())
    assert rested.poses.pos[1, ball, 2] < poses.pos[1, ball, 2] - 0.25
    assert rested.drift.max() < 1e-3
    assert rested.moved[0].max() < 0.1 and rested.moved[1, ball] > 1.0
