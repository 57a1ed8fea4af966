"""Leaning objects are moved into contact with the object that they lean on."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.leaning import lean, move_walls_into_contact
from neoworld_mjx.physics.colliders import object_depths, start_state
from neoworld_mjx.spec import Box, SceneObject, SceneSpec
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes

TILT = math.radians(12.0)


def leaning_scene(gap, *, yaw=0.0):
    """A board tilted along x, `gap` [m] in front of a wall; a block touches the board's side."""
    table = scenes.single("table", (Box(size=(2.0, 2.0, 0.1)), (0, 0, -0.05)))
    wall = scenes.single("wall", (Box(size=(0.1, 2.0, 1.0)), (0, 0, 0.5)))
    board = scenes.single("board", (Box(size=(0.02, 0.2, 0.3)), (0, 0, 0.15)))
    block = scenes.single("block", (Box(size=(0.05, 0.05, 0.05)), (0, 0, 0.025)))
    reach = 0.01 * math.cos(TILT) + 0.3 * math.sin(TILT)
    tilt = tuple(from_axis_angle((0, 1, 0), TILT).tolist())
    height = 0.01 * math.sin(TILT)
    root = {"parent": None, "environment": True}
    return SceneSpec(
        name="leaning",
        objects=(
            SceneObject(name="table", spec=table, xy=(0, 0), z=-0.1, **root),
            SceneObject(name="wall", spec=wall, xy=(0.55, 0), z=0.0, **root),
            SceneObject(
                name="board",
                spec=board,
                parent="table",
                relation="leaning",
                xy=(0.5 - reach - gap, 0.0),
                z=0.1 + height,
                yaw=yaw,
                base_tilt=tilt,
            ),
            SceneObject(
                name="block", spec=block, parent="table", xy=(0.5 - reach - gap, 0.1251), z=0.1
            ),
        ),
    )


def test_a_stated_object_is_reached_from_farther_and_others_are_passed():
    scene = leaning_scene(0.2)
    assert lean(scene)[1] == {}
    to_wall, to_block = (
        scene.model_copy(update={"objects": tuple(
            item.model_copy(update={"leans_on": name}) if item.name == "board" else item
            for item in scene.objects
        )})
        for name in ("wall", "block")
    )  # fmt: skip
    assert lean(to_wall)[1] == {"board": (pytest.approx(0.2, abs=5e-4), "wall")}
    # The block stands beside the board, not ahead of it.
    assert lean(to_block)[1] == {}


@pytest.mark.parametrize("gap", [0.1, 0.01, -0.02, -0.06])
def test_a_board_moves_into_contact_with_the_wall_and_keeps_its_tilt(gap):
    scene = leaning_scene(gap)
    leant, moved = lean(scene)
    assert moved == {"board": (pytest.approx(gap, abs=5e-4), "wall")}
    before, after = scene.object("board"), leant.object("board")
    assert after.xy == pytest.approx((before.xy[0] + gap, 0.0), abs=5e-4)
    assert after == before.model_copy(update={"xy": after.xy})
    assert leant.object("block") == scene.object("block")
    model, data = start_state(leant)
    depths = object_depths(leant, model, data)
    assert max((d for pair, d in depths.items() if "board" in pair), default=0.0) < 1e-4


@pytest.mark.parametrize("gap", [0.0005, 0.3, -0.0005, -0.16])
def test_a_board_in_contact_or_too_far_away_does_not_move(gap):
    scene = leaning_scene(gap)
    leant, moved = lean(scene)
    assert moved == {} and leant is scene


def test_only_leaning_objects_move_and_only_toward_their_tops():
    turned = leaning_scene(0.1, yaw=math.pi)
    assert lean(turned)[1] == {}
    scene = leaning_scene(0.1)
    standing = scene.object("board").model_copy(update={"relation": "on"})
    objects = tuple(standing if o.name == "board" else o for o in scene.objects)
    assert lean(scene.model_copy(update={"objects": objects}))[1] == {}
    # A book leans on a book that leans on the wall: the farther one moves first.
    second = scene.object("board").model_copy(
        update={"name": "second", "xy": tuple(np.array(scene.object("board").xy) - [0.05, 0])}
    )
    chain = scene.model_copy(update={"objects": (*scene.objects[:3], second)})
    _, moved = lean(chain)
    assert list(moved) == ["board", "second"] and moved["second"][1] == "board"


def test_a_wall_moves_up_to_what_leans_on_it():
    before = leaning_scene(0.05)
    after, brought = move_walls_into_contact(before)
    assert brought == {"wall": pytest.approx(0.05, abs=1e-3)}
    assert after.object("board") == before.object("board")
    assert not lean(after)[1]
