"""Real photographs: readers, scores of perfect and disturbed reconstructions, and the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.measures.pose_measure import Intrinsics
from neoworld_bench.real_poses.placed_views import MadeView
from neoworld_bench.real_poses.real_views import posed_meshes, real_rows, score_real_views
from neoworld_bench.real_poses.scene_depth import in_camera, intrinsics_of, scene_points
from neoworld_bench.real_poses.true_views import bop_views, depth_views

from neoworld_mjx import cli
from neoworld_mjx.config import Config, RefineOptions
from neoworld_mjx.errors import SpecError
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


def test_scale_of_the_whole_scene_is_no_error(sample):
    """Everything 1.3 times as large, about the camera, which a photograph leaves open."""
    scene = desk()
    grown = {o.name: (scale(o.spec, 1.3), tuple(1.3 * v for v in o.xy)) for o in scene.objects}
    objects = tuple(
        o.model_copy(update={"spec": grown[o.name][0], "xy": grown[o.name][1], "z": 1.3 * o.z})
        for o in scene.objects
    )
    camera = scene.camera.model_copy(update={"height": 1.3 * scene.camera.height})
    head, rows = scored(sample, scene.model_copy(update={"objects": objects, "camera": camera}))
    assert head.scale == pytest.approx(1 / 1.3, rel=2e-3)
    assert all(rows[name].add_s < 2e-3 for name in NAMES.values())


def test_equal_names_match_before_the_image_decides(sample):
    renamed = changed(changed(desk(), "block", name="obj_000003"), "can", name="obj_000001")
    _, rows = scored(sample, renamed)
    assert rows["obj_000003"].add_s > 1 and rows["obj_000002"].object == "carton"


def test_intrinsics_of_a_scene_camera_are_opencvs():
    """OpenCV counts from the center of the first pixel, the scene's camera from its corner."""
    points = np.array([[1.0, 0.1, 0.2], [0.8, -0.2, 0.0]])
    pixels, depth = OTHER.project(points)
    local = in_camera(OTHER, points)
    assert np.allclose(local[:, 2], depth)
    assert np.allclose(intrinsics_of(OTHER, 160, 120).project(local), pixels - 0.5)
    assert np.allclose(intrinsics_of(OTHER, 320, 240).project(local), 2 * pixels - 0.5)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("scene_camera.json", lambda d: d["3"].pop("cam_K"), "cam_K must be 9 numbers"),
        ("scene_camera.json", lambda d: d["3"].update(cam_K=[0] * 9), "positive focal"),
        ("scene_gt.json", lambda d: d["3"][0].update(cam_t_m2c=[1, 2]), "cam_t_m2c must be 3"),
        ("scene_gt.json", lambda d: d["3"][1].update(cam_R_m2c=[1] * 9), "object 1.*orthonormal"),
        ("scene_gt.json", lambda d: d["3"][0].update(obj_id=9), "obj_000009.ply"),
        ("scene_gt.json", lambda d: d.update({"3": 1}), "list of objects"),
        ("scene_gt.json", lambda d: d.update({"x": []}), "'x' is no number"),
    ],
)
def test_broken_bop_files_give_one_error(tmp_path, file, change, message):
    folder = write_bop(tmp_path / "desk", [desk()])
    path = folder / "test" / "000007" / file
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(SpecError, match=message):
        list(bop_views(folder, ["000007_000003"]))


def test_repeated_and_hidden_objects(tmp_path):
    folder = write_bop(tmp_path / "desk", [desk()])
    place = folder / "test" / "000007"
    poses = json.loads((place / "scene_gt.json").read_text())
    poses["3"] = [poses["3"][0], poses["3"][0], poses["3"][1]]
    (place / "scene_gt.json").write_text(json.dumps(poses))
    info = {"3": [{"visib_fract": share} for share in (1.0, 0.4, 0.05)]}
    (place / "scene_gt_info.json").write_text(json.dumps(info))
    (view,) = bop_views(place, ["000007_000003"])  # A scene's own folder is data, too.
    assert [item.name for item in view.objects] == ["obj_000001", "obj_000001_2"]
    assert np.ptp(view.objects[0].vertices, axis=0) == pytest.approx([0.06, 0.05, 0.1])


def test_depth_folder_and_its_camera(tmp_path):
    camera = write_depth_folder(tmp_path / "depth", desk())
    (view,) = depth_views(tmp_path / "depth", ["desk", "other"])
    assert view.camera == camera and view.size == SIZE and view.objects == ()
    (tmp_path / "depth" / "camera.json").unlink()
    with pytest.raises(SpecError, match=r"camera\.json"):
        list(depth_views(tmp_path / "depth", ["desk"]))


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


def test_what_cannot_be_scored_is_refused(tmp_path):
    data, runs = tmp_path / "data", tmp_path / "runs"
    data.mkdir()
    with pytest.raises(SpecError, match="is no folder"):
        score_real_views(data, runs)
    (runs / "office").mkdir(parents=True)
    with pytest.raises(SpecError, match=r"neither scene_gt\.json"):
        score_real_views(data, runs)
    write_depth_folder(data, desk())
    with pytest.raises(SpecError, match="no view with a reconstruction is named office"):
        score_real_views(data, runs)
    wide = desk(Camera(width=320, height_px=120, fovy=0.7, height=0.5, pitch=0.6))
    write_run(runs / "desk", wide, wide)
    with pytest.raises(SpecError, match="expected is the same aspect"):
        score_real_views(data, runs)
