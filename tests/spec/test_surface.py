import itertools

import numpy as np
import pytest

from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    HollowBox,
    Lathe,
    Mesh,
    Prism,
    Sphere,
)
from neoworld_mjx.spec.convex import mass_properties
from neoworld_mjx.spec.triangles import corner_normals
from tests.support import sample_shapes

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
SHAPES = [
    Box(size=(0.1, 0.2, 0.3)),
    Sphere(radius=0.1),
    Capsule(radius=0.05, length=0.2),
    Cylinder(radius=0.05, height=0.2),
    Ellipsoid(radii=(0.1, 0.2, 0.05)),
    Prism(outline=((0, 0), (0, 0.1), (0.2, 0.05)), height=0.1),
    Lathe(profile=((0.1, 0), (0.02, 0.0), (0.05, 0.1), (0.03, 0.1), (0.02, 0.2), (0.01, 0.2))),
    Lathe(profile=((0, 0), (0.1, 0.1), (0, 0.3)), sectors=7),
    Lathe(profile=((0, 0), (0.03, 0), (0.04, 0.08)), thickness=0.003),
    Lathe(profile=((0.02, 0), (0.03, 0.01), (0.04, 0.08)), thickness=0.003, sectors=12),
    *(shape for shape in sample_shapes.SHAPES.values() if not isinstance(shape, Mesh)),
    *(
        HollowBox(size=(0.3, 0.2, 0.1), wall=0.01, open=open_)
        for n in range(4)
        for open_ in itertools.combinations(FACES, n)
    ),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.type)
def test_surfaces_are_closed_outward_and_of_the_right_volume(shape):
    vertices, faces = shape.surface()
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    codes = edges[:, 0] * len(vertices) + edges[:, 1]
    assert len(np.unique(codes)) == len(codes)
    assert set(codes) == set(edges[:, 1] * len(vertices) + edges[:, 0])
    assert set(faces.ravel()) == set(range(len(vertices)))
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0
    volume = np.sum(a * np.cross(b, c)) / 6
    solid = sum(mass_properties(piece)[0] for piece in shape.pieces())
    # Colliders of round shapes are coarser than what is seen, and both lie inside the true shape.
    exact = isinstance(shape, Box | Prism | HollowBox | Extrusion)
    assert volume == pytest.approx(solid, rel=1e-9 if exact else 0.2)


def test_normals_are_smooth_around_and_sharp_at_rims():
    vertices, faces = Cylinder(radius=0.05, height=0.2).surface()
    normals = corner_normals(vertices, faces)
    assert np.allclose(np.linalg.norm(normals, axis=2), 1)
    corners = vertices[faces]
    side = np.abs(np.ptp(corners[..., 2], axis=1)) > 0.1
    radial = corners[side] * [1, 1, 0] / 0.05
    # Within 1.5 degrees: a corner has one or two triangles of the next facet.
    assert np.sum(normals[side] * radial, axis=2).min() > np.cos(np.radians(1.5))
    assert np.allclose(np.abs(normals[~side]), [0, 0, 1], atol=1e-12)
