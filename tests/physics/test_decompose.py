"""Convex decomposition of meshes that are more detailed than their collider needs to be."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from shapely import Polygon

from neoworld_mjx.cache import VARIABLE
from neoworld_mjx.config import FileOptions
from neoworld_mjx.io import bounded_by
from neoworld_mjx.physics.decompose import Budget, _coacd, coacd_installed, convex_pieces, outward

pytestmark = pytest.mark.skipif(not coacd_installed(), reason="CoACD is not installed")


def _without(mesh: trimesh.Trimesh, *faces: int) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, np.delete(mesh.faces, faces, axis=0), process=False)


def test_an_open_mesh_is_split_into_its_components():
    """CoACD wraps an open mesh as a whole: a shelf of boxes became blocks of 16 pieces."""
    boards = []
    for extents, at in [((0.3, 0.02, 1), (0, -0.4, 0.5)), ((0.3, 0.02, 1), (0, 0.4, 0.5))] + [
        ((0.3, 0.78, 0.02), (0, 0, z)) for z in (0.0, 0.5, 1.0)
    ]:
        board = trimesh.creation.box(extents).subdivide().subdivide().subdivide()
        boards.append(_without(board.apply_translation(at), 7))
    shelf = trimesh.util.concatenate(boards)
    assert not shelf.is_watertight
    pieces = _coacd(Path("shelf"), np.asarray(shelf.vertices), np.asarray(shelf.faces))
    assert len(pieces) == 5
    volume = sum(ConvexHull(piece).volume for piece in pieces)
    assert volume == pytest.approx(2 * 0.3 * 0.02 + 3 * 0.3 * 0.78 * 0.02, rel=1e-6)


def bracket() -> trimesh.Trimesh:
    return trimesh.creation.extrude_polygon(
        Polygon([(0, 0), (0.3, 0), (0.3, 0.1), (0.1, 0.1), (0.1, 0.3), (0, 0.3)]), 0.1
    )


def shell() -> trimesh.Trimesh:
    """Return a closed box with a closed cavity."""
    cavity = trimesh.creation.box((0.2, 0.2, 0.2))
    cavity.invert()
    return trimesh.util.concatenate([trimesh.creation.box((0.3, 0.3, 0.3)), cavity])


@pytest.mark.parametrize("solid", [bracket(), shell(), trimesh.creation.torus(0.2, 0.05, 16, 8)])
@pytest.mark.parametrize("wrong", ["all", "half", "two"])
def test_closed_meshes_that_face_inwards_are_turned(solid, wrong):
    chosen = {"all": slice(None), "half": slice(None, None, 2), "two": slice(0, 2)}[wrong]
    faces = np.array(solid.faces)
    faces[chosen] = faces[chosen, ::-1]
    turned = trimesh.Trimesh(solid.vertices, outward(solid.vertices, faces), process=False)
    assert turned.volume == pytest.approx(solid.volume)
    assert np.array_equal(outward(solid.vertices, solid.faces), solid.faces)


def test_a_mesh_leaves_time_to_the_others():
    with bounded_by(FileOptions(decompose_s=120.0)):
        for meshes, first_s in ((1, 120), (2, 60), (30, 30)):
            budget = Budget.of(meshes)
            with budget.share() as share_s:
                assert share_s == first_s
            # It needed no time.
            assert budget.meshes == meshes - 1 and budget.left_s == pytest.approx(120, abs=1)


def test_an_inverted_mesh_has_the_pieces_of_the_mesh(tmp_path, monkeypatch):
    """CoACD does not end on a mesh whose triangles face inwards, unless it wraps the mesh."""
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    mesh = bracket()
    mesh.invert()
    with bounded_by(FileOptions(decompose_s=30.0)):
        pieces, method = convex_pieces(mesh.vertices, outward(mesh.vertices, mesh.faces))
    assert method == "2 convex pieces by CoACD"
    assert sum(ConvexHull(piece).volume for piece in pieces) == pytest.approx(0.005, rel=1e-3)
    # The next time, they are read; another mesh cannot be decomposed in this time.
    again, method = convex_pieces(mesh.vertices, outward(mesh.vertices, mesh.faces), 1e-3)
    assert method == "2 convex pieces by CoACD"
    for piece, other in zip(again, pieces, strict=True):
        np.testing.assert_array_equal(piece, other)
    hull, method = convex_pieces(2 * mesh.vertices, outward(mesh.vertices, mesh.faces), 1e-3)
    assert len(hull) == 1 and "its convex hull, as CoACD fails" in (method or "")
