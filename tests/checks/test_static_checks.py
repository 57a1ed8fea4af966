"""Static checks with values computed by hand, and distances to pieces and of lines to boxes."""

import mujoco
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from neoworld_mjx.checks.static_checks import (
    check_statics,
    distance_outside,
    line_box_distance,
    visible_points,
)
from neoworld_mjx.checks.verdict import Fault
from neoworld_mjx.spec import Box, ObjectSpec
from neoworld_mjx.spec.convex import Piece, prism
from neoworld_mjx.spec.object import AuthoredInertia
from neoworld_mjx.spec.pose import IDENTITY, pose
from tests.support.mechanisms import STEEL, TURNED, WOOD, geom, part

SIZE = (0.1, 0.2, 0.4)
KINDS = {
    "box": Piece("box", (0.1, 0.2, 0.3)),
    "mesh": prism(np.array([[0.1, 0.2], [-0.1, 0.2], [-0.1, -0.2], [0.1, -0.2]]), 0.6),
    "sphere": Piece("sphere", (0.15,)),
    "capsule": Piece("capsule", (0.1, 0.2)),
    "cylinder": Piece("cylinder", (0.1, 0.2)),
    "ellipsoid": Piece("ellipsoid", (0.1, 0.2, 0.3)),
}
HALF = {"sphere": (0.15, 0.15, 0.15), "capsule": (0.1, 0.1, 0.3), "cylinder": (0.1, 0.1, 0.2)}
"""Half of the extent along each axis [m]; 0.1, 0.2 and 0.3 for the other kinds."""


def spec_of(*parts, material=WOOD):
    return ObjectSpec(name="o", materials=(material,), parts=parts)


def checks_of(*parts, material=WOOD):
    return {check.name: check for check in check_statics(spec_of(*parts, material=material))}


@pytest.mark.parametrize("kind", KINDS)
def test_along_the_axes_the_distance_to_a_piece_is_that_to_its_surface(kind):
    place = pose((0.3, -0.2, 0.5), np.array(TURNED) / np.linalg.norm(TURNED))
    half = np.array(HALF.get(kind, (0.1, 0.2, 0.3)))
    for sign in (1.0, -1.0):
        for gap in (-0.02, 0.07):
            points = place.apply(sign * np.diag(half + gap))
            # Away from its shortest axis, the distance to an ellipsoid is only bounded.
            expected = gap * 0.1 / half if kind == "ellipsoid" else np.full(3, gap)
            found = distance_outside(points, [(KINDS[kind], place)])
            assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_never_exceeds_the_exact_distance(kind):
    """MuJoCo's distance of a tiny ball from the geom."""
    piece, spec = KINDS[kind], mujoco.MjSpec()
    kinds = mujoco.mjtGeom
    more = {} if piece.kind == "mesh" else {"size": [*piece.size, 0, 0][:3]}
    name = "box" if kind == "mesh" else kind
    if piece.kind == "mesh":
        more = {"size": (0.1, 0.2, 0.3)}
    spec.worldbody.add_geom(type=getattr(kinds, f"mjGEOM_{name.upper()}"), **more)
    ball = spec.worldbody.add_body(mass=1.0, inertia=[1.0] * 3, explicitinertial=True)
    ball.add_geom(type=kinds.mjGEOM_SPHERE, size=[1e-6, 0, 0])
    ball.add_freejoint()
    model = spec.compile()
    data, points = mujoco.MjData(model), np.random.default_rng(0).uniform(-0.3, 0.3, (200, 3))
    found = distance_outside(points, [(piece, pose())])
    exact = np.empty(len(points))
    for k, point in enumerate(points):
        data.qpos[:3] = point
        mujoco.mj_kinematics(model, data)
        exact[k] = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None)
    outside = exact > 0
    assert 100 < outside.sum() < 195
    np.testing.assert_array_equal(found > 0, outside)
    assert (found[outside] < exact[outside] + 1e-4).all()
    if kind in ("sphere", "capsule"):
        np.testing.assert_allclose(found[outside], exact[outside], atol=1e-4)


def test_of_several_pieces_the_nearest_counts():
    ball = Piece("sphere", (0.1,))
    solids = [(ball, pose((x, 0.0, 0.0), IDENTITY)) for x in (0.0, 1.0)]
    points = np.array([[0.3, 0.0, 0.0], [0.8, 0.0, 0.0]])
    assert distance_outside(points, solids) == pytest.approx([0.2, 0.1])


@pytest.mark.parametrize("seed", range(8))
def test_the_distance_of_a_line_from_a_box_solves_its_linear_program(seed):
    """The least g, for some t, with low - g <= point + t axis <= high + g."""
    random = np.random.default_rng(seed)
    point, axis = random.normal(size=(2, 3))
    axis[: seed % 3] = 0.0
    low = random.normal(size=3)
    high = low + random.uniform(0.1, 0.6, 3)
    rows = np.vstack([np.column_stack([s * axis, -np.ones(3)]) for s in (1.0, -1.0)])
    solved = linprog(
        [0, 1], rows, [*(high - point), *(point - low)], bounds=[(None, None), (0, None)]
    )
    assert line_box_distance(point, axis, low, high) == pytest.approx(solved.fun, abs=1e-9)


def test_a_line_through_a_box_is_at_no_distance():
    low, high = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])
    assert line_box_distance(np.array([0.2, 0.3, -5.0]), np.array([0.0, 0.0, 1.0]), low, high) == 0
    beside = line_box_distance(np.array([0.2, 0.7, 0.4]), np.array([1.0, 0.0, 0.0]), low, high)
    assert beside == pytest.approx(0.2, abs=1e-9)


def test_points_are_uniform_on_the_visible_surface():
    body = part(
        "body",
        geom("seen", Box(size=SIZE), (0.3, -0.2, 0.5), role="visual"),
        geom("hidden", Box(size=(2.0, 2.0, 2.0)), role="collision"),
    )
    points = visible_points(body, 20000) - (0.3, -0.2, 0.5)
    half = np.array(SIZE) / 2
    assert points.shape == (20006, 3)
    assert points.min(axis=0) == pytest.approx(-half)
    assert points.max(axis=0) == pytest.approx(half)
    area = np.array([SIZE[1] * SIZE[2], SIZE[0] * SIZE[2], SIZE[0] * SIZE[1]])
    for axis in range(3):
        for side in (-1.0, 1.0):
            on = np.abs(points[:, axis] - side * half[axis]) < 1e-12
            assert on.mean() == pytest.approx(area[axis] / area.sum() / 2, abs=0.01)
            others = np.delete(np.arange(3), axis)
            # Of a uniform rectangle.
            assert points[on][:, others].mean(axis=0) == pytest.approx((0, 0), abs=0.01)
            spread = np.array(SIZE)[others] / np.sqrt(12)
            assert points[on][:, others].std(axis=0) == pytest.approx(spread, rel=0.05)


def inertial_part(moments, *, products=(0.0, 0.0, 0.0), pos=(0.0, 0.0, 0.2), mass=4.8):
    stated = AuthoredInertia(pos=pos, moments=moments, products=products)
    return part("body", geom("box", Box(size=SIZE), (0, 0, 0.2)), mass=mass, inertia=stated)


MASS = WOOD.density * 0.1 * 0.2 * 0.4
MOMENTS = MASS / 12 * np.array([0.2**2 + 0.4**2, 0.1**2 + 0.4**2, 0.1**2 + 0.2**2])
"""Of the box from volume and density."""


def test_moments_are_compared_with_those_that_a_body_can_have():
    turn = Rotation.from_rotvec((0.3, -0.2, 0.5)).as_matrix()
    for moments, violation in (((0.1, 0.1, 0.25), 0.2), ((0.1, 0.15, 0.25), 0.0)):
        tensor = turn @ np.diag(moments) @ turn.T
        body = inertial_part(np.diag(tensor), products=tensor[(0, 0, 1), (1, 2, 2)])
        assert checks_of(body)["moments:body"].value == pytest.approx(violation, abs=1e-9)
    impossible = checks_of(inertial_part((0.1, 0.2, -0.01)))["moments:body"]
    assert impossible.fault is Fault.INERTIA_IMPOSSIBLE and impossible.value is None


@pytest.mark.parametrize(
    ("factor", "value", "passes"),
    [(1.0, 3.0, True), (1 / 29, 29.0, True), (1 / 31, 31.0, False), (9.9, 29.7, True),
     (10.1, 30.3, False)],
)  # fmt: skip
def test_an_inertia_is_compared_with_that_of_the_colliders(factor, value, passes):
    """At the authored mass, whether or not that is the one of volume and density."""
    for mass in (MASS, 2 * MASS):
        moments = tuple(factor * mass / MASS * MOMENTS)
        check = checks_of(inertial_part(moments, mass=mass))["spread:body"]
        assert check.value == pytest.approx(value)
        assert (check.outcome == "PASS") is passes


def test_a_center_of_mass_must_be_within_the_part():
    inside = checks_of(inertial_part(tuple(MOMENTS), pos=(0.04, -0.09, 0.39)))["centre:body"]
    assert inside.value == 0.0 and inside.outcome == "PASS"
    outside = checks_of(inertial_part(tuple(MOMENTS), pos=(0.04, -0.13, 0.39)))["centre:body"]
    assert outside.value == pytest.approx(0.03)
    assert outside.threshold == pytest.approx(0.05 * np.linalg.norm(SIZE))
    assert outside.fault is Fault.INERTIA_IMPOSSIBLE


@pytest.mark.parametrize(
    ("factor", "value", "passes"),
    [(9.0, 9.0, True), (11.0, 11.0, False), (0.011, 1 / 0.11, True), (0.009, 1 / 0.09, False)],
)
def test_a_mass_is_compared_with_that_of_volume_and_density(factor, value, passes):
    checks = checks_of(part("body", geom("box", Box(size=SIZE)), mass=factor * MASS))
    assert checks["mass:body"].value == pytest.approx(value)
    assert (checks["mass:body"].outcome == "PASS") is passes
    assert checks["mass"].value == pytest.approx(factor * MASS)


@pytest.mark.parametrize(("density", "passes"), [(21000.0, True), (23000.0, False), (0.4, False)])
def test_a_mass_of_unknown_material_is_possible_for_some(density, passes):
    unknown = STEEL.model_copy(update={"name": "unknown"})
    box = geom("box", Box(size=SIZE), material="unknown")
    checks = checks_of(part("body", box, mass=density * 0.008), material=unknown)
    assert (checks["mass:body"].outcome == "PASS") is passes
    if density > 1:
        assert checks["mass:body"].value == pytest.approx(density)


def test_masses_of_parts_are_summed_and_bounded():
    light, heavy = (part(name, geom(name, Box(size=SIZE))) for name in ("light", "heavy"))
    heavy = heavy.model_copy(update={"mass": 1999.0})
    # Static checks do not look at joints.
    spec = spec_of(light).model_copy(update={"parts": (light, heavy)})
    (total,) = (check for check in check_statics(spec) if check.name == "mass")
    assert total.value == pytest.approx(1999.0 + MASS)
    assert total.fault is Fault.MASS_IMPLAUSIBLE and total.threshold == 2000.0


@pytest.mark.parametrize(
    ("friction", "passes"), [(0.08, False), (0.1, True), (1.7, True), (1.8, False)]
)
def test_an_object_slides_on_a_slope_between_5_and_60_degrees(friction, passes):
    slides = WOOD.model_copy(update={"friction": friction})
    box = geom("box", Box(size=SIZE))
    check = checks_of(part("body", box), material=slides)["friction:wood"]
    assert check.value == friction and (check.outcome == "PASS") is passes
    assert 5.0 < np.degrees(np.arctan(0.09)) < 5.2 and 60.0 < np.degrees(np.arctan(1.75)) < 60.3
    seen = geom("seen", Box(size=SIZE), role="visual")
    unused = slides.model_copy(update={"name": "paint"})
    painted = part("body", box, seen.model_copy(update={"material": "paint"}))
    spec = ObjectSpec(name="o", materials=(WOOD, unused), parts=(painted,))
    assert "friction:paint" not in {check.name for check in check_statics(spec)}


@pytest.mark.parametrize("height", [0.4, 0.34, 0.2])
def test_the_share_of_the_surface_without_a_collider(height):
    """Of a visible column; the lower part of it has a collider."""
    body = part(
        "body",
        geom("seen", Box(size=SIZE), (0, 0, 0.2), role="visual"),
        geom("solid", Box(size=(0.1, 0.2, height)), (0, 0, height / 2), role="collision"),
    )
    check = checks_of(body)["colliders_missing:body"]
    area = 2 * (0.1 * 0.2 + (0.1 + 0.2) * 0.4)
    tolerated = 0.03 * np.linalg.norm(SIZE)
    above = max(0.4 - height - tolerated, 0.0)
    expected = (2 * (0.1 + 0.2) * above + (0.1 * 0.2 if above else 0.0)) / area
    assert check.value == pytest.approx(expected, abs=0.05)
    assert (check.outcome == "PASS") is bool(expected < 0.2)


def test_colliders_that_exceed_the_visible_shape():
    seen = geom("seen", Box(size=SIZE), role="visual")
    for excess in (0.015, 0.03):
        wide = (0.1 + 2 * excess, 0.2, 0.4)
        body = part("body", seen, geom("solid", Box(size=wide), role="collision"))
        check = checks_of(body)["colliders_out:body"]
        assert check.value == pytest.approx(excess)
        assert check.threshold == pytest.approx(0.04 * np.linalg.norm(SIZE))
        assert (check.outcome == "PASS") is (excess < 0.018)
    tiny = part("body", geom("seen", Box(size=(0.01, 0.01, 0.01)), role="visual"),
                geom("solid", Box(size=(0.015, 0.01, 0.01)), role="collision"))  # fmt: skip
    assert checks_of(tiny)["colliders_out:body"].threshold == 0.003
    # One shape for both needs no comparison.
    assert "colliders_out:body" not in checks_of(part("body", geom("box", Box(size=SIZE))))
