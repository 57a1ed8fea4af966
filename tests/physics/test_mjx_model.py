"""Motion under a tilted pull: what rests, slides, topples, rolls and falls shut, as it should."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.engine import RolloutStatus
from neoworld_mjx.physics.layout import Layout, Variation
from neoworld_mjx.physics.mjx_engine import MjxEngine
from neoworld_mjx.physics.native import NativeEngine
from neoworld_mjx.spec import Box, HollowBox, Material, ObjectSpec, Sphere, recentred
from tests.support.mechanisms import geom, joint, part
from tests.support.scenes import WOOD, compile_scene, on_table, single

G, SLOPE = 9.81, 0.35
"""Pull [m/s^2], and its share along +x, as on a slope of 20 degrees."""
ICE = Material(name="ice", density=900, friction=0.1)
DURATION = 0.4


def chest():
    """A box with a lid that stands open by 0.8 rad and falls shut."""
    body = HollowBox(size=(0.08, 0.08, 0.05), wall=0.008)
    lid = Box(size=(0.08, 0.08, 0.006))
    parts = (
        part("body", geom("body", body, (0, 0, 0.025)), mass=2.0),
        part("lid", geom("lid", lid, (0, 0, 0.054)), mass=0.1),
    )
    hinge = joint("hinge", "revolute", "body", "lid", (-0.04, 0, 0.051), axis=(0, -1, 0), upper=1.2)
    return recentred(ObjectSpec(name="chest", materials=(WOOD,), parts=parts, joints=(hinge,)))


@pytest.fixture(scope="module")
def slope():
    rest = single("rest", (Box(size=(0.06, 0.06, 0.03)), (0, 0, 0)))
    slide = single("slide", (Box(size=(0.06, 0.06, 0.03)), (0, 0, 0)), material=ICE)
    tall = single("tall", (Box(size=(0.02, 0.05, 0.12)), (0, 0, 0)))
    ball = single("ball", (Sphere(radius=0.03), (0, 0, 0)))
    open_ = {"joint_state": {"hinge": 0.8}}
    spec = on_table(
        (rest, (-0.2, -0.3), 0.0, {}),
        (slide, (-0.2, -0.15), 0.0, {}),
        (tall, (-0.2, 0.0), 0.0, {}),
        (ball, (-0.2, 0.15), 0.0, {}),
        (chest(), (-0.2, 0.3), 0.0, open_),
        name="slope",
    )
    # The table is of ice, too, as friction is the larger one of both.
    table = single("table", (Box(size=(0.6, 0.8, 0.04)), (0, 0, 0)), material=ICE)
    objects = (spec.objects[0].model_copy(update={"spec": table}), *spec.objects[1:])
    pull = (G * SLOPE, 0.0, -G * np.sqrt(1 - SLOPE**2))
    return compile_scene(spec.model_copy(update={"objects": objects, "gravity": pull}))


@pytest.fixture(scope="module")
def rollouts(slope):
    """Candidate 1 has the tall block 4 mm inside the sliding one; 2 is not a number.

    In candidate 4, the ice is rough, the block at rest is slippery, the ball is ten times as heavy,
    and the lid less open.
    """
    xy = np.zeros((5, 6, 2), np.float32)
    xy[1, 3, 1] = -0.099
    xy[2, 1] = np.nan
    still = Layout.zero(5, 6)
    ones, opening = np.ones((5, 6), np.float32), np.zeros((5, 1), np.float32)
    mass, friction = ones.copy(), ones.copy()
    friction[4, [1, 2]], mass[4, 4], opening[4] = (0.1, 6.0), 10.0, -0.5
    variation = Variation(mass, friction, ones[:, :1], ones[:, :1], opening)
    placed = slope.place(Layout(jnp.asarray(xy), still.yaw, still.log_scale))
    poses = replace(placed, variation=variation)
    ours = MjxEngine().rollout(slope, poses, duration=DURATION)
    return ours, NativeEngine().rollout(slope, poses, duration=DURATION)


def moved(rollout, name, slope):
    k = slope.names.index(name)
    return np.asarray(rollout.pos[:, -1, k] - rollout.start.pos[:, k])


def test_a_box_rests_and_one_of_ice_slides(slope, rollouts):
    ours = rollouts[0]
    assert np.linalg.norm(moved(ours, "rest", slope)[0]) < 1e-3
    fall = G * (SLOPE - 0.1 * np.sqrt(1 - SLOPE**2)) * DURATION**2 / 2
    assert moved(ours, "slide", slope)[0, 0] == pytest.approx(fall, rel=0.03)


def test_a_ball_rolls_without_slipping(slope, rollouts):
    way = 5 / 7 * G * SLOPE * DURATION**2 / 2
    assert moved(rollouts[0], "ball", slope)[0, 0] == pytest.approx(way, rel=0.03)


def test_a_lid_falls_shut_and_stays_within_its_limits(slope, rollouts):
    shift = np.asarray(rollouts[0].joint_shift[0, -1, 0])
    assert shift == pytest.approx(0.8, abs=0.05)


def test_motion_is_that_of_mujoco(slope, rollouts):
    ours, theirs = rollouts
    # On its one soft contact the ball bobs by millimetres.
    for name, bound in {"rest": 3e-3, "slide": 3e-3, "ball": 1e-2, "chest": 3e-3}.items():
        k = slope.names.index(name)
        apart = np.linalg.norm(
            np.asarray(ours.pos[0, :, k]) - np.asarray(theirs.pos[0, :, k]), axis=1
        )
        assert apart.max() < bound, name


def test_overlap_is_pushed_apart_without_an_explosion(slope, rollouts):
    ours, theirs = rollouts
    for name in ("slide", "tall"):
        assert np.linalg.norm(moved(ours, name, slope)[1]) < 0.6
    assert ours.status[1] == theirs.status[1] == int(RolloutStatus.OK)


def test_a_candidate_that_is_not_a_number_fails_alone(rollouts):
    ours, _ = rollouts
    assert ours.status.tolist() == [0, 0, int(RolloutStatus.FAILED), 0, 0]
    assert np.array_equal(ours.pos[0], ours.pos[3])


def test_masses_frictions_and_openings_vary(slope, rollouts):
    ours, theirs = rollouts
    assert np.linalg.norm(moved(ours, "slide", slope)[4]) < 1e-3
    assert moved(ours, "rest", slope)[4, 0] > 0.1
    for name in ("slide", "rest", "ball"):
        apart = moved(ours, name, slope)[4] - moved(theirs, name, slope)[4]
        assert np.linalg.norm(apart) < 5e-3, name
    assert np.asarray(ours.joint_shift)[4, -1, 0] == pytest.approx(0.3, abs=0.05)
