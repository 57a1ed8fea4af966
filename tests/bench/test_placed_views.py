"""Recorded runs placed anew with the camera and the depth of a data set."""

import numpy as np
import pytest
from neoworld_bench.fidelity.rendered_responses import exact_response
from neoworld_bench.measures.pose_measure import Intrinsics
from neoworld_bench.real_poses.placed_views import MadeView, evidence_of_view, placed_views
from neoworld_bench.real_poses.real_views import real_rows
from neoworld_bench.real_poses.scene_depth import intrinsics_of, scene_points
from neoworld_bench.real_poses.true_views import TrueView
from PIL import Image

from neoworld_mjx.config import Config, RefineOptions
from neoworld_mjx.errors import SpecError
from tests.estimate import desk

QUICK = RefineOptions(check_duration_s=0.1)
CAMERA = desk.CAMERA.model_copy(update={"principal": (24.0, -10.0)})
SIZE = (640, 480)


@pytest.fixture(scope="module")
def truth():
    return desk.boxed(desk.five().model_copy(update={"camera": CAMERA}))


@pytest.fixture(scope="module")
def view(truth):
    camera = intrinsics_of(CAMERA, *SIZE)
    depth = scene_points(truth, CAMERA, camera, SIZE).points[..., 2]
    depth = np.where(np.isfinite(depth), depth, 0.0)
    return TrueView("desk", (), camera, SIZE, depth)


@pytest.fixture(scope="module")
def run(tmp_path_factory, truth):
    """The folder of a run whose model took the camera for a plain one of a wider view."""
    folder = tmp_path_factory.mktemp("runs") / "desk"
    wrong = desk.misjudged(truth, 6).camera.model_copy(update={"principal": (0.0, 0.0)})
    tree = exact_response(truth).model_copy(update={"camera": wrong})
    for item in truth.objects:
        (folder / "objects" / item.name).mkdir(parents=True)
        (folder / "objects" / item.name / "spec.json").write_text(item.spec.to_json())
    (folder / "tree.json").write_text(tree.to_json())
    Image.fromarray(desk.photograph(truth, 640)).save(folder / "photo.png")
    return folder


def absolute(view, made):
    _, rows = real_rows(view, made, QUICK)
    return {row.object: row.absolute_mm for row in rows}


def test_nothing_is_removed_from_absolute_errors(view, truth):
    assert max(absolute(view, MadeView("right", truth)).values()) < 0.1
    lower = CAMERA.model_copy(update={"height": CAMERA.height - 0.02})
    off = absolute(view, MadeView("lower", truth.model_copy(update={"camera": lower})))
    # Distances are along rays: the table is nearer by more than its height, an upright side is not.
    assert off["desk"] == pytest.approx(20 / np.sin(CAMERA.pitch), rel=0.25)
    assert off["can"] < 1


def test_a_view_is_evidence_of_its_camera_and_depth(view):
    photo = np.zeros((480, 640, 3), np.uint8)
    assert evidence_of_view(view, photo, "photo").camera is None
    with_camera, with_depth = (evidence_of_view(view, photo, k) for k in ("camera", "depth"))
    guess = CAMERA.model_copy(update={"principal": (0.0, 0.0), "fovy": 0.5})
    found = with_camera.camera.camera(guess)
    assert found.fovy == pytest.approx(CAMERA.fovy) and found.principal == pytest.approx((24, -10))
    assert with_camera.depth is None and np.isnan(with_depth.depth.values[view.depth == 0]).all()
    oblong = TrueView("desk", (), Intrinsics(100.0, 104.0, 319.5, 239.5), SIZE)
    assert evidence_of_view(oblong, photo, "camera").camera.focal == pytest.approx(102, abs=0.1)
    with pytest.raises(SpecError, match="desk has no depth"):
        evidence_of_view(oblong, photo, "depth")


def test_runs_are_placed_in_meters_by_camera_and_depth(view, run):
    assert list(placed_views(view, run, (), Config())) == []
    made = list(placed_views(view, run, ("photo", "depth"), Config()))
    stages = [f"{step}, {known}" for known in ("photo", "depth") for step in ("placed", "refined")]
    assert [each.stage for each in made] == stages
    *alone, placed, refined = [absolute(view, each).values() for each in made]
    assert max(*placed, *refined) < 3 < min(min(errors) for errors in alone)
