"""Volume and signed distance against sampled truth that is computed in another way."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from neoworld_mjx.spec.convex import mass_properties
from tests.support.sample_shapes import SHAPES

random = np.random.default_rng(3)


def skin(shape, count: int):
    """Points spread evenly over a shape's surface."""
    vertices, faces = shape.surface()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    pick = random.choice(len(faces), count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[pick] + u * (b - a)[pick] + v * (c - a)[pick]


def around(shape, count: int):
    vertices, _ = shape.surface()
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    grow = 0.3 * (high - low)
    return random.uniform(low - grow, high + grow, (count, 3))


def inside_pieces(shape, points):
    """Whether points lie in a collider, by half-spaces; nothing of `solid` is used."""
    from neoworld_mjx.spec.convex import planes, polytope
    from neoworld_mjx.spec.pose import pose
    from neoworld_mjx.spec.shapes import faceted

    result = np.zeros(len(points), bool)
    for piece in shape.pieces():
        flat = piece if piece.kind in ("box", "mesh") else polytope(faceted(piece, 48))
        local, half = pose(piece.pos, piece.quat).inverse().apply(points), planes(flat)
        result |= (local @ half[:, :3].T <= half[:, 3] + 1e-12).all(axis=1)
    return result


@pytest.mark.parametrize("name", SHAPES)
def test_distances_are_those_to_sampled_surfaces(name: str):
    shape = SHAPES[name]
    spots, points = skin(shape, 60_000), around(shape, 200)
    distance = shape.signed_distance(points)
    nearest, _ = cKDTree(spots).query(points)
    # Samples are some 1 mm apart, and facets lie inside what is round.
    assert np.abs(np.abs(distance) - nearest).max() < 0.0016
    clear = np.abs(distance) > 0.002
    assert np.array_equal((distance < 0)[clear], inside_pieces(shape, points)[clear])
    assert (distance < 0).any() and (distance > 0).any()


@pytest.mark.parametrize("name", SHAPES)
def test_volumes_equal_counted_random_points(name: str):
    shape, points = SHAPES[name], around(SHAPES[name], 500)
    vertices, _ = shape.surface()
    room = float(np.prod(1.6 * np.ptp(vertices, axis=0)))
    share = shape.volume() / room
    inside = np.mean(shape.signed_distance(points) < 0)
    assert inside == pytest.approx(share, abs=4 * np.sqrt(share / 500))
    solid = sum(mass_properties(piece)[0] for piece in shape.pieces())
    assert solid == pytest.approx(shape.volume(), rel=0.13)
