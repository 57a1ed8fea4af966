"""Masses and inertias of parts against textbook formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neoworld_mjx.spec import Box, ObjectSpec, inertial
from neoworld_mjx.spec.mass import LEAST_KG, LEAST_KG_M2, Inertial, inertia_about, inertia_fault
from neoworld_mjx.spec.object import AuthoredInertia
from neoworld_mjx.spec.pose import IDENTITY
from tests.support.mechanisms import STEEL, WOOD, geom, joint, part

SIZE = np.array([0.1, 0.2, 0.4])


def tensor(found) -> np.ndarray:
    """Return the inertia about the center of mass along the object's axes [kg m^2]."""
    turn = Rotation.from_quat(found.quat, scalar_first=True).as_matrix()
    return turn @ np.diag(found.diagonal) @ turn.T


@pytest.mark.parametrize("scale", [1.0, 0.01])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, 3)])
def test_the_inertia_of_a_tilted_geom_is_turned_with_it(axis, scale):
    size = scale * SIZE
    turn = Rotation.from_rotvec(0.5 * np.array(axis) / np.linalg.norm(axis))
    quat = tuple(turn.as_quat(scalar_first=True).tolist())
    tilted = part("body", geom("box", Box(size=tuple(size)), (0.3, -0.2, 0.5), quat=quat))
    found = inertial(ObjectSpec(name="o", materials=(WOOD,), parts=(tilted,)), tilted)
    mass = WOOD.density * size.prod()
    moments = mass / 12 * (np.sum(size**2) - size**2)
    expected = turn.as_matrix() @ np.diag(moments) @ turn.as_matrix().T
    assert found.mass == pytest.approx(mass)
    assert found.pos == pytest.approx((0.3, -0.2, 0.5))
    np.testing.assert_allclose(tensor(found), expected, atol=1e-9 * mass * scale**2)
    # Axes are unique: right-handed, and the largest components of the first two are positive.
    axes = Rotation.from_quat(found.quat, scalar_first=True).as_matrix()
    assert all(axes[np.abs(axes[:, k]).argmax(), k] > 0 for k in (0, 1))


def test_two_boxes_turn_about_their_common_center():
    one, other = (Box(size=tuple(SIZE)), (-0.3, 0.0, 0.0)), (Box(size=tuple(SIZE)), (0.1, 0.2, 0.0))
    pair = part("body", geom("one", *one), geom("other", *other))
    found = inertial(ObjectSpec(name="o", materials=(WOOD,), parts=(pair,)), pair)
    mass = WOOD.density * SIZE.prod()
    own = np.diag(mass / 12 * (np.sum(SIZE**2) - SIZE**2))
    d = np.array([0.2, 0.1, 0.0])  # of each box from the center of mass
    expected = 2 * (own + mass * (d @ d * np.eye(3) - np.outer(d, d)))
    assert found.pos == pytest.approx((-0.1, 0.1, 0.0))
    np.testing.assert_allclose(tensor(found), expected, rtol=1e-9, atol=1e-9 * mass)


def test_a_hinge_moves_the_inertia_about_its_axis():
    """The distance along the axis does not matter, the one from it does."""
    box = part("body", geom("box", Box(size=tuple(SIZE)), (0.3, -0.2, 0.5)))
    found = inertial(ObjectSpec(name="o", materials=(WOOD,), parts=(box,)), box)
    mass = WOOD.density * SIZE.prod()
    expected = mass * ((SIZE[0] ** 2 + SIZE[1] ** 2) / 12 + 0.1**2)
    hinge = joint("j", "continuous", "a", "body", pos=(0.2, -0.2, -1.0))
    assert inertia_about(hinge, found) == pytest.approx(expected)


def weighed(moments, *, products=(0.0, 0.0, 0.0), mass=2.0):
    """Return the mass properties of a part that states them."""
    stated = AuthoredInertia(pos=(0.1, 0.2, 0.3), moments=moments, products=products)
    body = part("body", geom("box", Box(size=tuple(SIZE))), mass=mass, inertia=stated)
    return body, inertial(ObjectSpec(name="o", materials=(WOOD,), parts=(body,)), body)


def test_a_stated_inertia_is_kept():
    turn = Rotation.from_rotvec((0.4, -0.3, 0.8)).as_matrix()
    expected = turn @ np.diag([0.01, 0.02, 0.025]) @ turn.T
    _, found = weighed(tuple(np.diag(expected)), products=tuple(expected[(0, 0, 1), (1, 2, 2)]))
    assert (found.mass, found.pos) == (2.0, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(tensor(found), expected, atol=1e-11)


def test_only_an_excess_by_rounding_is_removed_from_a_stated_moment():
    """MuJoCo rejects a moment above the sum of the others; they are 1 and 1."""
    for stated, moment in ((1.9, 1.9), (2.01, 2.0), (2.039, 2.0), (2.05, 2.05)):
        _, found = weighed((1.0, stated, 1.0))
        assert found.diagonal == pytest.approx((1.0, moment, 1.0), rel=1e-9)
        assert stated > 2.04 or found.diagonal[1] < 2.0


def test_a_stated_mass_scales_the_inertia_of_the_shapes():
    """Materials weigh the shapes against each other, on a scale of millimeters."""
    cube, d = (0.002, 0.002, 0.002), 0.01
    wood, steel = geom("wood", Box(size=cube)), geom("steel", Box(size=cube), (d, 0, 0), "steel")
    for stated in (None, 5.0):
        body = part("body", wood, steel, mass=stated)
        found = inertial(ObjectSpec(name="o", materials=(WOOD, STEEL), parts=(body,)), body)
        masses = np.array([WOOD.density, STEEL.density]) * np.prod(cube)
        masses *= 1.0 if stated is None else stated / masses.sum()
        assert found.mass == pytest.approx(masses.sum())
        assert found.pos == pytest.approx((d * masses[1] / masses.sum(), 0, 0))
        own = masses.sum() * 0.002**2 / 6
        reduced = masses.prod() / masses.sum() * d**2
        expected = np.diag([own, own + reduced, own + reduced])
        np.testing.assert_allclose(tensor(found), expected, rtol=1e-9, atol=1e-12 * own)


@pytest.mark.parametrize(
    ("moments", "possible"),
    [((0.1, 0.1, 0.2), True), ((0.1, 0.2, 0.1), True), ((0.1, 0.3, 0.1), False)],
)
def test_a_stated_inertia_that_no_body_has_is_a_fault(moments, possible):
    body, found = weighed(moments)
    fault = inertia_fault(body, found)
    assert fault is None if possible else "states an inertia that no body has" in (fault or "")
    # Derived moments are not judged.
    assert inertia_fault(body.model_copy(update={"inertia": None}), found) is None
    flat = found.model_copy(update={"diagonal": (0.1, 0.0, 0.1)})
    assert "no body has" in (inertia_fault(body, flat) or "")


@pytest.mark.parametrize(("mass", "moment"), [(1.0, 0.9), (0.9, 1.0)])
def test_a_part_is_too_light_by_its_mass_or_by_its_moments(mass, moment):
    body = part("body", geom("box", Box(size=tuple(SIZE))))
    least = LEAST_KG_M2
    exact = Inertial(mass=LEAST_KG, pos=(0, 0, 0), quat=IDENTITY, diagonal=(least, least, least))
    assert inertia_fault(body, exact) is None
    diagonal = (least, moment * least, least)
    light = exact.model_copy(update={"mass": mass * LEAST_KG, "diagonal": diagonal})
    assert "too little to be simulated" in (inertia_fault(body, light) or "")


def test_what_a_slide_and_a_ball_joint_move():
    child = Inertial(mass=2.0, pos=(0.3, 0, 0), quat=IDENTITY, diagonal=(0.1, 0.3, 0.2))
    assert inertia_about(joint("j", "prismatic", "a", "body", upper=1.0), child) == 2.0
    ball = joint("j", "ball", "a", "body", pos=(0.0, 0.4, 0.0))
    assert inertia_about(ball, child) == pytest.approx(0.3 + 2.0 * 0.5**2)
    # About an axis between two principal ones.
    hinge = joint("j", "revolute", "a", "body", pos=(0.3, 0, 0), axis=(0.6, 0.8, 0), upper=1.0)
    turned = child.model_copy(update={"quat": (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))})
    assert inertia_about(hinge, child) == pytest.approx(0.36 * 0.1 + 0.64 * 0.3)
    assert inertia_about(hinge, turned) == pytest.approx(0.36 * 0.3 + 0.64 * 0.1)
