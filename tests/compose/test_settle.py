"""Objects on supports that are not level are settled before the search."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.on_supports import snap
from neoworld_mjx.compose.settle import has_same_footprint, position_inside, settle
from neoworld_mjx.measure.scene_check import measured
from neoworld_mjx.spec import Box, Cylinder, HollowBox, SceneObject, SceneSpec
from neoworld_mjx.spec.pose import angle_between, from_axis_angle, rotate
from tests.support import scenes

TILTED = tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(12)).tolist())


def on_saucer(xy=(0.0, 0.035)):
    saucer = SceneObject(name="saucer", spec=scenes.saucer(), z=0.0001)
    bar = scenes.block("spoon", (0.12, 0.014, 0.006))
    spoon = SceneObject(name="spoon", spec=bar, parent="saucer", xy=xy, z=0.02, base_tilt=TILTED)
    table = SceneObject(name="table", spec=scenes.table(), environment=True, z=-0.04)
    return table, saucer.model_copy(update={"parent": "table", "z": 0.0401}), spoon


def turned(objects):
    scene = snap(SceneSpec(objects=objects))
    return measured(scene).tilt_deg["spoon"]


def test_a_settled_spoon_is_stable():
    table, saucer, spoon = on_saucer()
    rested = settle(saucer, spoon)
    assert rested is not None
    assert turned((table, saucer, spoon)) > 4
    assert turned((table, saucer, rested)) < 1
    assert np.hypot(*np.subtract(rested.xy, spoon.xy)) < 0.02
    assert angle_between(rested.base_tilt, TILTED) < math.radians(30)
    # The result does not depend on the saucer's position and yaw.
    moved = saucer.model_copy(update={"xy": (0.1, 0.2), "yaw": 1.0})
    assert settle(moved, spoon) == rested


def test_a_block_in_an_open_drawer_lies_flat_and_the_drawer_stays_open():
    cabinet = SceneObject(
        name="cabinet", spec=scenes.cabinet(), environment=True, joint_state={"slide": 0.15}
    )
    block = SceneObject(
        name="block",
        spec=scenes.single("block", (Box(size=(0.05, 0.06, 0.03)), (0, 0, 0.015))),
        parent="cabinet",
        parent_link="drawer",
        relation="in",
        z=0.03,
        yaw=0.4,
        base_tilt=TILTED,
    )
    rested = settle(cabinet, block)
    assert rested is not None
    assert rotate(rested.base_tilt, np.array([0.0, 0.0, 1.0]))[2] == pytest.approx(1.0, abs=1e-4)
    assert rested.xy == pytest.approx((0.0, 0.0), abs=0.015)
    assert rested.yaw == pytest.approx(0.4, abs=0.05)
    assert rested.z == pytest.approx(0.05, abs=5e-4)


def in_cup(xy, lean):
    """Return a cup, and a stick that leans in it towards +x; its lower end is at `xy`."""
    cup = SceneObject(name="cup", spec=scenes.cup(), environment=True)
    stick = scenes.single("stick", (Cylinder(radius=0.003, height=0.12), (0, 0, 0.06)))
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), math.radians(lean)).tolist())
    return cup, SceneObject(
        name="stick", spec=stick, parent="cup", relation="in", xy=xy, z=0.006, base_tilt=tilt
    )


@pytest.mark.parametrize("x", [-0.015, 0.02, 0.09])
def test_a_stick_that_penetrates_its_cup_settles_inside(x):
    cup, stick = in_cup((x, 0.004), 38)
    rested = settle(cup, stick)
    assert rested is not None
    # Its lower end is on the bottom beyond the center; it still leans to the same side.
    assert rested.z < 0.015 and -0.035 < rested.xy[0] < 0.0
    up = rotate(from_axis_angle((0.0, 0.0, 1.0), rested.yaw), np.array([1.0, 0.0, 0.0]))
    assert up[0] > 0.9
    assert angle_between(rested.base_tilt, stick.base_tilt) < math.radians(15)
    table = SceneObject(name="table", spec=scenes.table(), environment=True, z=-0.04)
    held = cup.model_copy(update={"parent": "table", "environment": False, "z": 0.0401})
    before = measured(snap(SceneSpec(objects=(table, held, stick))))
    after = measured(snap(SceneSpec(objects=(table, held, rested))))
    assert after.max_depth_m < 0.001 and after.drift_m["stick"] < 0.005
    assert x < 0 or before.drift_m["stick"] > 0.005 or before.max_depth_m > 0.001


def tray():
    """A tray of 20 x 30 cm with walls 1 cm thick and 10 cm high, whose floor is at z = 1 cm."""
    spec = scenes.single("tray", (HollowBox(size=(0.2, 0.3, 0.1), wall=0.01), (0, 0, 0.05)))
    return SceneObject(name="tray", spec=spec, parent="table", xy=(3.0, 2.0), yaw=0.7, z=0.5)


def cube(xy, z=0.1, edge=0.04):
    spec = scenes.single("cube", (Box(size=(edge, edge, edge)), (0, 0, edge / 2)))
    return SceneObject(name="cube", spec=spec, parent="tray", relation="in", xy=xy, z=z)


CELL = np.array([0.2, 0.3]) / 47
"""Distance of the positions that are tried [m]."""


@pytest.mark.parametrize("xy", [(-0.1, 0.03), (0.1, 0.14)])
def test_an_object_on_the_rim_is_placed_inside_at_the_nearest_position(xy):
    found = position_inside(tray(), cube(xy))
    assert found is not None
    # Where its center may be between the walls.
    nearest = np.clip(xy, (-0.07, -0.12), (0.07, 0.12))
    assert (np.abs(found - nearest) < 2.5 * CELL).all()
    assert (np.abs(found) <= (0.0701, 0.1201)).all()


@pytest.mark.parametrize(
    ("x", "z", "moves"), [(0.03, 0.01, False), (0.085, 0.09, True), (0.085, 0.1, False)]
)
def test_only_an_object_that_snapping_would_raise_moves_if_asked(x, z, moves):
    """On the floor it stays; in the wall it would be raised to the rim; on the rim it stays."""
    found = position_inside(tray(), cube((x, 0.05), z=z), if_raised=True)
    assert found == pytest.approx((0.07, 0.05), abs=0.012) if moves else found is None


@pytest.mark.parametrize(("edge", "fits"), [(0.17, True), (0.19, False)])
def test_a_large_object_is_centered_or_does_not_fit(edge, fits):
    found = position_inside(tray(), cube((0.06, 0.05), edge=edge))
    if fits:
        # 5 mm of space on both sides.
        assert found == pytest.approx((0.0, 0.05), abs=0.012)
        assert found is not None and abs(found[0]) < 0.001
    else:
        assert found is None


def test_an_object_keeps_apart_from_those_that_are_inside():
    alone = position_inside(tray(), cube((0.085, 0.05)))
    assert alone is not None
    other = cube(tuple(alone.tolist()), z=0.01).model_copy(update={"name": "other"})
    found = position_inside(tray(), cube((0.085, 0.05)), [other])
    assert found is not None
    # By half of the mean width, as objects may be thinner than their boxes.
    assert 0.02 <= np.linalg.norm(found - alone) < 0.02 + 3 * CELL.max()


@pytest.mark.parametrize(
    ("scale", "same"), [(0.84, True), (1.2, True), (0.8, False), (1.24, False)]
)
@pytest.mark.parametrize("yaw", [0.0, np.pi / 2])
def test_a_lid_has_the_footprint_of_its_jar_within_18_percent(scale, same, yaw):
    size = (0.2 * scale, 0.3, 0.02) if yaw == 0 else (0.3, 0.2 * scale, 0.02)
    lid = SceneObject(name="lid", spec=scenes.block("lid", size), yaw=yaw)
    assert has_same_footprint(tray(), lid) is same
