"""Lofted solids: flattened bottles and pillows, with exact bounds, volume and colliders."""

import numpy as np
import pytest
import trimesh

from neoworld_mjx.checks.object_tests import run_object_tests
from neoworld_mjx.program.building import build
from neoworld_mjx.spec import bounds, pieces

HEAD = "from neoworld_mjx.program.sdk import Object, cylinder, loft\n"
BOTTLE = (
    HEAD
    + """
bottle = Object("shampoo")
body = bottle.part("body", material="polypropylene", mass=0.3)
outline = [
    (0, 0.05, 0.09), (0.01, 0.06, 0.10), (0.14, 0.06, 0.10), (0.17, 0.03, 0.03), (0.18, 0.03, 0.03)
]
body.add(loft(outline, square=3))
body.add(cylinder(0.016, 0.02), at=(0, 0, 0.18), by="bottom", material="plastic")
"""
)
PILLOW = (
    HEAD
    + """
pillow = Object("pillow")
body = pillow.part("body", material="foam")
low = [(0, 0.2, 0.3), (0.02, 0.36, 0.46), (0.05, 0.4, 0.5)]
body.add(loft([*low, (0.08, 0.36, 0.46), (0.1, 0.2, 0.3)], square=4))
"""
)


def built(text):
    result = build(text)
    assert result.ok, result.errors
    return result.spec


@pytest.mark.parametrize(
    ("text", "size", "most"), [(BOTTLE, (0.06, 0.10, 0.20), 4), (PILLOW, (0.4, 0.5, 0.1), 4)]
)
def test_lofts_have_their_size_few_pieces_and_pass_the_object_tests(text, size, most):
    spec = built(text)
    low, high = bounds(spec)
    assert high - low == pytest.approx(size, abs=1e-6)
    assert len(list(pieces(spec.parts[0]))) <= most
    verdict = run_object_tests(spec).verdict
    assert verdict.passed, [check.phrase() for check in verdict.checks if check.failed]


def test_a_loft_is_closed_and_its_colliders_have_its_volume():
    geom = built(PILLOW).parts[0].geoms[0]
    mesh = trimesh.Trimesh(*geom.shape.surface())
    assert mesh.is_watertight and mesh.volume > 0
    hulls = [trimesh.convex.convex_hull(np.array(hull)).volume for hull in geom.shape.hulls]
    assert sum(hulls) == pytest.approx(mesh.volume, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("[(0, 1, 1)]", "loft sections"),
        ("[(0, 1, 1), (0, 1, 1)]", "z must increase"),
        ("[(0, 1, 0), (1, 1, 1)]", "width along y"),
        ("[(0, 1, 1), (1, 1, 1)], square=0.5", "loft square must lie"),
    ],
)
def test_wrong_sections_are_refused(arguments, words):
    text = f'{HEAD}o = Object("o")\np = o.part("p", material="foam")\np.add(loft({arguments}))'
    assert words in build(text).errors
