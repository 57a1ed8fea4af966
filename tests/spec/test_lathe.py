"""Bands of a lathe that are one collider, and how far from the true solid that brings it."""

import numpy as np
import pytest
import shapely

from neoworld_mjx.spec import Lathe
from neoworld_mjx.spec.convex import planes

ANGLE = np.linspace(0, np.pi / 2, 17)
BOWL = Lathe(
    profile=((0, 0), *zip(0.03 + 0.05 * np.sin(ANGLE), 0.05 - 0.05 * np.cos(ANGLE), strict=True)),
    thickness=0.004,
    sectors=16,
)


def farthest(shape: Lathe) -> float:
    """How far outside the true solid points of the colliders lie at most."""
    random = np.random.default_rng(1)
    points = [np.zeros((0, 3))]
    for piece in shape.pieces():
        corners = np.array(piece.vertices)
        points.append(random.dirichlet(np.full(len(corners), 0.2), 500) @ corners)
    x, y, z = np.vstack(points).T
    section, flat = shape.section(), np.column_stack([np.hypot(x, y), z])
    inside = shapely.contains_xy(shapely.Polygon(section), flat)
    # The edge along the axis closes the section but is not part of the surface.
    distance = shapely.distance(shapely.points(flat), shapely.LineString(section))
    return float(np.where(inside, -distance, distance).max())


def test_a_solid_that_bulges_outwards_is_one_piece():
    profile = tuple((0.05 * np.sin(a), -0.05 * np.cos(a)) for a in np.linspace(0, np.pi, 6))
    ball = Lathe(profile=profile, sectors=12)
    (piece,) = ball.pieces()
    low, high = np.array(piece.vertices).min(axis=0), np.array(piece.vertices).max(axis=0)
    assert high[2] - low[2] == pytest.approx(0.1)
    assert farthest(ball) < 1e-9


def test_pieces_fit_the_facets_of_a_bucket():
    ball = Lathe(profile=tuple((0.05 * np.sin(a), -0.05 * np.cos(a)) for a in 2 * ANGLE))
    assert 1 < len(ball.pieces()) < len(ball.profile) - 1
    assert max(len(planes(piece)) for piece in (*ball.pieces(), *BOWL.pieces())) <= 64
    assert farthest(ball) < 1e-9


def test_a_waist_is_not_filled():
    glass = Lathe(profile=((0.03, 0), (0.005, 0.04), (0.03, 0.08)))
    assert len(glass.pieces()) == 2
    assert farthest(glass) < 1e-9


def test_a_scaled_lathe_has_the_same_pieces():
    for factor in (0.37, 1.9):
        profile = tuple((factor * r, factor * z) for r, z in BOWL.profile)
        copy = Lathe(profile=profile, thickness=factor * BOWL.thickness, sectors=BOWL.sectors)
        assert len(copy.pieces()) == len(BOWL.pieces())
        for a, b in zip(copy.pieces(), BOWL.pieces(), strict=True):
            corners, expected = np.array(a.vertices), factor * np.array(b.vertices)
            assert corners.min(axis=0) == pytest.approx(expected.min(axis=0))
            assert corners.max(axis=0) == pytest.approx(expected.max(axis=0))
