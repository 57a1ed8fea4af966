"""Creases within objects, and what they say about the heading."""

import numpy as np
import pytest

from neoworld_mjx.align.colors import LabImage
from neoworld_mjx.align.creases import creases, smooth_faces
from neoworld_mjx.align.linear_evidence import contour_evidence
from neoworld_mjx.align.unknowns import CAMERA
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import Sphere
from tests.align import desk

WIDTH, MARGIN, YAW = 640, 3, CAMERA + 2


@pytest.mark.parametrize(
    ("spec", "faces"),
    [
        (desk.block("box", 0.1, 0.2, 0.3, "red"), 6),
        (desk.can("can", 0.05, 0.1, "red"), 3),
        (desk.colored("ball", Sphere(radius=0.05), "red"), 1),
    ],
)
def test_smooth_faces_end_at_sharp_edges(spec, faces):
    vertices, triangles = visible_surface(spec)
    face = smooth_faces(vertices, triangles)
    assert set(face) == set(range(faces)) and len(face) == len(triangles)


def test_a_surface_without_triangles_has_no_faces():
    assert smooth_faces(np.zeros((8, 3)), np.zeros((0, 3), int)).shape == (0,)


def tower(turn=0.0):
    """A box of which the camera sees three faces, turned from its heading [rad]."""
    return desk.on_desk((desk.block("tower", 0.1, 0.1, 0.16, "red"), (0.0, 0.0), 0.6 + turn, {}))


class View:
    """The evidence of a drawn tower in a photograph."""

    def __init__(self, scene, photo):
        self.unknowns = desk.unknowns_of(scene)
        x = np.zeros(self.unknowns.size)
        self.now, self.neighbors = self.unknowns.place(x[None])[0], self.unknowns.neighbors(x)
        self.drawn = self.unknowns.draw(self.now, WIDTH)
        self.image = LabImage.of(photo, WIDTH, WIDTH * 3 // 4)

    def creases(self):
        return list(creases(self.drawn, self.image.lab, 1, MARGIN))

    def evidence(self, with_creases):
        args = self.unknowns, self.now, self.neighbors, self.drawn, self.image, 1
        return contour_evidence(*args, reach=10.0, step=1.0, with_creases=with_creases)

    def heading_precision(self, with_creases):
        """Of the heading alone, with all other unknowns given [1/rad^2]."""
        evidence = self.evidence(with_creases)
        return evidence.weight @ evidence.jacobian[:, YAW] ** 2


@pytest.fixture(scope="module")
def photo():
    return desk.photograph(tower(), WIDTH)


def test_a_box_shows_three_creases_that_lie_within_it(photo):
    view = View(tower(), photo)
    found = view.creases()
    assert len(found) == 3
    inside = view.drawn.owner == 1
    for points, colors in found:
        column, row = points.pixel.astype(int).T
        assert inside[row, column].all()
        assert np.abs(colors.inside - colors.outside).max() > 1.0
        # A step from the first face along the normal arrives at the second one.
        ends = [
            view.drawn.face[tuple((points.pixel + s * points.normal).astype(int).T[::-1])]
            for s in (-2.0, 2.0)
        ]
        assert np.mean(ends[0] < ends[1]) > 0.9


@pytest.mark.parametrize("turn", [-0.03, 0.03])
def test_a_turned_tower_s_creases_say_by_how_much(photo, turn):
    view = View(tower(turn), photo)
    outline, both = (view.evidence(with_creases) for with_creases in (False, True))
    added = slice(len(outline.residual), None)
    jacobian, residual = both.jacobian[added, YAW], both.residual[added]
    weight = both.weight[added]
    assert np.array_equal(both.residual[: len(outline.residual)], outline.residual)
    estimate = (weight * jacobian) @ residual / ((weight * jacobian) @ jacobian)
    assert estimate == pytest.approx(-turn, abs=0.004)


def test_creases_make_the_heading_more_certain(photo):
    view = View(tower(), photo)
    assert view.heading_precision(True) > 1.2 * view.heading_precision(False)


def test_faces_of_one_color_say_nothing(photo):
    """The tower as a flat red shape: its outline is as before, its creases are not seen."""
    flat = photo.copy()
    flat[View(tower(), photo).drawn.owner == 1] = (190, 30, 30)
    view = View(tower(), flat)
    assert view.heading_precision(True) == pytest.approx(view.heading_precision(False), rel=1e-6)


def test_drawn_objects_without_faces_have_no_creases(photo):
    view = View(tower(), photo)
    assert not list(creases(view.drawn._replace(face=None), view.image.lab, 1, MARGIN))
