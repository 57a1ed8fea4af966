"""Objects that overlap a wall of their container are moved out of it."""

import numpy as np
import pytest

from neoworld_mjx.compose.on_supports import CLEAR_M, clear_walls
from neoworld_mjx.physics.colliders import object_depths, start_state
from neoworld_mjx.spec import Box, HollowBox
from tests.support import scenes

INSIDE, WALL = 0.15, 0.006
"""Width between a tray's walls, and of one of them [m]."""


def in_tray(width, off, *more, turn=0.0, relation="in"):
    """A block in a tray that is turned by a quarter, `off` [m] from its middle along its y axis.

    A bead stands on the block, and `more` in the tray.
    """
    outer = INSIDE + 2 * WALL
    tray = scenes.single("tray", (HollowBox(size=(outer, outer, 0.06), wall=WALL), (0, 0, 0)))
    block = scenes.single("block", (Box(size=(width, width, 0.05)), (0, 0, 0)))
    bead = scenes.single("bead", (Box(size=(0.01, 0.01, 0.01)), (0, 0, 0)))
    beside = {"parent": "tray", "relation": relation, "z": WALL + 1e-4}
    return scenes.on_table(
        (tray, (0, 0), np.pi / 2, {"z": 0.0401}),
        (block, (0.0, off), turn, beside),
        (bead, (0, 0), 0.0, {"parent": "block", "z": 0.0501}),
        *((spec, xy, 0.0, beside) for spec, xy in more),
    )


def depths(scene):
    return object_depths(scene, *start_state(scene))


@pytest.mark.parametrize("relation", ["in", "on"])
def test_a_block_that_overlaps_a_wall_clears_it_by_the_shortest_displacement(relation):
    scene = in_tray(0.08, 0.04, relation=relation)
    assert depths(scene)["tray", "block"] == pytest.approx(0.005, abs=1e-4)
    clear, moved = clear_walls(scene)
    assert moved == {"block": pytest.approx(0.005 + CLEAR_M, abs=1e-4)}
    assert clear.object("block").xy == pytest.approx((0.0, 0.035 - CLEAR_M), abs=1e-4)
    assert depths(clear) == {}
    same = [o for o in clear.objects if o.name != "block"]
    assert same == [o for o in scene.objects if o.name != "block"]


def test_a_rotated_block_clears_the_wall_with_its_corner():
    clear, moved = clear_walls(in_tray(0.08, 0.03, turn=np.pi / 4))
    assert list(moved) == ["block"]
    assert moved["block"] == pytest.approx(0.03 + 0.04 * np.sqrt(2) - INSIDE / 2, abs=5e-4)
    assert depths(clear) == {}


@pytest.mark.parametrize(
    ("width", "off"), [(0.08, 0.0), (0.08, 0.0355), (0.155, 0.0)], ids=["clear", "hardly", "wide"]
)
def test_a_block_without_overlap_or_without_space_does_not_move(width, off):
    scene = in_tray(width, off)
    assert clear_walls(scene) == (scene, {})


def test_a_block_does_not_move_into_another_block():
    other = scenes.single("other", (Box(size=(0.05, 0.05, 0.05)), (0, 0, 0)))
    near, clear = (in_tray(0.08, 0.04, (other, (0.0, y))) for y in (-0.027, -0.031))
    assert clear_walls(near) == (near, {})
    assert list(clear_walls(clear)[1]) == ["block"]
