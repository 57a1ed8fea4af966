"""Patterns of surfaces: what they draw, on which face, and how they fade with distance."""

import numpy as np
import pytest

from neoworld_mjx.render.surface_patterns import patterned
from neoworld_mjx.spec import SurfacePattern
from neoworld_mjx.spec.room import PATTERN_KINDS

COLOUR, SECOND = np.array([0.6, 0.5, 0.4]), np.array([0.05, 0.1, 0.6])
UP, FRONT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def drawn(kind, points, normal=UP, pixel=1e-5, **more):
    pattern = SurfacePattern(kind=kind, **more)
    n = len(points)
    normals, pixels = np.tile(normal, (n, 1)), np.full(n, pixel)
    return patterned(pattern, COLOUR, SECOND, np.asarray(points, float), normals, pixels)


def line(axis, low, high, count=4001, at=(0.013, 0.017, 0.0)):
    points = np.tile(np.array(at), (count, 1))
    points[:, axis] = np.linspace(low, high, count)
    return points


@pytest.mark.parametrize("kind", [k for k in PATTERN_KINDS if k not in ("plain", "grain")])
def test_a_pattern_shows_both_colors(kind):
    spread = np.random.default_rng(0).uniform(-1, 1, (4000, 3)) * [1, 1, 0]
    colours = drawn(kind, spread)
    blue = colours[:, 2] / colours.sum(axis=1)
    first, second = (c[2] / c.sum() for c in (COLOUR, SECOND))
    assert blue.min() == pytest.approx(first, abs=1e-6)
    assert blue.max() > (first + 2 * second) / 3
    assert np.isfinite(colours).all() and (colours >= 0).all()
    again = drawn(kind, spread)
    assert np.array_equal(colours, again)


@pytest.mark.parametrize(
    ("along", "normal", "across"), [("x", UP, 1), ("y", UP, 0), ("x", FRONT, 2), ("y", FRONT, 1)]
)
def test_boards_have_a_joint_every_step_across_them(along, normal, across):
    points = line(across, -0.449, 0.449, at=(0.31, 0.27, 0.24))
    joint = drawn("boards", points, normal, along=along, step=0.1)[:, 2] > 0.5
    begins = np.flatnonzero(joint[1:] & ~joint[:-1])
    assert len(begins) == 9
    gaps = np.diff(points[begins, across])
    assert gaps == pytest.approx(np.full(8, 0.1), abs=1e-3)


def test_a_pattern_finer_than_a_pixel_is_its_mean():
    points = np.random.default_rng(1).uniform(-1, 1, (2000, 3)) * [1, 1, 0]
    near, far = (drawn("weave", points, pixel=pixel, step=0.01) for pixel in (1e-5, 0.02))
    assert far.std(axis=0).max() < 1e-9 < near.std(axis=0).max()
    assert far[0] == pytest.approx(near.mean(axis=0), rel=0.05)
