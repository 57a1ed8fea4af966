"""Evidence of 2D boxes and contours, and its combination with the prior."""

import numpy as np
import pytest

from neoworld_mjx.estimate.image.colors import LabImage
from neoworld_mjx.estimate.prior import camera_deviations, prior_precision
from neoworld_mjx.estimate.rows.boxes import BOX, BOX_PX, box_evidence
from neoworld_mjx.estimate.rows.contours import CONTOUR_PX, OBSERVATIONS, contour_evidence
from neoworld_mjx.estimate.rows.linear import LinearEvidence
from neoworld_mjx.estimate.solve import NormalEquations
from neoworld_mjx.estimate.unknowns import CAMERA
from neoworld_mjx.render.rasterize import draw_objects
from tests.estimate import desk

WIDTH = 640


class Linearized:
    """A scene at some values of its unknowns, drawn."""

    def __init__(self, scene, x=None):
        self.unknowns = u = desk.unknowns_of(scene)
        self.x = np.zeros(u.size) if x is None else x
        self.now, self.neighbors = u.place(self.x[None])[0], u.neighbors(self.x)
        meshes = [u.mesh(self.now, k) for k in range(len(scene.objects))]
        self.drawn = draw_objects(meshes, self.now.camera, WIDTH)

    def box(self, k):
        box = self.unknowns.scene.objects[k].box2d
        return box_evidence(self.unknowns, self.now, self.neighbors, self.drawn, k, box)

    def contour(self, k, image):
        args = self.unknowns, self.now, self.neighbors, self.drawn, image, k
        return contour_evidence(*args, reach=10.0, step=1.0)

    def prior(self):
        deviations = camera_deviations((), {}, misjudged=False)
        return prior_precision(self.unknowns, self.now, self.x, deviations)

    def equations(self, mean=0.0, **more):
        mean = np.full_like(self.x, mean)
        return NormalEquations(self.unknowns, self.prior(), self.x, mean=mean, **more)


@pytest.fixture(scope="module")
def five():
    return desk.boxed(desk.five())


@pytest.fixture(scope="module")
def image(five):
    return LabImage.of(desk.photograph(five, WIDTH), WIDTH, WIDTH * 3 // 4)


def test_boxes_of_whole_objects_have_four_sides_that_agree(five):
    right = Linearized(five)
    for k in range(1, 6):
        evidence = right.box(k)
        assert evidence.residual.shape == (4,)
        assert np.abs(evidence.residual).max() < 1.0
        x0, y0, x1, y1 = five.objects[k].box2d.as_tuple()
        edges = np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0])
        assert evidence.weight == pytest.approx((BOX_PX + BOX * edges) ** -2, rel=0.02)


def test_the_residual_of_a_box_is_the_displacement(five):
    right = Linearized(five)
    for u in (0, 3, right.unknowns.columns(5).start, right.unknowns.columns(5).start + 3):
        x = np.zeros(right.unknowns.size)
        x[u] = 0.01
        wrong = Linearized(five, x)
        change = wrong.box(5).residual - right.box(5).residual
        expected = -x @ wrong.box(5).jacobian[:, : len(x)].T
        assert change == pytest.approx(expected, abs=0.2)
        assert np.abs(change).max() > 0.6


def test_a_contour_says_where_its_object_is(five, image):
    right = Linearized(five)
    x = np.zeros(right.unknowns.size)
    own = right.unknowns.columns(3)
    x[own] = (0.0, 0.006, 0.0, 0.0)
    wrong = Linearized(five, x)
    evidence = wrong.contour(3, image)
    # Least squares in the unknowns of its own place.
    jacobian = evidence.jacobian[:, own][:, :2] * np.sqrt(evidence.weight)[:, None]
    found = np.linalg.lstsq(jacobian, evidence.residual * np.sqrt(evidence.weight), rcond=None)[0]
    assert found == pytest.approx((0.0, -0.006), abs=0.0025)
    # A contour counts as a limited number of observations.
    assert 0.5 < evidence.weight.sum() < OBSERVATIONS / CONTOUR_PX**2
    other = [u for u in range(CAMERA, right.unknowns.size) if not own.start <= u < own.stop]
    assert not evidence.jacobian[:, other].any()


def test_evidence_adds_information_where_it_is(five, image):
    x = np.zeros(desk.unknowns_of(five).size)
    x[CAMERA:] = 0.004
    here = Linearized(five, x)
    whole, part = here.equations(), here.equations()
    prior = here.equations()
    for k in range(1, 6):
        for equations in (whole, part):
            equations.add("box", k, here.box(k))
        whole.add("contour", k, here.contour(k, image))
        if k not in (2, 4):
            part.add("contour", k, here.contour(k, image))
    assert whole.shown["contour"] == {1, 2, 3, 4, 5} and part.shown["contour"] == {1, 3, 5}
    assert whole.shown["box"] == set(range(1, 6)) and not prior.shown["box"]
    assert np.abs(whole.solved() - part.solved()).max() > 1e-5
    # Evidence only adds information; without any, the prior's mean is the composed scene.
    spread = [np.diag(e.covariance()) for e in (whole, part, prior)]
    assert (spread[0] <= spread[1] * (1 + 1e-9)).all() and (spread[1] <= spread[2]).all()
    two = here.unknowns.columns(2)
    assert spread[0][two][1] < 0.3 * spread[1][two][1]
    assert prior.solved() == pytest.approx(0.0, abs=1e-12)
    assert here.equations(mean=0.002).solved() == pytest.approx(0.002, abs=1e-12)


def test_an_unknown_offset_of_the_rows_widens_the_covariance(five):
    """Rows with a common unknown offset tell only of the differences from their mean."""
    here, count = Linearized(five), desk.unknowns_of(five).size
    box = here.box(3)
    jacobian, one = box.jacobian.copy(), np.ones((4, 1))
    jacobian[:, count:] = 0.0  # none of stretches
    equations = here.equations(global_count=1)
    equations.add("depth", 3, LinearEvidence(jacobian, box.residual, box.weight, one))
    weight = np.diag(box.weight)
    weight = weight - weight @ one @ one.T @ weight / box.weight.sum()
    rows = jacobian[:, :count]
    expected = np.linalg.inv(here.prior()[:count, :count] + rows.T @ weight @ rows)
    np.testing.assert_allclose(equations.covariance(), expected, rtol=1e-3, atol=1e-9)
