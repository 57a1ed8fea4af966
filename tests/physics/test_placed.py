"""Measures of placed candidates, with numbers computed by hand: masks, chunks, displacement."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neoworld_mjx.physics.layout import Layout, Poses
from neoworld_mjx.physics.placed import (
    TILT_BOUND_LYING,
    TILT_BOUND_UPRIGHT,
    pair_depths,
    pair_gaps,
    settling_displacement,
)
from neoworld_mjx.spec import Sphere
from tests.support import scenes
from tests.support.scenes import compile_scene

SMALL_TURN = np.radians(9.0)


@pytest.fixture(scope="module")
def shelf():
    """A shelf (a support) 1 cm deep in the table (a support), and a block 5 mm deep in it."""
    box = scenes.block("shelf", (0.2, 0.2, 0.1))
    block = scenes.block("block", (0.06, 0.06, 0.06))
    support = {"environment": True, "z": 0.03}
    spec = scenes.on_table(
        (box, (0, 0), 0.0, support),
        (block, (0, 0.125), 0.0, {"z": 0.05}),
        (block.model_copy(update={"name": "far"}), (0, -0.3), 0.0, {"z": 0.05}),
    )
    return compile_scene(spec, samples=64)


def test_the_overlap_of_supports_is_no_penetration_but_that_of_an_object_with_one_is(shelf):
    poses = shelf.place_exactly(Layout.zero(1, 4))
    # As one program, which both scenes share; op by op, 160 are compiled.
    depths = jax.jit(pair_depths)
    depth = np.asarray(depths(shelf.arrays, poses))[0]
    table, wall, block, far = (shelf.names.index(n) for n in ("table", "shelf", "block", "far"))
    assert depth[table, wall] == depth[wall, table] == 0.0
    assert not depth.diagonal().any()
    assert max(depth[block, wall], depth[wall, block]) == pytest.approx(0.005, abs=1e-5)
    assert depth[far].max() == depth[:, far].max() == 0.0
    # Without the mask they overlap by 1 cm: the mask, not the distance, makes it 0.
    unmasked = dataclasses.replace(shelf, pair_mask=jnp.ones((4, 4), bool))
    raw = np.asarray(depths(unmasked.arrays, poses))[0]
    assert max(raw[table, wall], raw[wall, table]) == pytest.approx(0.01, abs=1e-5)
    gap = np.asarray(jax.jit(pair_gaps)(shelf.arrays, poses))[0]
    assert gap[table, wall] == gap[wall, table] == np.inf and np.isinf(gap.diagonal()).all()
    assert gap[block, wall] == gap[wall, block] == pytest.approx(-0.005, abs=1e-5)
    assert gap[far, table] == gap[table, far] == pytest.approx(0.01, abs=1e-5)


def turned(scene, name, *, about_x=0.0, shift=(0.0, 0.0, 0.0), tilt=0.0, scale=1.0):
    """Displacement of an object that turns about x around its center by an angle [rad] and moves.

    `tilt` is its angle before, about x, too.
    """
    k = scene.names.index(name)
    corners = np.asarray(scene.corners)[k]
    center = scale * (corners.min(axis=0) + corners.max(axis=0)) / 2
    count = len(scene.names)
    poses = []
    for angle, moved in ((tilt, (0.0, 0.0, 0.0)), (tilt + about_x, shift)):
        pos, quat = np.zeros((1, count, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (1, count, 1))
        c, s = np.cos(angle), np.sin(angle)
        quat[0, k] = [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
        x, y, z = center
        pos[0, k] = np.array(moved) - [x, c * y - s * z, s * y + c * z]
        size = np.full((1, count), scale)
        poses.append(Poses(pos, quat, size, np.zeros((1, count))))
    return settling_displacement(scene, *poses, np)[0, k]


@pytest.fixture(scope="module")
def bodies():
    """A plate, a cube, a ball and a small plate."""
    sizes = {"plate": (0.2, 0.2, 0.1), "cube": (0.1, 0.1, 0.09), "small": (0.04, 0.02, 0.01)}
    items = [
        (scenes.block(name, size), (0, 0.2 * k - 0.3), 0.0, {})
        for k, (name, size) in enumerate(sizes.items())
    ]
    ball = scenes.single("ball", (Sphere(radius=0.05), (0, 0, 0)))
    return compile_scene(scenes.on_table(*items, (ball, (0, 0.3), 0.0, {})), samples=16)


def test_tilt_is_compared_with_the_bound_of_what_the_object_is(bodies):
    assert np.degrees([TILT_BOUND_UPRIGHT, TILT_BOUND_LYING]) == pytest.approx([15.0, 45.0])
    assert turned(bodies, "plate", about_x=SMALL_TURN) == pytest.approx(9 / 15)
    assert turned(bodies, "plate", about_x=-SMALL_TURN) == pytest.approx(9 / 15)
    # Placed tilted by 3 degrees, or compact enough to roll: the bound is wider.
    tilted = turned(bodies, "plate", about_x=SMALL_TURN, tilt=np.radians(3.0))
    assert tilted == pytest.approx(9 / 45)
    assert turned(bodies, "cube", about_x=SMALL_TURN) == pytest.approx(9 / 45)
    # Placed tilted by less than 2 degrees, it counts as upright.
    upright = turned(bodies, "plate", about_x=SMALL_TURN, tilt=np.radians(1.0))
    assert upright == pytest.approx(9 / 15)
    for free in ("ball", "small"):
        assert turned(bodies, free, about_x=2.0) == pytest.approx(0.0, abs=1e-12)
    # A small plate of twice the size is not small.
    assert turned(bodies, "small", about_x=SMALL_TURN, scale=2.0) == pytest.approx(9 / 15)
