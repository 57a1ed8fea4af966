"""Masses and inertias of parts against textbook formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neoworld_mjx.spec import Box, ObjectSpec, inertial
from neoworld_mjx.spec.mass import inertia_about
from tests.support.mechanisms import WOOD, geom, joint, part

SIZE = np.array([0.1, 0.2, 0.4])


def tensor(found) -> np.ndarray:
    """Return the inertia about the center of mass along the object's axes [kg m^2]."""
    turn = Rotation.from_quat(found.quat, scalar_first=True).as_matrix()
    return turn @ np.diag(found.diagonal) @ turn.T


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, 3)])
def test_the_inertia_of_a_tilted_geom_is_turned_with_it(axis):
    turn = Rotation.from_rotvec(0.5 * np.array(axis) / np.linalg.norm(axis))
    quat = tuple(turn.as_quat(scalar_first=True).tolist())
    tilted = part("body", geom("box", Box(size=tuple(SIZE)), (0.3, -0.2, 0.5), quat=quat))
    found = inertial(ObjectSpec(name="o", materials=(WOOD,), parts=(tilted,)), tilted)
    mass = WOOD.density * SIZE.prod()
    moments = mass / 12 * (np.sum(SIZE**2) - SIZE**2)
    expected = turn.as_matrix() @ np.diag(moments) @ turn.as_matrix().T
    assert found.mass == pytest.approx(mass)
    assert found.pos == pytest.approx((0.3, -0.2, 0.5))
    np.testing.assert_allclose(tensor(found), expected, atol=1e-9 * mass)


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
