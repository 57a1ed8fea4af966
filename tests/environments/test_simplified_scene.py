"""Coarse colliders: what they contain, how far they exceed the exact ones, and what stays."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from neoworld_mjx.environments.simplified_scene import with_coarse_colliders
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Box, ObjectSpec, SceneObject, SceneSpec, inertial
from tests.support.mechanisms import STEEL, WOOD, geom, part

STEPS = 12
RISE = 0.01
"""Height of each step of the stairs [m]."""


def stairs(materials=("wood",), rise=RISE):
    """Stairs of boxes, painted by a shape that is only seen; the last box is not seen."""
    boxes = [
        geom(
            f"step{k}",
            Box(size=(0.02, 0.1, (k + 1) * rise)),
            (0.02 * k, 0.0, (k + 1) * rise / 2),
            materials[k % len(materials)],
            role="collision" if k == STEPS - 1 else "both",
        )
        for k in range(STEPS)
    ]
    paint = geom("paint", Box(size=(0.3, 0.2, 0.001)), (0.1, 0.0, 0.2), role="visual")
    return ObjectSpec(name="stairs", materials=(WOOD, STEEL), parts=(part("body", *boxes, paint),))


def coarse(spec):
    scene, errors = with_coarse_colliders(SceneSpec(objects=(SceneObject(name="o", spec=spec),)))
    return scene.object("o").spec, errors


def test_hulls_contain_their_pieces_and_the_rest_stays():
    exact = stairs()
    spec, errors = coarse(exact)
    (body,) = spec.parts
    hulls = [g for g in body.geoms if g.role == "collision"]
    assert len(hulls) == 8 and {g.material for g in hulls} == {"wood"}
    assert not [g for g in body.geoms if g.role == "both"]
    assert len({g.name for g in body.geoms}) == len(body.geoms)
    # The same surface is seen, without the box that only collides.
    for one, other in zip(visible_surface(exact, {}), visible_surface(spec, {}), strict=True):
        np.testing.assert_array_equal(one, other)
    sides = [ConvexHull(g.pose().apply(np.array(g.shape.vertices))) for g in hulls]
    volume = sum(hull.volume for hull in sides)
    for g in exact.parts[0].geoms[:STEPS]:
        corners = g.pose().apply(
            np.array(g.shape.size)
            / 2
            * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        )
        inside = [(corners @ h.equations[:, :3].T + h.equations[:, 3]).max() < 1e-6 for h in sides]
        assert any(inside), g.name
    # Two neighboring steps become one with a slope: half a step of 2 cm is filled.
    whole = sum(np.prod(g.shape.size) for g in exact.parts[0].geoms[:STEPS])
    assert volume == pytest.approx(whole + 4 * RISE * 0.02 / 2 * 0.1, rel=1e-6)
    # The slope is farthest from the corner between them.
    corner = RISE * 0.02 / np.hypot(RISE, 0.02)
    assert 0 < errors["o"] <= corner + 1e-6
    before, after = (inertial(s, s.parts[0]) for s in (exact, spec))
    assert after.mass == pytest.approx(before.mass) and after.pos == pytest.approx(before.pos)
    assert after.diagonal == pytest.approx(before.diagonal)


def test_pieces_of_different_materials_are_not_joined():
    alternating, errors = coarse(stairs(("wood", "steel")))
    of = {g.material for g in alternating.parts[0].geoms if g.role == "collision"}
    assert of == {"wood", "steel"}
    assert errors["o"] < 0.02


def test_hulls_that_would_close_a_cavity_are_not_made():
    """Steps of 20 cm would be filled by more than 2 cm; these stairs do not change."""
    steep = stairs(rise=0.2)
    wide = [
        g.model_copy(update={"pos": (0.2 * k, *g.pos[1:])})
        for k, g in enumerate(steep.parts[0].geoms)
    ]
    apart = steep.model_copy(
        update={"parts": (steep.parts[0].model_copy(update={"geoms": tuple(wide)}),)}
    )
    spec, errors = coarse(apart)
    assert spec == apart and errors == {}
    few = steep.parts[0].model_copy(update={"geoms": steep.parts[0].geoms[:8]})
    small = steep.model_copy(update={"parts": (few,)})
    assert coarse(small) == (small, {})
