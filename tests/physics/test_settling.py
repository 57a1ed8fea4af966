"""Coming to rest with drag: populations on an engine, and one scene exactly."""

import jax
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.physics.placed import placed_at_rest
from neoworld_mjx.physics.settling import FALL_M_S, HEADING, at_rest, moved, settle, with_drag
from neoworld_mjx.spec import Box, HollowBox, world_poses
from neoworld_mjx.spec.pose import from_axis_angle, pose
from tests.support import scenes

TILT = tuple(from_axis_angle([1, 0, 0], 0.06).tolist())


def tilted():
    """A slab that stands on its edge by 3.4 degrees, and a block half over its edge."""
    slab = scenes.single("slab", (Box(size=(0.1, 0.1, 0.02)), (0, 0, 0)))
    block = scenes.single("block", (Box(size=(0.04, 0.04, 0.06)), (0, 0, 0)))
    scene = scenes.on_table((slab, (0, 0), 0.0, {}), (block, (0.0, 0.2), 0.0, {}))
    objects = [
        item.model_copy(update={"base_tilt": TILT}) if item.name == "slab" else item
        for item in scene.objects
    ]
    return scene.model_copy(update={"objects": tuple(objects)})


@pytest.fixture(scope="module")
def settled():
    model = compile_scene(tilted(), samples=64)
    layouts = Layout.zero(3, len(model.names))
    logs = np.zeros((3, len(model.names)), np.float32)
    logs[1, model.names.index("slab")] = 0.2
    layouts = Layout(layouts.xy, layouts.yaw, jax.device_put(logs))
    start = jax.tree.map(np.array, model.place(layouts))
    start.pos[2, model.names.index("slab")] = np.nan
    return model, start, settle(model, start, NativeEngine(), 1.0)


def test_a_tilted_slab_lies_flat_and_a_block_stays(settled):
    model, start, end = settled
    slab, block = model.names.index("slab"), model.names.index("block")
    up = 1 - 2 * (end.quat[:2, slab, 1] ** 2 + end.quat[:2, slab, 2] ** 2)
    assert (np.degrees(np.arccos(np.clip(up, -1, 1))) < 0.3).all()
    assert np.abs(end.pos[:2, block] - start.pos[:2, block]).max() < 5e-4
    np.testing.assert_array_equal(end.scale, start.scale)


def test_a_candidate_that_fails_stays_where_it_was_placed(settled):
    _, start, end = settled
    np.testing.assert_array_equal(end.pos[2], start.pos[2])
    np.testing.assert_array_equal(end.quat[2], start.quat[2])


def test_settling_is_measured_by_tilt_and_height(settled):
    model, start, end = settled
    at = placed_at_rest(model, *(jax.tree.map(lambda x: x[:1], p) for p in (start, end)))
    by = dict(zip(model.names, np.asarray(at.settled)[0], strict=True))
    assert by["table"] == 0.0
    assert by["slab"] == pytest.approx(0.06 / np.radians(15), rel=0.05)
    assert by["block"] < 0.05


def test_terminal_speed_with_drag_is_independent_of_size(settled):
    model, _, _ = settled
    dragged = with_drag(model)
    assert with_drag(model).static is dragged.static
    logs = np.tile(np.float32([[-0.3], [0.3]]), (1, len(model.names)))
    layouts = Layout.zero(2, len(model.names))
    poses = model.place(Layout(layouts.xy, layouts.yaw, jax.device_put(logs)))
    poses = jax.tree.map(np.array, poses)
    poses.pos[:, :, 2] += np.float32([0.0, 3.0, 3.0])[: len(model.names)]
    fall = NativeEngine().rollout(dragged, poses, duration=0.4, record_every=0.2)
    speed = (fall.pos[:, 0] - fall.pos[:, 1])[..., 2] / 0.2
    np.testing.assert_allclose(speed[:, 1:], FALL_M_S, rtol=0.02)


def test_a_settled_scene_is_exact():
    scene = at_rest(tilted(), ((True, 0.5), (False, 0.3)))
    assert scene.object("slab").base_tilt == (1.0, 0.0, 0.0, 0.0)
    ends = world_poses(scene)
    assert ends["slab"].pos[2] == pytest.approx(ends["block"].pos[2], abs=5e-4)


def test_an_object_pushed_aside_keeps_its_heading():
    bin_ = scenes.single("bin", (HollowBox(size=(0.13, 0.11, 0.06), wall=0.006), (0, 0, 0)))
    block = scenes.single("block", (Box(size=(0.06, 0.05, 0.05)), (0, 0, 0)))
    scene = scenes.on_table((bin_, (0, 0), 0.0, {}), (block, (0.035, 0.02), 0.3, {}))
    rest = at_rest(scene, ((True, 0.5), (False, 0.5)))
    way = np.subtract(rest.object("block").xy, scene.object("block").xy)
    # A corner of it was 8 mm in the wall; without that drag it turned by 5.5 degrees.
    assert np.linalg.norm(way) > 0.005
    assert abs(rest.object("block").yaw - 0.3) < np.radians(0.5)
    assert abs(rest.object("bin").yaw) < np.radians(0.5)


def test_populations_keep_headings_too(settled):
    model, _, _ = settled
    static = with_drag(model).static
    for name in ("slab", "block"):
        about = static.mjm.dof_damping[static.mjm.body(name).dofadr[0] + np.arange(3, 6)]
        np.testing.assert_allclose(about[2], HEADING * about[:2], rtol=1e-12)


def test_children_move_with_their_parent():
    scene = tilted()
    end = pose([0.3, 0.1, 0.5])
    there = moved(scene, {"slab": end})
    np.testing.assert_allclose(world_poses(there)["slab"].pos, [0.3, 0.1, 0.5], atol=1e-12)
    np.testing.assert_allclose(world_poses(there)["block"].pos, world_poses(scene)["block"].pos)
