"""Points on the surfaces of objects, at which penetration is measured."""

import numpy as np
import pytest

from neoworld_mjx.physics.sampling import surface_samples
from neoworld_mjx.spec import Box, Capsule, Cylinder, Ellipsoid, SceneObject, Sphere
from tests.support import scenes
from tests.support.mechanisms import single

LEVELS = {
    "box": (Box(size=(0.2, 0.1, 0.06)), lambda p: np.abs(p / [0.1, 0.05, 0.03]).max(axis=1)),
    "sphere": (Sphere(radius=0.05), lambda p: np.linalg.norm(p, axis=1) / 0.05),
    "ellipsoid": (
        Ellipsoid(radii=(0.05, 0.03, 0.02)),
        lambda p: np.linalg.norm(p / [0.05, 0.03, 0.02], axis=1),
    ),
    "cylinder": (
        Cylinder(radius=0.03, height=0.1),
        lambda p: np.maximum(np.hypot(p[:, 0], p[:, 1]) / 0.03, np.abs(p[:, 2]) / 0.05),
    ),
    "capsule": (
        Capsule(radius=0.03, length=0.1),
        lambda p: np.linalg.norm(p - np.clip(p, [0, 0, -0.05], [0, 0, 0.05]), axis=1) / 0.03,
    ),
}
"""Shapes, and functions that are 1 on their surfaces."""


@pytest.mark.parametrize("kind", LEVELS)
def test_points_lie_on_the_whole_surface(kind):
    shape, level = LEVELS[kind]
    item = SceneObject(name="one", spec=single("one", shape))
    points = surface_samples(item, 64)
    assert level(points) == pytest.approx(np.ones(64), abs=1e-3)
    assert len(np.unique(points.round(6), axis=0)) == 64
    # No place of the surface is far from a point.
    other = surface_samples(item, 400)
    gap = np.linalg.norm(other[:, None] - points, axis=2).min(axis=1)
    assert gap.max() < 0.8 * np.sqrt(np.prod(np.sort(np.ptp(other, axis=0))[1:]) / 8)


def test_points_keep_apart_from_each_other_and_from_those_at_edges():
    cube = SceneObject(name="one", spec=scenes.single("one", (Box(size=(0.1,) * 3), (0, 0, 0))))
    points = surface_samples(cube, 64)
    gaps = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(64)
    assert gaps.min() > 0.02  # 64 points in a square grid would be 0.03 apart.


def test_pieces_have_points_by_their_areas():
    thin = (Cylinder(radius=0.002, height=0.2), (0, 0, 0.2))
    board = (Box(size=(0.2, 0.2, 0.02)), (0, 0, 0))
    item = SceneObject(name="one", spec=scenes.single("one", thin, board))
    points = surface_samples(item, 200)
    on_board = points[:, 2] < points[:, 2].min() + 0.021
    assert on_board.mean() > 0.7
