"""Real photographs: readers, scores of perfect and disturbed reconstructions, and the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.measures.pose_measure import Intrinsics
from neoworld_bench.real_poses.placed_views import MadeView
from neoworld_bench.real_poses.real_views import posed_meshes, real_rows, score_real_views
from neoworld_bench.real_poses.scene_depth import scene_points
from neoworld_bench.real_poses.true_views import bop_views

from neoworld_mjx import cli
from neoworld_mjx.config import Config, RefineOptions
from neoworld_mjx.spec import Camera
from neoworld_mjx.spec.scale import scale
from tests.support.bop_sample import (
    SIZE,
    TENTH_MM,
    camera_pose,
    desk,
    write_bop,
    write_depth_folder,
)
from tests.support.scenes import changed, without

QUICK = RefineOptions(check_duration_s=0.1)
NAMES = {"block": "obj_000001", "carton": "obj_000002", "can": "obj_000003"}
OTHER = Camera(width=160, height_px=120, fovy=0.6, height=0.62, pitch=0.75, roll=0.1)
OFF_CENTER = Intrinsics(171.0, 168.0, 74.5, 63.25)


@pytest.fixture(scope="module")
def sample(tmp_path_factory) -> Path:
    """Two images of the desk, one by a camera with its principal point off the center."""
    folder = tmp_path_factory.mktemp("bop")
    return write_bop(folder / "desk", [desk(), desk(OTHER)], cameras={4: OFF_CENTER})


def scored(sample, scene):
    (view,) = bop_views(sample, ["000007_000003"])
    head, rows = real_rows(view, MadeView("composed", scene), QUICK)
    return head, {row.true_object or row.object: row for row in rows}


def test_bop_sample_of_two_images_goes_round_trip(sample):
    views = {view.name: view for view in bop_views(sample, ["000007_000003", "000007_000004"])}
    assert list(views) == ["000007_000003", "000007_000004"]
    for name, scene in (("000007_000003", desk()), ("000007_000004", desk(OTHER))):
        view = views[name]
        assert [item.name for item in view.objects] == list(NAMES.values())
        own = posed_meshes(scene, scene.camera)
        for item, made in zip(view.objects, NAMES, strict=True):
            assert np.allclose(item.pose, camera_pose(scene, made), atol=1e-9)
            gap = item.posed[:, None] - own[made].vertices[None]
            assert np.linalg.norm(gap, axis=-1).min(axis=1).max() < 1e-7
        drawn = scene_points(scene, scene.camera, view.camera, SIZE).points[..., 2]
        hit = np.isfinite(drawn)
        assert np.abs(view.depth - drawn)[hit].max() < TENTH_MM / 1e3
        assert (view.depth[~hit] == 0).all()
    assert views["000007_000004"].camera == OFF_CENTER
    diameter = views["000007_000003"].objects[0].diameter
    assert diameter == pytest.approx(math.hypot(0.06, 0.05, 0.1), rel=1e-6)


def test_perfect_input_gives_perfect_figures_with_and_without_depth(sample, tmp_path):
    head, rows = scored(sample, desk())
    assert (head.true_objects, head.matched, head.extra, head.inliers) == (3, 3, 0, 1)
    for name in (*NAMES.values(), "table"):
        assert rows[name].error_mm < 0.2
    folder = write_bop(tmp_path / "desk", [desk()])
    (folder / "test" / "000007" / "depth" / "000003.png").unlink()
    without_depth, other_rows = scored(folder, desk())
    for view_row, object_rows in ((head, rows), (without_depth, other_rows)):
        assert view_row.scale == pytest.approx(1, abs=1e-3) and view_row.rotation_deg < 0.02
        for made, name in NAMES.items():
            row = object_rows[name]
            assert row.object == made and row.position_mm < 0.2
            assert row.add_s < 1e-3 and row.box_iou > 0.995 and row.icp_rot_deg < 0.05
        assert object_rows["table"].add_s is None
    assert without_depth.inliers is None and other_rows["table"].error_mm is None


def test_errors_of_a_pushed_a_turned_and_a_grown_object_are_their_own(sample):
    scene = desk()
    x, y = scene.object("carton").xy
    head, rows = scored(sample, changed(scene, "carton", xy=(x + 0.04, y)))
    assert rows["obj_000002"].position_mm == pytest.approx(40, abs=2)
    assert rows["obj_000002"].icp_rot_deg < 0.5 and rows["obj_000002"].bias_mm > 5
    assert rows["obj_000001"].add_s < 0.02 and rows["obj_000003"].error_mm < 1
    assert head.inliers < 1
    _, rows = scored(sample, changed(scene, "carton", yaw=0.8 + math.radians(12)))
    assert rows["obj_000002"].icp_rot_deg == pytest.approx(12, abs=0.5)
    assert rows["obj_000002"].position_mm < 3 and rows["obj_000001"].icp_rot_deg < 0.1
    _, rows = scored(sample, changed(scene, "can", spec=scale(scene.object("can").spec, 1.2)))
    # Seen in the camera's axes, both boxes have the same bottom.
    assert rows["obj_000003"].box_iou == pytest.approx(1 / 1.2**3, abs=0.06)
    assert rows["obj_000003"].icp_rot_deg < 1 and rows["obj_000002"].box_iou > 0.98


def test_missing_and_extra_objects_count(sample):
    scene = desk()
    head, rows = scored(sample, without(scene, "can"))
    assert (head.matched, head.extra) == (2, 0)
    assert rows["obj_000003"].object == "" and rows["obj_000003"].add_s is None
    can = scene.object("can").model_copy(update={"name": "second", "xy": (0.2, 0.3)})
    head, rows = scored(sample, scene.model_copy(update={"objects": (*scene.objects, can)}))
    assert head.extra == 1 and rows["second"].true_object == ""


def write_run(folder: Path, scene, composed) -> Path:
    (folder / "compose").mkdir(parents=True)
    (folder / "compose" / "scene.json").write_text(composed.to_json())
    (folder / "scene.json").write_text(scene.to_json())
    return folder


def test_command_scores_every_stage(tmp_path, capfd):
    scene = desk()
    write_depth_folder(tmp_path / "data", scene)
    x, y = scene.object("block").xy
    pushed = changed(scene, "block", xy=(x + 0.03, y))
    run = write_run(tmp_path / "runs" / "desk", scene, pushed)
    command = ["bench", "run", "real-poses", str(tmp_path / "data"), "--json"]
    command += ["--runs", str(tmp_path / "runs"), "--set", "refine.check_duration_s=0.1"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(command)
    result = json.loads(capfd.readouterr().out)
    assert [row["stage"] for row in result["views"]] == ["composed", "refined"]
    errors = {(row["stage"], row["object"]): row["error_mm"] for row in result["rows"]}
    assert errors["composed", "block"] > 5 and errors["refined", "block"] < 0.3
    assert result["figures"]["refined"]["median_error_mm"]["n"] == 4
    assert result["figures"]["refined"]["median_absolute_mm"]["value"] < 0.3
    assert result["figures"]["refined"]["unmeasured"] == 0
    assert "add_s" not in result["figures"]["refined"]
    # Aligned is what compose/align.json says.
    (run / "compose" / "align.json").write_text("{}")
    views, rows = score_real_views(tmp_path / "data", run.parent, Config(refine=QUICK))
    assert [row.stage for row in views] == ["aligned", "refined"] and len(rows) == 8
