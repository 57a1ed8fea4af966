"""Objects keep the level at which they were composed, whatever the alignment saw."""

import math

import numpy as np
import pytest

from neoworld_mjx.compose.on_supports import in_contact, snap
from neoworld_mjx.spec import Box, Cylinder, Extrusion, SceneObject, SceneSpec
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


@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_a_move_onto_the_rim_is_refused(scale):
    composed = rack_and_peg((0.0005, 0.0))
    aligned = rack_and_peg((0.004, 0.0), scale)
    assert aligned.object("peg").z > composed.object("peg").z + 0.03  # it stands on the rim
    scene, notes = in_contact(aligned, composed=composed)
    peg = scene.object("peg")
    assert peg.z == pytest.approx(0.005 * scale, abs=1e-3)
    assert np.allclose(peg.xy, (0.0005 * scale, 0.0), atol=1e-6)
    assert math.isclose(peg.yaw, 0.0005)
    assert any("peg" in note and "off what it rests on" in note for note in notes)


def test_a_move_on_the_same_level_is_kept():
    composed, aligned = rack_and_peg(), rack_and_peg((0.0003, 0.0))
    scene, notes = in_contact(aligned, composed=composed)
    assert scene.object("peg").xy == (0.0003, 0.0)
    assert not notes


@pytest.mark.parametrize(("x", "kept"), [(0.12, True), (0.09, False), (-0.5, True)])
def test_a_move_past_the_end_of_what_carries_it_is_refused(x, kept):
    """Nothing is below it there, so that snapping keeps its height."""
    bed = scenes.single("bed", (Box(size=(0.2, 0.2, 0.1)), (0, 0, 0.05)))
    throw = scenes.single("throw", (Box(size=(0.03, 0.1, 0.01)), (0, 0, 0.005)))
    items = (
        SceneObject(name="table", spec=scenes.table(), environment=True, z=-0.04),
        SceneObject(name="bed", spec=bed, parent="table"),
        SceneObject(name="throw", spec=throw, parent="bed", xy=(0.05, 0.0)),
    )
    composed = snap(SceneSpec(objects=items))
    moved = composed.object("throw").model_copy(update={"xy": (x, 0.0)})
    aligned = composed.model_copy(update={"objects": (*composed.objects[:2], moved)})
    scene, notes = in_contact(aligned, composed=composed)
    assert scene.object("throw").xy == pytest.approx((0.05 if kept else x, 0.0))
    assert any("throw" in note and "off bed" in note for note in notes) is kept
