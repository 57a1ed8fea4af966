"""Heights at which objects touch their supports, and lines through pieces of all kinds."""

import jax
import mujoco
import numpy as np
import pytest

from neoworld_mjx.physics.support import (
    NO_SURFACE,
    height_above,
    support,
    underside_points,
    vertical_intersections,
)
from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    Sphere,
)
from neoworld_mjx.spec.convex import Piece, polytope
from neoworld_mjx.spec.pose import from_axis_angle, matrix, pose
from tests.support.mechanisms import WOOD, geom, part, single

TURNED = from_axis_angle((0.3, -0.5, 0.8), 1.1)
WEDGE = np.array(
    [(x, y, z) for x in (-0.1, 0.1) for y in (-0.15, 0.15) for z in (-0.1, 0.2 * (x > 0))]
)
PIECES = {
    "box": Piece("box", (0.1, 0.15, 0.2)),
    "mesh": polytope(WEDGE),
    "sphere": Piece("sphere", (0.15,)),
    "ellipsoid": Piece("ellipsoid", (0.1, 0.15, 0.2)),
    "cylinder": Piece("cylinder", (0.1, 0.15)),
    "capsule": Piece("capsule", (0.1, 0.15)),
}
touching_height = jax.jit(height_above)


def ray_heights(piece, place, xy):
    """Heights at which MuJoCo's rays from below and from above meet a piece; NaN if they miss."""
    spec = mujoco.MjSpec()
    added = spec.worldbody.add_geom(pos=place.pos, quat=place.quat)
    added.type = getattr(mujoco.mjtGeom, f"mjGEOM_{piece.kind.upper()}")
    if piece.kind == "mesh":
        mesh = spec.add_mesh(name="mesh")
        mesh.uservert = np.array(piece.vertices).ravel()
        added.meshname = "mesh"
    else:
        added.size = [*piece.size, 0, 0][:3]
    model = spec.compile()
    data, hit = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    found = np.full((2, len(xy)), np.nan)
    for k, (x, y) in enumerate(xy):
        for row, side in enumerate((-1.0, 1.0)):
            start, way = np.array([x, y, side]), np.array([0.0, 0.0, -side])
            distance = mujoco.mj_ray(model, data, start, way, None, 1, -1, hit)
            if distance >= 0:
                found[row, k] = side * (1 - distance)
    return found


@pytest.mark.parametrize("turn", [(1.0, 0.0, 0.0, 0.0), tuple(TURNED)])
@pytest.mark.parametrize("kind", PIECES)
def test_lines_meet_a_piece_where_rays_of_mujoco_do(kind, turn):
    place = pose((0.05, -0.03, 0.1), turn)
    xy = np.random.default_rng(0).uniform(-0.3, 0.3, (200, 2))
    low, high = vertical_intersections(PIECES[kind], place, xy)
    expected = ray_heights(PIECES[kind], place, xy)
    missed = np.isnan(expected).any(axis=0)
    assert 20 < missed.sum() < 190
    np.testing.assert_array_equal(low == np.inf, missed)
    np.testing.assert_array_equal(high == -np.inf, missed)
    np.testing.assert_allclose(low[~missed], expected[0, ~missed], atol=1e-6)
    np.testing.assert_allclose(high[~missed], expected[1, ~missed], atol=1e-6)


def pair(parent_shape, child_shape, *, xy=(0.0, 0.0), z=0.5, **child):
    """An object high above another, whose shapes have their middles at the origins."""
    parent = SceneObject(name="parent", spec=single("parent", parent_shape), environment=True)
    spec = single("child", child_shape)
    item = SceneObject(name="child", spec=spec, parent="parent", xy=xy, z=z, **child)
    return SceneSpec(objects=(parent, item)), item


def height(scene, item, *, xy=None, yaw=0.0, size=1.0, parent_size=1.0):
    table = support(scene, item, 0.1)
    at = np.array(item.xy if xy is None else xy, np.float32)
    return float(
        touching_height(table, at, np.float32(yaw), np.float32(size), np.float32(parent_size))
    )


@pytest.mark.parametrize(("size", "parent_size"), [(1.0, 1.0), (2.0, 1.0), (1.0, 1.5), (0.5, 1.2)])
@pytest.mark.parametrize(
    ("child", "below"),
    [
        (Box(size=(0.1, 0.1, 0.06)), 0.03),
        (Sphere(radius=0.05), 0.05),
        (Cylinder(radius=0.05, height=0.08), 0.04),
        (Capsule(radius=0.02, length=0.06), 0.05),
        (Ellipsoid(radii=(0.05, 0.04, 0.03)), 0.03),
    ],
)
def test_sizes_scale_the_height_on_a_level_support(child, below, size, parent_size):
    scene, item = pair(Box(size=(0.6, 0.6, 0.2)), child)
    found = height(scene, item, size=size, parent_size=parent_size)
    assert found == pytest.approx(0.1 * parent_size + below * size, abs=1e-5)


@pytest.mark.parametrize("yaw", [0.0, 0.9])
@pytest.mark.parametrize("xy", [(0.0, 0.0), (0.05, -0.04)])
@pytest.mark.parametrize(
    ("parent", "z"),
    [
        (Sphere(radius=0.2), lambda x, y: np.sqrt(0.2**2 - x**2 - y**2)),
        (
            Ellipsoid(radii=(0.3, 0.2, 0.1)),
            lambda x, y: 0.1 * np.sqrt(1 - (x / 0.3) ** 2 - (y / 0.2) ** 2),
        ),
    ],
)
def test_a_flat_object_touches_a_dome_at_the_highest_point_under_it(parent, z, xy, yaw):
    scene, item = pair(parent, Box(size=(0.06, 0.04, 0.02)), xy=xy)
    c, s = np.cos(yaw), np.sin(yaw)
    u, v = np.meshgrid(np.linspace(-0.03, 0.03, 61), np.linspace(-0.02, 0.02, 41))
    top = z(xy[0] + c * u - s * v, xy[1] + s * u + c * v).max()
    assert height(scene, item, yaw=yaw) == pytest.approx(top + 0.01, abs=4e-4)


def test_a_tilted_box_stands_on_its_lowest_edge():
    angle = 0.4
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), angle).tolist())
    scene, item = pair(Box(size=(0.6, 0.6, 0.2)), Box(size=(0.1, 0.1, 0.06)), base_tilt=tilt)
    below = 0.05 * np.sin(angle) + 0.03 * np.cos(angle)
    assert height(scene, item) == pytest.approx(0.1 + below, abs=1e-5)


@pytest.mark.parametrize("angle", [0.0, 0.7, 1.4])
def test_a_tilted_ellipsoid_touches_by_its_support_function(angle):
    radii = np.array((0.05, 0.02, 0.03))
    axis = np.array((1.0, 2.0, 0.0)) / np.sqrt(5)
    tilt = from_axis_angle(axis, angle)
    scene, item = pair(
        Box(size=(0.6, 0.6, 0.2)), Ellipsoid(radii=tuple(radii)), base_tilt=tuple(tilt.tolist())
    )
    below = np.linalg.norm(radii * matrix(tilt)[2])
    assert height(scene, item) == pytest.approx(0.1 + below, abs=1e-5)


@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.6, -0.8, 0.0)])
@pytest.mark.parametrize(("xy", "yaw"), [((0.0, 0.0), 0.0), ((0.031, -0.047), 0.4)])
def test_an_object_on_a_slope_touches_it_with_its_highest_corner(axis, xy, yaw):
    """Heights between grid points are exact on a plane."""
    tilt = from_axis_angle(axis, 0.3)
    board = geom("board", Box(size=(0.6, 0.6, 0.02)), quat=tuple(tilt.tolist()))
    spec = ObjectSpec(name="parent", materials=(WOOD,), parts=(part("body", board),))
    scene, item = pair(Box(size=(1, 1, 1)), Box(size=(0.06, 0.04, 0.02)), xy=xy)
    parent = scene.objects[0].model_copy(update={"spec": spec})
    scene = scene.model_copy(update={"objects": (parent, item)})
    normal = matrix(tilt)[:, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    corners = np.array([(0.03, 0.02), (0.03, -0.02), (-0.03, 0.02), (-0.03, -0.02)])
    corners = corners @ np.array([[c, s], [-s, c]]) + xy
    top = (0.01 - corners @ normal[:2]) / normal[2]
    assert height(scene, item, yaw=yaw) == pytest.approx(top.max() + 0.01, abs=1e-5)


def test_beside_its_support_an_object_has_no_height():
    scene, item = pair(Box(size=(0.2, 0.2, 0.2)), Box(size=(0.06, 0.06, 0.06)), xy=(0.08, 0.0))
    assert height(scene, item) == pytest.approx(0.13, abs=1e-5)
    # Its edge is still over the support.
    assert height(scene, item, xy=(0.125, 0.0)) == pytest.approx(0.13, abs=1e-5)
    assert height(scene, item, xy=(0.16, 0.0)) < NO_SURFACE / 2


def shelf():
    """Boards at heights 0 and 0.3 m, each 2 cm thick, between two walls."""
    board, wall = Box(size=(0.3, 0.5, 0.02)), Box(size=(0.3, 0.02, 0.34))
    places = (board, 0, 0), (board, 0, 0.3), (wall, 0.25, 0.15), (wall, -0.25, 0.15)
    geoms = [geom(f"g{k}", shape, (0, y, z)) for k, (shape, y, z) in enumerate(places)]
    spec = ObjectSpec(name="parent", materials=(WOOD,), parts=(part("body", *geoms),))
    return SceneObject(name="parent", spec=spec, environment=True)


@pytest.mark.parametrize(
    ("z", "tall", "relation", "expected"),
    [
        # On the lower board, or on the upper one, whichever is nearer to the composed height.
        (0.05, 0.1, "on", 0.01),
        (0.1, 0.1, "on", 0.01),
        (0.4, 0.1, "on", 0.31),
        # It does not fit between the boards, unless it is known to be inside.
        (0.1, 0.4, "on", 0.31),
        (0.05, 0.1, "in", 0.01),
        (0.1, 0.28, "on", 0.01),
        (0.1, 0.29, "on", 0.31),
    ],
)
def test_an_object_stands_on_the_board_of_a_shelf_on_which_it_fits(z, tall, relation, expected):
    spec = single("child", Box(size=(0.06, 0.06, tall)), tall / 2)
    item = SceneObject(name="child", spec=spec, parent="parent", z=z, relation=relation)
    scene = SceneSpec(objects=(shelf(), item))
    assert height(scene, item) == pytest.approx(expected, abs=1e-5)


def test_the_board_above_an_object_is_that_at_its_place():
    """The upper board is over one half of the lower one."""
    board, half = Box(size=(0.3, 0.5, 0.02)), Box(size=(0.3, 0.25, 0.02))
    geoms = geom("lower", board), geom("upper", half, (0, -0.125, 0.3))
    spec = ObjectSpec(name="parent", materials=(WOOD,), parts=(part("body", *geoms),))
    parent = SceneObject(name="parent", spec=spec, environment=True)
    cube = single("child", Box(size=(0.06, 0.06, 0.1)), 0.05)
    for y, expected in ((-0.12, 0.31), (0.12, 0.01)):
        item = SceneObject(name="child", spec=cube, parent="parent", z=0.25, xy=(0.02, y))
        scene = SceneSpec(objects=(parent, item))
        assert height(scene, item) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("degrees", "on_floor"), [(25.0, True), (4.0, False)])
def test_an_object_that_leans_in_its_parent_stands_on_its_lowest_edge(degrees, on_floor):
    """A wall under its higher part does not lift it, unless it is upright."""
    angle = np.radians(degrees)
    floor, wall = Box(size=(0.4, 0.4, 0.02)), Box(size=(0.02, 0.4, 0.1))
    geoms = geom("floor", floor), geom("wall", wall, (0.03 + 0.01, 0, 0.06))
    spec = ObjectSpec(name="parent", materials=(WOOD,), parts=(part("body", *geoms),))
    parent = SceneObject(name="parent", spec=spec, environment=True)
    tilt = tuple(from_axis_angle((0.0, 1.0, 0.0), angle).tolist())
    board = single("child", Box(size=(0.01, 0.06, 0.3)))
    lowest = 0.15 * np.cos(angle) + 0.005 * np.sin(angle)
    # Its lowest edge is 2 cm before the wall.
    x = 0.01 + 0.15 * np.sin(angle) - 0.005 * np.cos(angle)
    x = x if on_floor else 0.04
    item = SceneObject(
        name="child", spec=board, parent="parent", relation="in", base_tilt=tilt,
        xy=(x, 0.0), z=0.012 + lowest,
    )  # fmt: skip
    found = height(SceneSpec(objects=(parent, item)), item)
    assert found == pytest.approx(lowest + (0.01 if on_floor else 0.11), abs=2e-3)


def test_the_underside_of_a_lying_capsule_reaches_to_its_ends():
    lying = tuple(from_axis_angle((0.0, 1.0, 0.0), np.pi / 2))
    item = SceneObject(
        name="rod", spec=single("rod", Capsule(radius=0.02, length=0.06)), base_tilt=lying
    )
    points = underside_points(item)
    points = points[np.isfinite(points[:, 2])]
    assert 0.04 < np.abs(points[:, 0]).max() <= 0.0501
    assert points[:, 2].min() == pytest.approx(-0.02, abs=1e-6)


def test_a_line_in_the_wall_of_a_cylinder_meets_it():
    at = np.array([[0.5, 0.0], [0.0, -0.5], [0.500001, 0.0]])
    low, high = vertical_intersections(Piece("cylinder", (0.5, 0.1)), pose((0.0, 0.0, 0.0)), at)
    assert low[:2] == pytest.approx(-0.1) and high[:2] == pytest.approx(0.1)
    assert low[2] == np.inf
