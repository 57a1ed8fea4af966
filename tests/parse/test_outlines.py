import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neoworld_mjx.parse.categories import CATEGORIES, category_of
from neoworld_mjx.parse.checks import agreement
from neoworld_mjx.parse.outlines import (
    ROUND_POINTS,
    edges_in_view,
    expected_box,
    outline_points,
    to_world,
    visible_box,
)
from neoworld_mjx.spec import Box2D, Box3D, Camera
from tests.support import answers

CAMERA = Camera(width=800, height_px=600, fovy=0.8, height=0.5, pitch=0.6)


def test_a_box_in_full_view_is_seen_from_corner_to_corner():
    corners = Box3D(position=(0.8, 0, 0), size=(0.1, 0.1, 0.1), yaw=0.3).corners()
    pixels, _ = CAMERA.project(corners)
    expected = [*pixels.min(axis=0), *pixels.max(axis=0)]
    assert visible_box(CAMERA, corners) == pytest.approx(expected)


def test_a_floor_that_runs_behind_the_camera_fills_the_picture_below_its_far_edge():
    corners = Box3D(position=(0, 0, -0.1), size=(4, 20, 0.1)).corners()
    _, v = CAMERA.project(np.array([2.0, 0, 0]))[0]
    assert visible_box(CAMERA, corners) == pytest.approx([0, v, 800, 600], abs=1e-6)


def test_boxes_outside_the_view_have_no_visible_box():
    for x, y in ((-1.0, 0), (0.5, 3.0)):
        corners = Box3D(position=(x, y, 0), size=(0.1, 0.1, 0.1)).corners()
        assert visible_box(CAMERA, corners) is None
    behind = Box3D(position=(-1, 0, 0), size=(0.1, 0.1, 0.1)).corners()
    assert edges_in_view(CAMERA, behind) == []


@settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(-0.5, 3), st.floats(-2, 2), st.floats(-0.3, 0.5)),
    st.tuples(*[st.floats(0.05, 2)] * 3),
    st.floats(-3, 3),
)
def test_visible_boxes_match_ray_casting(at, size, yaw):
    """Against rays through a grid of pixels, met with the box by slabs."""
    box = Box3D(position=at, size=size, yaw=yaw)
    rows, columns = np.mgrid[0:600:12, 0:800:12] + 6.0
    rays = CAMERA.rays(np.stack([columns, rows], axis=-1)).reshape(-1, 3)
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    origin = (CAMERA.position() - np.array(at)) @ turn - [0, 0, size[2] / 2]
    ways = rays @ turn
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort([(sign * np.array(size) / 2 - origin) / ways for sign in (-1, 1)], axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    hit = (enter < leave) & (enter > 0.05)
    if np.all(np.abs(origin) < np.array(size) / 2 + 0.05):
        return
    result = visible_box(CAMERA, box.corners())
    if result is None:
        assert not hit.any()
    elif hit.any():
        u, v = columns.ravel()[hit], rows.ravel()[hit]
        drawn = np.array([u.min(), v.min(), u.max(), v.max()])
        assert (drawn[:2] >= result[:2] - 1e-6).all()
        assert (drawn[2:] <= result[2:] + 1e-6).all()


@pytest.mark.parametrize("label", ["book", "soda can", "bowl", "orange", "mug", "spoon", "thing"])
def test_outlines_stay_in_the_box(label):
    size = (0.2, 0.05, 0.03) if label == "spoon" else (0.12, 0.08, 0.1)
    obj = answers.item("a", (0.8, 0.05, 0), size, label=label, yaw_deg=40)
    tree = answers.exact(answers.answer(obj))
    node = tree.node("a")
    points, weight = outline_points(node)
    assert np.abs(points[:, :2]).max() <= 0.5 + 1e-12
    assert points[:, 2].min() >= -1e-12
    assert points[:, 2].max() <= 1 + 1e-12
    assert weight in (0.0, 0.5, 1.0)
    whole = visible_box(tree.camera, node.box3d.corners())
    inner = expected_box(tree.camera, node)
    assert (inner[:2] >= whole[:2] - 1e-6).all()
    assert (inner[2:] <= whole[2:] + 1e-6).all()


def test_a_ball_projects_as_a_ball():
    obj = answers.item("a", (0.8, 0.0, 0), (0.1, 0.1, 0.1), label="orange")
    tree = answers.exact(answers.answer(obj))
    camera = tree.camera
    # The outline of a sphere is a cone around its middle.
    middle = np.array([0.8, 0, 0.05]) - camera.position()
    half = math.asin(0.05 / np.linalg.norm(middle))
    down = math.atan2(-middle[2], middle[0]) - camera.pitch
    top = 300 + camera.focal * math.tan(down - half)
    bottom = 300 + camera.focal * math.tan(down + half)
    result = expected_box(camera, tree.node("a"))
    assert result[1] == pytest.approx(top, abs=1.5)
    assert result[3] == pytest.approx(bottom, abs=1.5)


@pytest.mark.parametrize(
    ("label", "word"),
    [
        ("coffee cup", "cup"),
        ("tomato soup can", "can"),
        ("box of tea", "box"),
        ("cardboard boxes", "box"),
        ("Drawer Cabinet", "cabinet"),
        ("drinking glass", "glass"),
        ("glasses", "glasses"),
        ("dishes", "dish"),
    ],
)
def test_labels_are_known_by_their_head_noun(label, word):
    assert category_of(label) == CATEGORIES[word]


@pytest.mark.parametrize("yaw_deg", [0, 45])
def test_a_pot_that_is_smaller_than_its_box_agrees_with_it(yaw_deg):
    """Two handles make the box of a pot long; at 45 degrees nothing of the pot is in its corners.

    The 2D box is that of a round body with two points at the ends, which are the handles.
    """
    pot = answers.item(
        "pot", (0.8, 0, 0), (0.12, 0.074, 0.04), label="cooking pot", yaw_deg=yaw_deg
    )
    tree = answers.exact(answers.answer(pot))
    node = tree.node("pot")
    body = ROUND_POINTS * [0.074 / 0.12, 1, 1]
    points = np.concatenate([body, [(-0.5, 0, 0.8), (0.5, 0, 0.8)]])
    pixels, _ = tree.camera.project(to_world(points, node.box3d))
    (x0, y0), (x1, y1) = pixels.min(axis=0), pixels.max(axis=0)
    seen = answers.with_node(tree, "pot", box2d=Box2D(x0=x0, y0=y0, x1=x1, y1=y1))
    assert agreement(seen, seen.node("pot")) > 0.95
