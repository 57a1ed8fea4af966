"""Volume and signed distance against sampled truth that is computed in another way."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from neoworld_mjx.spec import (
    CSG,
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    HollowBox,
    Lathe,
    Placed,
    Prism,
    RoundedBox,
    Sphere,
    Sweep,
    signed_distance,
    volume,
)
from neoworld_mjx.spec.convex import mass_properties
from neoworld_mjx.spec.solid import _mesh
from neoworld_mjx.spec.surface import surface

PATH = ((0, 0, 0), (0, 0, 0.05), (0.02, 0, 0.08), (0.05, 0, 0.08))
SHAPES = {
    "box": Box(size=(0.1, 0.2, 0.15)),
    "rounded_box": RoundedBox(size=(0.1, 0.2, 0.15), radius=0.02),
    "sphere": Sphere(radius=0.1),
    "capsule": Capsule(radius=0.05, length=0.1),
    "cylinder": Cylinder(radius=0.05, height=0.1),
    "ellipsoid": Ellipsoid(radii=(0.1, 0.06, 0.08)),
    "disc": Ellipsoid(radii=(0.1, 0.1, 0.03)),
    "prism": Prism(outline=((0, 0), (0.1, 0), (0.05, 0.1)), height=0.06),
    "extrusion": Extrusion(
        outline=((0, 0), (0.2, 0), (0.2, 0.05), (0.05, 0.05), (0.05, 0.2), (0, 0.2)), height=0.05
    ),
    "panel": Extrusion(
        outline=((0, 0), (0.2, 0), (0.2, 0.2), (0, 0.2)),
        holes=(((0.05, 0.05), (0.1, 0.05), (0.1, 0.15), (0.05, 0.15)),),
        height=0.02,
    ),
    "hollow_box": HollowBox(size=(0.1, 0.2, 0.15), wall=0.02, open=("+z", "+x")),
    "frustum": Lathe(profile=((0.05, 0), (0.02, 0.08))),
    "vase": Lathe(profile=((0.03, 0), (0.05, 0.04), (0.02, 0.1))),
    "cup": Lathe(profile=((0, 0), (0.03, 0), (0.04, 0.08)), thickness=0.004),
    "tube": Lathe(profile=((0.05, -0.05), (0.05, 0.05)), thickness=0.01),
    "oval": Lathe(profile=((0, 0), (0.03, 0), (0.04, 0.08)), thickness=0.006, oval=0.7),
    "sweep": Sweep(path=PATH, width=(0.02,), thickness=(0.015,)),
    "torus": Sweep(
        path=tuple((0.05 * np.cos(a), 0.05 * np.sin(a), 0.0) for a in np.arange(24) * np.pi / 12),
        width=(0.02,),
        thickness=(0.02,),
        closed=True,
    ),
    "csg": CSG(
        operation="difference",
        operands=(
            Placed(shape=Box(size=(0.2, 0.15, 0.1))),
            Placed(shape=Box(size=(0.16, 0.11, 0.1)), pos=(0, 0, 0.02)),
            Placed(shape=Cylinder(radius=0.02, height=0.3), quat=(1, 1, 0, 0)),
        ),
    ),
}  # fmt: skip
random = np.random.default_rng(3)


def skin(shape, count: int):
    """Points spread evenly over a shape's surface."""
    vertices, faces = surface(shape)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    pick = random.choice(len(faces), count, p=area / area.sum())
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[pick] + u * (b - a)[pick] + v * (c - a)[pick]


def around(shape, count: int):
    vertices, _ = surface(shape)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    grow = 0.3 * (high - low)
    return random.uniform(low - grow, high + grow, (count, 3))


def inside_pieces(shape, points):
    """Whether points lie in a collider, by half-spaces; nothing of `solid` is used."""
    from neoworld_mjx.spec.clip import poly
    from neoworld_mjx.spec.convex import polytope
    from neoworld_mjx.spec.csg import faceted
    from neoworld_mjx.spec.pose import pose

    found = np.zeros(len(points), bool)
    for piece in shape.pieces():
        flat = piece if piece.kind in ("box", "mesh") else polytope(faceted(piece, 48))
        half = poly(flat, pose(piece.pos, piece.quat))[1]
        found |= (points @ half[:, :3].T <= half[:, 3] + 1e-12).all(axis=1)
    return found


@pytest.mark.parametrize("name", SHAPES)
def test_distances_are_those_to_sampled_surfaces(name: str):
    shape = SHAPES[name]
    spots, points = skin(shape, 60_000), around(shape, 300)
    distance = signed_distance(shape, points)
    nearest, _ = cKDTree(spots).query(points)
    # Samples are some 1 mm apart, and facets lie inside what is round.
    assert np.abs(np.abs(distance) - nearest).max() < 0.0016
    clear = np.abs(distance) > 0.002
    assert np.array_equal((distance < 0)[clear], inside_pieces(shape, points)[clear])
    assert (distance < 0).any() and (distance > 0).any()


@pytest.mark.parametrize("name", SHAPES)
def test_the_surface_is_at_distance_zero(name: str):
    shape = SHAPES[name]
    vertices, _ = surface(shape)
    assert np.abs(signed_distance(shape, vertices[:200])).max() < 1e-7


@pytest.mark.parametrize("name", ["box", "prism", "extrusion", "panel"])
def test_exact_and_by_triangles_agree(name: str):
    shape, points = SHAPES[name], around(SHAPES[name], 500)
    assert np.allclose(signed_distance(shape, points), _mesh(shape, points), atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_volumes_by_counting(name: str):
    shape, points = SHAPES[name], around(SHAPES[name], 2000)
    vertices, _ = surface(shape)
    room = float(np.prod(1.6 * np.ptp(vertices, axis=0)))
    share = volume(shape) / room
    inside = np.mean(signed_distance(shape, points) < 0)
    assert inside == pytest.approx(share, abs=4 * np.sqrt(share / 2000))
    solid = sum(mass_properties(piece)[0] for piece in shape.pieces())
    assert solid == pytest.approx(volume(shape), rel=0.13)


@pytest.mark.parametrize("name", SHAPES)
def test_distance_and_volume_scale(name: str):
    shape, points = SHAPES[name], around(SHAPES[name], 50)
    big = shape.scaled(2.5)
    assert np.allclose(signed_distance(big, 2.5 * points), 2.5 * signed_distance(shape, points))
    assert volume(big) == pytest.approx(2.5**3 * volume(shape))
