"""Poses of a layout, computed by hand: order of scale, tilt, yaw and translation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout, arrange, compose_poses, frames, heights, rotation
from neoworld_mjx.spec import Box, SceneObject, SceneSpec
from tests.support import scenes
from tests.support.scenes import compile_scene

snapped = jax.jit(heights)
"""Heights of one compiled program; op by op, dozens are compiled."""

HALF = np.sqrt(0.5)
ABOUT_X = (HALF, HALF, 0.0, 0.0)
"""A quarter turn about x, which carries z to -y."""


def chain():
    """A tilted child on a turned parent; the boxes' origins are at the middle of their bottoms."""
    block = scenes.block("block", (0.1, 0.1, 0.3))
    parent = SceneObject(name="parent", spec=block, xy=(1.0, 2.0), z=0.5, yaw=np.pi / 4)
    child = SceneObject(
        name="child",
        spec=block,
        parent="parent",
        xy=(0.3, 0.0),
        z=0.7,
        yaw=np.pi / 6,
        base_tilt=ABOUT_X,
    )
    return SceneSpec(name="chain", objects=(parent, child))


def layout(xp):
    """The parent turned to 90 degrees at twice its size; the child turned to 180 in the world."""
    numbers = ([[[0.0, 0.0], [0.1, 0.2]]], [[np.pi / 4, np.pi / 3]], [[np.log(2.0), np.log(3.0)]])
    return Layout(*(xp.asarray(x, np.float32) for x in numbers))


@pytest.mark.parametrize("xp", [np, jnp])
def test_a_tilted_child_of_a_turned_and_scaled_parent(xp):
    height = xp.asarray([[0.5, 1.4]], np.float32)
    poses = compose_poses(frames(chain()), layout(xp), height, xp)
    # The offset (0.4, 0.2) is scaled by the parent alone, and turned by 90 degrees.
    expected = [[1.0, 2.0, 0.5], [1.0 - 2 * 0.2, 2.0 + 2 * 0.4, 0.5 + 1.4]]
    assert poses.pos[0] == pytest.approx(np.array(expected), abs=1e-5)
    # Yaw of 180 degrees after the tilt: k (1 + i) sqrt(1/2) = (k + j) sqrt(1/2).
    assert poses.quat[0, 0] == pytest.approx(np.array([HALF, 0, 0, HALF]), abs=1e-6)
    assert poses.quat[0, 1] == pytest.approx(np.array([0, 0, HALF, HALF]), abs=1e-6)
    # Tilt carries the child's z axis to -y, then yaw to +y; its x axis to -x.
    axes = rotation(poses.quat, xp)[0, 1]
    assert axes[:, 2] == pytest.approx(np.array([0.0, 1.0, 0.0]), abs=1e-6)
    assert axes[:, 0] == pytest.approx(np.array([-1.0, 0.0, 0.0]), abs=1e-6)
    # A child does not take its parent's size.
    assert poses.scale[0] == pytest.approx(np.array([2.0, 3.0]), rel=1e-6)
    assert poses.height.tolist() == height.tolist()


@pytest.mark.parametrize("degrees", [0.0, 30.0])
def test_an_object_is_scaled_and_tilted_before_it_turns_on_its_support(degrees):
    """A post of 10 x 10 x 30 cm that lies on its side touches at half its width, at any yaw.

    If it were turned before it is tilted, it would stand on an edge.
    """
    post = scenes.block("post", (0.1, 0.1, 0.3))
    lying = {"base_tilt": ABOUT_X, "z": 0.04 + 0.05}
    scene = compile_scene(scenes.on_table((post, (0.02, 0.1), 0.0, lying)), samples=16)
    numbers = Layout.zero(2, 2)
    yaw = np.zeros((2, 2), np.float32)
    yaw[:, 1] = np.radians(degrees)
    size = np.zeros((2, 2), np.float32)
    size[1, 1] = np.log(1.2)
    poses = scene.place(Layout(numbers.xy, jnp.asarray(yaw), jnp.asarray(size)))
    # The table's top is 4 cm above its origin, at height 0; the table is at x = 0.5.
    assert poses.height[:, 1] == pytest.approx(np.array([0.04 + 0.05, 0.04 + 0.06]), abs=1e-5)
    assert poses.pos[1, 1] == pytest.approx(np.array([0.5 + 0.02, 0.1, 0.06]), abs=1e-5)


@pytest.mark.parametrize("xp", [np, jnp])
def test_a_chain_of_three_on_a_frame_beside_its_parent(xp):
    """Each offset is scaled by its own parent, and turned by the yaws below it."""
    block = scenes.block("block", (0.1, 0.1, 0.3))
    lowest = SceneObject(name="lowest", spec=block, xy=(1.0, 2.0), z=0.5)
    middle = SceneObject(name="middle", spec=block, parent="lowest", xy=(0.3, 0.1), z=0.3)
    top = SceneObject(name="top", spec=block, parent="middle", xy=(0.2, 0.4), z=0.3)
    a = frames(SceneSpec(name="three", objects=(lowest, middle, top)))
    assert a.parent.tolist() == [-1, 0, 1]
    # The middle one stands on a part that is moved by (0.4, 0.5, 0.6) and turned by 90 degrees.
    a.frame_pos[1], a.frame_yaw[1] = (0.4, 0.5, 0.6), np.pi / 2
    yaw = xp.asarray([[np.pi / 2, np.pi, 0.0]], np.float32)
    size = xp.asarray(np.log([[2.0, 3.0, 1.0]]), np.float32)
    zero = Layout(xp.zeros((1, 3, 2), np.float32), yaw, size)
    poses = compose_poses(a, zero, xp.asarray([[0.5, 0.7, 0.8]], np.float32), xp)
    # (0.8, 1.0, 1.2) turned by 90 degrees, and (0.6, 0.2, 0.7) by 180.
    second = np.array([1.0 - 1.0 - 0.6, 2.0 + 0.8 - 0.2, 0.5 + 1.2 + 0.7])
    # The top one is turned by 90 + 90 + 180 degrees.
    expected = [[1.0, 2.0, 0.5], second, second + [0.6, 1.2, 0.8]]
    assert poses.pos[0] == pytest.approx(np.array(expected), abs=1e-5)


def test_an_object_that_is_turned_over_a_step_rests_on_it():
    stairs = scenes.single(
        "stairs",
        (Box(size=(0.8, 0.8, 0.04)), (0, 0, 0)),
        (Box(size=(0.8, 0.3, 0.06)), (0, 0.25, 0.01)),
    )
    bar = scenes.block("bar", (0.3, 0.04, 0.04))
    below = SceneObject(name="stairs", spec=stairs, environment=True)
    beside = SceneObject(name="bar", spec=bar, parent="stairs", xy=(0.0, 0.0), z=0.04)
    a = arrange(SceneSpec(name="step", objects=(below, beside)))
    zero = Layout.zero(2, 2)
    # Along the step, which begins 10 cm from it, and 15 cm across it.
    turned = Layout(zero.xy, zero.yaw.at[1, 1].set(np.pi / 2), zero.log_scale)
    low, high = np.asarray(snapped(a, turned))[:, 1]
    assert high - low == pytest.approx(0.02, abs=1e-5)
