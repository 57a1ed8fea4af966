"""Further photographs: their cameras by boxes or known poses, their rows, and what they add."""

import dataclasses
import functools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neoworld_mjx.estimate.align import align, align_again
from neoworld_mjx.estimate.rows.boxes import box_evidence
from neoworld_mjx.estimate.unknowns import STEP, Unknowns
from neoworld_mjx.estimate.views import locate, located_views, posed
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.further_photo import FurtherPhoto
from neoworld_mjx.spec import Box2D
from tests.estimate import desk

MIDDLE = np.array([0.9, 0.0, 0.05])


def camera_aside(degrees, camera=desk.CAMERA):
    turn = Rotation.from_rotvec([0, 0, math.radians(degrees)]).as_matrix()
    return posed(camera, turn @ camera.axes(), MIDDLE + turn @ (camera.position() - MIDDLE))


def relative(first, other):
    """Transform from the frame of another camera to that of the first."""
    matrix = np.eye(4)
    matrix[:3, :3] = first.axes().T @ other.axes()
    matrix[:3, 3] = first.axes().T @ (other.position() - first.position())
    return matrix


def taken_by(truth, camera, **fields):
    """The photograph by another camera, and the boxes in it."""
    scene = truth.model_copy(update={"camera": camera})
    ratio = 480 / camera.width
    boxes = {
        item.name: Box2D(**{k: ratio * v for k, v in item.box2d.model_dump().items()})
        for item in desk.boxed(scene).objects
        if not item.environment
    }
    return FurtherPhoto(desk.photograph(scene), boxes, source="b.jpg", **fields)


@pytest.fixture(scope="module")
def aside(five):
    return taken_by(five, camera_aside(40))


@pytest.fixture(scope="module")
def located(five):
    """A function of the degrees that a camera is aside: the view that its boxes give, kept."""
    found = lambda degrees: locate(five, five.camera, taken_by(five, camera_aside(degrees))).view
    return functools.cache(found)


@pytest.fixture(scope="module")
def wrong(five):
    moves = {"box": (20, 10, 4, 5), "can": (-15, 10, 0, -4), "tower": (25, -10, -4, 6)}
    return desk.misjudged(desk.boxed(desk.displaced(five, **moves)), 5.0)


def off(found, true):
    """Distance [m] and angle [deg] between two poses relative to cameras."""
    turn = Rotation.from_matrix(found[:3, :3].T @ true[:3, :3]).as_rotvec()
    return np.linalg.norm(found[:3, 3] - true[:3, 3]), math.degrees(np.linalg.norm(turn))


@pytest.mark.parametrize("degrees", [40, -100, 0])
def test_boxes_give_the_pose_of_a_camera(five, located, degrees):
    camera, found = camera_aside(degrees), located(degrees).camera
    distance, angle = off(relative(five.camera, found), relative(five.camera, camera))
    assert distance < 0.03 and angle < 1.5


def test_a_known_pose_is_kept_and_an_unknown_unit_estimated(five):
    camera = camera_aside(40)
    true = relative(five.camera, camera)
    known = locate(five, five.camera, taken_by(five, camera, to_first=true)).view
    assert off(relative(five.camera, known.camera), true) < (1e-9, 1e-6)
    scaled = true.copy()
    scaled[:3, 3] *= 7.3
    photo = taken_by(five, camera, to_first=scaled, metric=False)
    found = locate(five, five.camera, photo).view
    assert off(found.to_first, true)[0] < 0.01
    along = true[:3, :3].T @ true[:3, 3] / np.linalg.norm(true[:3, 3])
    across = np.linalg.svd(along[None])[2][1]
    precision = found.precision[:3, :3]
    assert along @ precision @ along < 0.01 * (across @ precision @ across)


def test_cameras_without_pose_are_refused_with_the_reason(five, photo, aside):
    few = dataclasses.replace(aside, boxes={"can": aside.boxes["can"]}, source="few.jpg")
    names = list(aside.boxes)
    boxes = dict(zip(names, [aside.boxes[n] for n in reversed(names)], strict=True))
    mixed = dataclasses.replace(aside, boxes=boxes, source="mixed.jpg")
    views, refused = located_views(five, five.camera, (few, mixed, aside))
    assert len(views) == 1 and views[0].photo is aside
    assert "it shows 1 of the objects; its pose needs 3" in refused["few.jpg"]
    assert "of the same scene, with the same names?" in refused["mixed.jpg"]
    outcome = align(five, photo, evidence=Evidence(further=(few,))).views
    assert outcome["few.jpg"].camera is None and outcome["few.jpg"].reason


def test_derivatives_with_respect_to_the_other_camera(five, located, aside):
    view = located(40)
    unknowns = Unknowns.of(five, five.camera, views=(view,))
    assert unknowns.size == desk.unknowns_of(five).size + 6
    x = np.zeros(unknowns.size)
    x[unknowns.view_columns(1)] = [0.01, -0.02, 0.01, 0.02, -0.01, 0.03]
    now, neighbors = unknowns.place(x[None])[0].seen_from(1), unknowns.neighbors(x)
    near = [place.seen_from(1) for place in neighbors]
    k = five.index("can")
    rows = box_evidence(unknowns, now, near, unknowns.draw(now, 640), k, aside.boxes["can"])
    for u in (2, unknowns.columns(k).start, *unknowns.view_columns(1)):
        moved = unknowns.place((x + STEP * 100 * np.eye(unknowns.size)[u])[None])[0].seen_from(1)
        other = box_evidence(
            unknowns, moved, near, unknowns.draw(moved, 640), k, aside.boxes["can"]
        )
        change = (rows.residual - other.residual) / (STEP * 100)
        assert np.allclose(change, rows.jacobian[:, u], atol=0.02 * abs(change).max() + 1.0)


def test_focal_length_moves_both_cameras_back(five, located):
    view = located(40)
    unknowns = Unknowns.of(five, five.camera, views=(view,))
    x = np.zeros(unknowns.size)
    x[2] = 0.2
    (longer,) = unknowns.place(x[None])[0].views
    assert longer.focal == pytest.approx(view.camera.focal * math.exp(0.2))
    ahead = unknowns.camera_at(x)[1]
    assert longer.project(MIDDLE + [ahead, 0, 0])[1] > 1.15 * view.camera.project(MIDDLE)[1]
    own = dataclasses.replace(view, shares_focal=False)
    (same,) = Unknowns.of(five, five.camera, views=(own,)).place(x[None])[0].views
    assert same.focal == view.camera.focal


def test_another_photograph_lowers_the_errors(five, photo, wrong, aside):
    alone = align(wrong, photo)
    both = align(wrong, photo, evidence=Evidence(further=(aside,)))
    errors = [
        np.mean(list(desk.distances(result.scene, five, common=common).values()))
        for result in (alone, both)
        for common in (True, False)
    ]
    assert errors[2] < 0.75 * errors[0] and errors[3] < 0.9 * errors[1]
    view = both.views["b.jpg"]
    # 40 degrees about the vertical are 34 between two lines of sight that look down.
    assert abs(view.turn_deg - 34) < 3 and view.objects == 5
    assert "b.jpg is used for the layout" in dict(both.notes())
    assert both.to_json()["views"]["b.jpg"]["camera"]["yaw"] == pytest.approx(view.camera.yaw)
    across = [np.mean([o.uncertainty.across for o in r.objects.values()]) for r in (alone, both)]
    assert across[1] < 0.9 * across[0]


def test_a_known_pose_gives_the_scale(five, photo, wrong):
    camera = camera_aside(40)
    to_first = relative(five.camera, camera)
    known = taken_by(five, camera, to_first=to_first)
    result = align(wrong, photo, evidence=Evidence(further=(known,)))
    assert abs(result.scene.camera.fovy - five.camera.fovy) < math.radians(1.5)
    errors = desk.distances(result.scene, five)
    assert np.mean(list(errors.values())) < 15


def test_further_photographs_do_not_count_in_the_final_alignment(five, photo, aside):
    result = align_again(five, photo, ["can"], evidence=Evidence(further=(aside,)))
    assert not result.views
