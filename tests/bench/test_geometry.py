"""Chamfer distance and F-score of surfaces."""

import math

import numpy as np
import pytest
from neoworld_bench.measures import geometry_measure
from neoworld_bench.measures.surface_measure import surface_points

from neoworld_mjx.spec import Box, GeomSpec, Material, ObjectSpec, PartSpec

STEEL = Material(name="steel", density=7800)


def thing(*geoms):
    return ObjectSpec(name="thing", materials=(STEEL,), parts=(PartSpec(name="body", geoms=geoms),))


def block(size, at=(0, 0, 0), name="block", **more):
    return GeomSpec(name=name, shape=Box(size=size), pos=at, material="steel", **more)


def turned(points, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def chair(at=(0, 0, 0)):
    """A lopsided thing, so that no turn is as good as another."""
    x, y, z = at
    return thing(
        block((0.4, 0.5, 0.05), (x, y, z + 0.4), "seat"),
        block((0.04, 0.5, 0.5), (x - 0.18, y, z + 0.65), "back"),
        block((0.05, 0.05, 0.4), (x + 0.1, y + 0.2, z + 0.2), "leg"),
    )


def test_fit_recovers_rotation_translation_and_scale():
    spec, turn, factor = chair(), -83, 0.6
    true = turned(surface_points(spec, 3000, seed=1), turn) * factor + [0.3, -0.2, 0.1]
    result = geometry_measure(spec, true, samples=3000)
    same = geometry_measure(spec, surface_points(spec, 3000, seed=1), samples=3000)
    assert result.turn_deg == pytest.approx(turn, abs=1)
    assert result.scale == pytest.approx(factor, rel=0.01)
    assert result.aligned.chamfer_x10 == pytest.approx(same.aligned.chamfer_x10, rel=0.1)
    assert result.unaligned.chamfer_x10 > 3 * result.aligned.chamfer_x10


def test_unaligned_chamfer_of_a_translated_box_is_its_translation():
    """A cube of edge 1 shifted by d along x; what every point of one is off the other,
    integrated.
    """
    d, count = 0.1, 20_000
    a = surface_points(thing(block((1, 1, 1))), count)
    result = geometry_measure(a, a + [d, 0, 0])
    outside = d  # of the face that stands out
    within = (1 - (1 - 2 * d) ** 3) / 6  # of the opposite one: d, or less near its edges
    strips = 4 * d * d / 2  # of four sides: the part of width d beyond the other cube
    expected = 10 * (outside + within + strips) / 6 / math.sqrt(3)
    # Four sides of six lie in each other: there the nearest sample is half a spacing away.
    noise = 10 * 4 / 6 * 0.5 * math.sqrt(6 / count) / math.sqrt(3)
    assert expected < result.unaligned.chamfer_x10 < expected + noise
    assert result.aligned.f_01 > 99
