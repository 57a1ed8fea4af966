"""Objects stand on what is under them, and keep the level at which they were composed."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.on_supports import against_walls, put_down, snap
from neoworld_mjx.physics.colliders import object_of_geom, pair_distance, start_state
from neoworld_mjx.spec import Box, Camera, Cylinder, Extrusion, SceneObject, SceneSpec
from neoworld_mjx.spec.pose import from_axis_angle
from tests.support import scenes

HALF, HOLE = 0.05, 0.02
"""Half the width of a rack, and of the hole in its upper plate [m]."""


def square(half):
    return ((-half, -half), (half, -half), (half, half), (-half, half))


def rack_and_peg(xy=(0.0, 0.0), scale=1.0):
    """A peg on the lower plate of a rack, 1 mm from the rim of the upper plate's hole."""
    upper = Extrusion(outline=square(HALF), holes=(square(HOLE),), height=0.005)
    rack = scenes.single(
        "rack",
        (Box(size=(2 * HALF, 2 * HALF, 0.005)), (0, 0, 0.0025)),
        (upper, (0, 0, 0.0425)),
        *((Box(size=(2 * HALF, 0.004, 0.045)), (0, side * HALF, 0.0225)) for side in (-1, 1)),
    ).scaled(scale)
    peg = scenes.single("peg", (Cylinder(radius=0.019, height=0.12), (0, 0, 0.06))).scaled(scale)
    items = (
        SceneObject(name="table", spec=scenes.table(), environment=True, z=-0.04),
        SceneObject(name="rack", spec=rack, parent="table"),
        SceneObject(name="peg", spec=peg, parent="rack", relation="in", xy=xy, yaw=xy[0]),
    )
    return snap(SceneSpec(objects=items))


@pytest.mark.parametrize(("x", "on_rim"), [(0.0003, False), (0.004, True)])
def test_an_aligned_object_keeps_its_level(x, on_rim):
    """Snapping alone would raise a peg that overlaps the wall of its hole onto the rim."""
    composed = rack_and_peg()
    peg = composed.object("peg").model_copy(update={"xy": (x, 0.0)})
    aligned = composed.model_copy(update={"objects": (*composed.objects[:2], peg)})
    assert (snap(aligned).object("peg").z > peg.z + 0.03) is on_rim
    placed = put_down(aligned).object("peg")
    assert placed.z == pytest.approx(peg.z, abs=1e-4)
    assert placed.xy == (x, 0.0)


def test_an_aligned_object_is_put_down_by_a_small_distance():
    composed = rack_and_peg()
    raised = composed.object("peg").model_copy(update={"z": composed.object("peg").z + 0.004})
    aligned = composed.model_copy(update={"objects": (*composed.objects[:2], raised)})
    assert put_down(aligned).object("peg").z == pytest.approx(composed.object("peg").z, abs=1e-6)


def on_wall(*, xy=(-0.2, 0.1), wall_yaw=0.3, yaw=0.2, lean=0.0, **update):
    """A box fastened to a wall 6 cm thick, which a camera at the origin sees from in front."""
    wall = scenes.single("wall", (Box(size=(0.06, 2.0, 2.0)), (0, 0, 1.0)))
    box = scenes.single("box", (Box(size=(0.2, 0.3, 0.1)), (0, 0, 0.05)))
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), lean).tolist())
    fastened = {"parent": "wall", "relation": "attached", "fixed_base": True} | update
    items = (
        SceneObject(name="wall", spec=wall, environment=True, xy=(2.0, 0.0), yaw=wall_yaw),
        SceneObject(name="box", spec=box, xy=xy, z=0.8, yaw=yaw, base_tilt=tilt, **fastened),
    )
    camera = Camera(width=64, height_px=48, fovy=0.8, height=1.0, pitch=0.2)
    return SceneSpec(objects=items, camera=camera)


@pytest.mark.parametrize("lean", [0.0, 0.2])
@pytest.mark.parametrize("wall_yaw", [0.3, math.pi + 0.3])
@pytest.mark.parametrize("x", [-0.4, 0.02, 0.3])
def test_what_is_attached_touches_the_face_of_its_wall_that_the_camera_sees(x, wall_yaw, lean):
    scene = against_walls(on_wall(xy=(x, 0.1), wall_yaw=wall_yaw, lean=lean))
    box = scene.object("box")
    assert box.xy[1] == 0.1 and box.z == 0.8
    assert (box.xy[0] > 0) is (wall_yaw > 3), "the camera is at the origin"
    model, data = start_state(scene)
    owner = object_of_geom(scene, model)
    geoms = [np.flatnonzero(owner == k) for k in range(2)]
    assert pair_distance(model, data, *geoms) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    "update", [{"relation": "leaning", "fixed_base": False}, {"known": "pose"}]
)
def test_other_objects_keep_their_distance_from_a_wall(update):
    scene = on_wall(**update)
    assert against_walls(scene) == scene


def test_an_aligned_object_is_put_against_its_wall():
    assert put_down(on_wall()).object("box").xy == against_walls(on_wall()).object("box").xy
