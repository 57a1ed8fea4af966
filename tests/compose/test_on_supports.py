"""Objects stand on what is under them, and keep the level at which they were composed."""

import pytest

from neoworld_mjx.compose.on_supports import put_down, snap
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
