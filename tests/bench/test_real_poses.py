"""Real photographs: readers, scores of perfect and disturbed reconstructions, and the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.measures.depth_measure import Intrinsics
from neoworld_bench.real_poses.bop import bop_views
from neoworld_bench.real_poses.depth_folder import depth_views
from neoworld_bench.real_poses.made_views import MadeView, submitted_view
from neoworld_bench.real_poses.pose_estimates import estimate_figures, estimate_rows
from neoworld_bench.real_poses.pose_rows import posed_meshes, real_rows
from neoworld_bench.real_poses.real_views import score_real_views, stored_real_rows
from neoworld_bench.real_poses.scene_depth import in_camera, intrinsics_of, scene_points
from neoworld_bench.tables.real_table import real_table
from neoworld_bench.tables.result_tables import write_tables

from neoworld_mjx import cli
from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import ConfigError, SpecError
from neoworld_mjx.export.importing import ImportedScene, import_file
from neoworld_mjx.spec import Camera, SceneSpec
from neoworld_mjx.spec.scale import scale
from tests.support.bop_sample import (
    SIZE,
    TENTH_MM,
    camera_pose,
    desk,
    write_bop,
    write_depth_folder,
)
from tests.support.mesh_scenes import write_poses
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


def view_of(sample: Path, name: str = "000007_000003"):
    (view,) = bop_views(sample, [name])
    return view


def scored(view, scene, align="none", matches=NAMES, volumes=False):
    made = MadeView("ours", "composed", scene, matches)
    head, rows = real_rows(view, made, align, QUICK, volumes=volumes)
    return head, {row.true_object or row.object: row for row in rows}


def test_bop_sample_of_two_images_goes_round_trip(sample):
    views = {view.name: view for view in bop_views(sample, ["000007_000003", "000007_000004"])}
    assert list(views) == ["000007_000003", "000007_000004"]
    for name, scene in (("000007_000003", desk()), ("000007_000004", desk(OTHER))):
        view = views[name]
        assert [item.name for item in view.objects] == list(NAMES.values())
        assert view.size == SIZE and view.camera is not None and view.depth is not None
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
    assert views["000007_000003"].objects[0].diameter == pytest.approx(
        math.hypot(0.06, 0.05, 0.1), rel=1e-6
    )


def test_perfect_input_gives_perfect_figures(sample):
    view = view_of(sample)
    for align in ("none", "scale", "depth", "objects"):
        head, rows = scored(view, desk(), align, volumes=align == "depth")
        assert head.scale == pytest.approx(1, abs=1e-3) and head.rotation_deg < 0.02
        assert (head.true_objects, head.matched, head.extra) == (3, 3, 0)
        assert head.s_pen == 0 and head.inliers == 1
        for name in NAMES.values():
            row = rows[name]
            assert row.add_s < 1e-3 and row.box_iou > 0.995 and row.icp_rot_deg < 0.05, (align, row)
            assert row.position_mm < 0.2
            if align == "depth":
                assert row.voxel_iou > 0.98 and row.f_score == 1 and row.chamfer < 0.02
            assert row.error_mm < 0.2 and row.collider_sound
        assert rows["table"].error_mm < 0.2 and rows["table"].add_s is None


def test_pushed_object_has_its_own_error(sample):
    view, scene = view_of(sample), desk()
    x, y = scene.object("carton").xy
    head, rows = scored(view, changed(scene, "carton", xy=(x + 0.04, y)))
    assert rows["obj_000002"].position_mm == pytest.approx(40, abs=1e-3)
    assert rows["obj_000002"].icp_rot_deg < 0.5 and rows["obj_000002"].error_mm > 5
    assert rows["obj_000002"].bias_mm > 5
    assert rows["obj_000001"].add_s < 1e-6 and rows["obj_000003"].error_mm < 0.1
    assert head.inliers < 1


def test_turned_object_has_a_rotation(sample):
    view, scene = view_of(sample), desk()
    _, rows = scored(view, changed(scene, "carton", yaw=0.8 + math.radians(12)))
    assert rows["obj_000002"].icp_rot_deg == pytest.approx(12, abs=0.5)
    assert rows["obj_000002"].position_mm < 3
    assert rows["obj_000001"].icp_rot_deg < 1e-3


def test_grown_object_has_a_smaller_overlap(sample):
    view, scene = view_of(sample), desk()
    larger = changed(scene, "can", spec=scale(scene.object("can").spec, 1.2))
    _, rows = scored(view, larger, volumes=True)
    grown = rows["obj_000003"]
    # Seen in the camera's axes, both boxes have the same bottom.
    assert grown.box_iou == pytest.approx(1 / 1.2**3, abs=0.06)
    assert grown.voxel_iou == pytest.approx(1 / 1.2**3, abs=0.08)
    assert grown.icp_rot_deg < 1 and rows["obj_000002"].box_iou > 1 - 1e-6


def test_missing_and_extra_objects_count(sample):
    view, scene = view_of(sample), desk()
    rest = {name: other for name, other in NAMES.items() if name != "can"}
    head, rows = scored(view, without(scene, "can"), matches=rest)
    assert (head.matched, head.extra) == (2, 0)
    assert rows["obj_000003"].object == "" and rows["obj_000003"].add_s is None
    can = scene.object("can").model_copy(update={"name": "second", "xy": (0.2, 0.3)})
    head, rows = scored(view, scene.model_copy(update={"objects": (*scene.objects, can)}))
    assert head.extra == 1 and rows["second"].true_object == ""


def test_scale_of_the_whole_scene_is_no_error(sample):
    """Everything 1.3 times as large, about the camera, which a photograph leaves open."""
    view, scene = view_of(sample), desk()
    objects = tuple(
        o.model_copy(
            update={
                "spec": scale(o.spec, 1.3),
                "xy": tuple(1.3 * value for value in o.xy),
                "z": 1.3 * o.z,
            }
        )
        for o in scene.objects
    )
    camera = scene.camera.model_copy(update={"height": 1.3 * scene.camera.height})
    grown = scene.model_copy(update={"objects": objects, "camera": camera})
    for align in ("scale", "depth", "objects"):
        head, rows = scored(view, grown, align)
        assert head.scale == pytest.approx(1 / 1.3, rel=2e-3)
        assert all(rows[name].add_s < 2e-3 for name in NAMES.values())
    _, rows = scored(view, grown, "none")
    assert all(rows[name].add_s > 0.3 for name in NAMES.values())


def test_objects_are_matched_in_the_image_and_by_name(sample):
    view, scene = view_of(sample), desk()
    _, rows = scored(view, scene, matches={})
    assert {rows[name].object: name for name in NAMES.values()} == NAMES
    renamed = changed(scene, "block", name="obj_000003")
    renamed = changed(renamed, "can", name="obj_000001")
    _, rows = scored(view, renamed, matches={})
    assert rows["obj_000003"].add_s > 1
    with pytest.raises(SpecError, match="matches: got 'mug'"):
        scored(view, scene, matches={"mug": "obj_000001"})
    with pytest.raises(SpecError, match="two pairs"):
        scored(view, scene, matches={"block": "obj_000001", "can": "obj_000001"})


def into_camera(camera: Camera) -> np.ndarray:
    """Return the transform [4, 4] from the world's frame to a camera's."""
    into = np.eye(4)
    into[:3, :3] = camera.axes().T
    into[:3, 3] = -into[:3, :3] @ camera.position()
    return into


def test_meshes_in_the_views_camera_frame_are_scored(sample, tmp_path):
    """The off-center camera of the second image draws it."""
    view = view_of(sample, "000007_000004")
    scene = desk(OTHER)
    into = into_camera(scene.camera)
    file = write_poses(tmp_path, scene, into=into, names=list(NAMES), frame="camera")
    read = import_file(file)
    assert isinstance(read, ImportedScene)
    head, rows = scored(view, read.spec)
    assert head.matched == 3
    for name in NAMES.values():
        assert rows[name].add_s < 1e-5 and rows[name].error_mm < 0.1


def test_leveled_meshes_in_the_views_camera_frame_are_scored(sample, tmp_path):
    """With its vertical, the scene stands level, and is where the view sees it."""
    view = view_of(sample, "000007_000004")
    scene = desk(OTHER)
    into = into_camera(scene.camera)
    up = into[:3, 2].tolist()
    names = [*NAMES, "table"]
    write_poses(tmp_path / view.name, scene, into=into, names=names, frame="camera", up=up)
    (tmp_path / view.name / "matches.json").write_text(json.dumps({"matches": NAMES}))
    made = submitted_view(tmp_path, view.name)
    assert made.scene.gravity == (0, 0, -9.81)
    for item in made.scene.objects:
        assert item.base_tilt == pytest.approx((1, 0, 0, 0), abs=1e-9)
    head, rows = real_rows(view, made, "none", QUICK, volumes=False)
    assert head.matched == 3 and head.max_tilt_deg < 1
    by_name = {row.true_object: row for row in rows}
    for name in NAMES.values():
        assert by_name[name].add_s < 1e-5 and by_name[name].error_mm < 0.1


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


def test_meters_and_repeated_and_hidden_objects(tmp_path):
    folder = write_bop(tmp_path / "desk", [desk()], models="models_m", unit_mm=1e3, split="scenes")
    place = folder / "scenes" / "000007"
    poses = json.loads((place / "scene_gt.json").read_text())
    poses["3"] = [poses["3"][0], poses["3"][0], poses["3"][1]]
    (place / "scene_gt.json").write_text(json.dumps(poses))
    info = {"3": [{"visib_fract": share} for share in (1.0, 0.4, 0.05)]}
    (place / "scene_gt_info.json").write_text(json.dumps(info))
    (view,) = bop_views(folder, ["000007_000003"])
    assert [item.name for item in view.objects] == ["obj_000001", "obj_000001_2"]
    assert np.ptp(view.objects[0].vertices, axis=0) == pytest.approx([0.06, 0.05, 0.1])
    # A scene's own folder is data, too.
    (alone,) = bop_views(place, ["000007_000003"])
    assert alone.objects[0].diameter == view.objects[0].diameter


def test_depth_folder_and_its_camera(tmp_path):
    camera = write_depth_folder(tmp_path / "depth", desk())
    (view,) = depth_views(tmp_path / "depth", ["desk", "other"])
    assert view.camera == camera and view.size == SIZE and view.objects == ()
    head, rows = scored(view, desk(), "depth", {})
    assert head.scale == pytest.approx(1, abs=1e-3) and head.extra == 0
    assert all(row.error_mm < 0.3 for row in rows.values())
    (tmp_path / "depth" / "camera.json").unlink()
    with pytest.raises(SpecError, match="--intrinsics"):
        list(depth_views(tmp_path / "depth", ["desk"]))
    given = list(
        depth_views(tmp_path / "depth", ["desk"], intrinsics=tuple(camera), depth_scale=0.2)
    )
    assert np.allclose(given[0].depth, 2 * view.depth)


def write_run(folder: Path, scene: SceneSpec, moved: SceneSpec) -> Path:
    (folder / "compose").mkdir(parents=True)
    (folder / "compose" / "scene.json").write_text(moved.to_json())
    (folder / "scene.json").write_text(scene.to_json())
    return folder


def test_command_scores_every_stage_and_keeps_rows(tmp_path, capfd):
    scene = desk()
    write_depth_folder(tmp_path / "data", scene)
    x, y = scene.object("block").xy
    pushed = changed(scene, "block", xy=(x + 0.03, y))
    run = write_run(tmp_path / "runs" / "desk", scene, pushed)
    out = tmp_path / "rows"
    command = ["bench", "run", "real-poses", str(tmp_path / "data"), "--json"]
    command += ["--runs", str(tmp_path / "runs"), "--out", str(out)]
    command += ["--set", "refine.check_duration_s=0.1"]
    with pytest.raises(SystemExit, match="0"):
        cli.main(command)
    result = json.loads(capfd.readouterr().out)
    assert [row["stage"] for row in result["views"]] == ["composed", "refined"]
    errors = {(row["stage"], row["object"]): row["error_mm"] for row in result["rows"]}
    assert errors["composed", "block"] > 5 and errors["refined", "block"] < 0.3
    assert result["figures"]["ours refined"]["median_error_mm"]["n"] == 4
    assert "add_s" not in result["figures"]["ours refined"]
    # Aligned is what compose/align.json says; rows of the view replace the former ones.
    (run / "compose" / "align.json").write_text("{}")
    score_real_views(tmp_path / "data", runs=[run], options=QUICK, out=out)
    views, rows = stored_real_rows(out)
    assert [row.stage for row in views] == ["aligned", "refined"] and len(rows) == 8
    write_tables(out)
    table = (out / "real.csv").read_text().splitlines()
    assert table[0].startswith("view,method,stage,object,pixels,error mm,depth mm,bias mm,collider")
    assert table[2].split(",")[:4] == ["desk", "ours", "aligned", "block"]
    assert table[-1].startswith("median,ours,refined,4 rows")


def test_table_has_the_recall(sample):
    scene = without(desk(), "can")
    matches = {name: other for name, other in NAMES.items() if name != "can"}
    _, rows = scored(view_of(sample), scene, matches=matches)
    table = real_table(list(rows.values()))
    assert table.head[-1] == "ADD-S < 0.1"
    assert [line[-1] for line in table.rows] == ["", "yes", "yes", "no", "67 % [3]"]
    assert table.rows[3][3] == "obj_000003 (missed)"


def test_command_refuses_what_it_cannot_score(tmp_path):
    with pytest.raises(ConfigError, match="--runs"):
        score_real_views(tmp_path)
    data, runs = tmp_path / "data", tmp_path / "runs"
    data.mkdir()
    (runs / "office").mkdir(parents=True)
    with pytest.raises(SpecError, match="none of these formats"):
        score_real_views(data, runs=[runs])
    write_depth_folder(data, desk())
    with pytest.raises(SpecError, match="no view with a reconstruction is named runs, office"):
        score_real_views(data, runs=[runs])
    with pytest.raises(SpecError, match="is no folder"):
        score_real_views(data, runs=[tmp_path / "absent"])
    wide = desk(Camera(width=320, height_px=120, fovy=0.7, height=0.5, pitch=0.6))
    write_run(runs / "desk", wide, wide)
    with pytest.raises(SpecError, match="expected is the same aspect"):
        score_real_views(data, runs=[runs])


def write_estimates(file: Path, scene: SceneSpec, lines=()) -> Path:
    """Write the true poses of the block and the can in BOP's results format, and other lines."""
    rows = ["scene_id,im_id,obj_id,score,R,t,time"]
    for number, name in ((1, "block"), (3, "can")):
        pose = camera_pose(scene, name)
        turn = " ".join(map(str, pose[:3, :3].reshape(-1)))
        shift = " ".join(map(str, 1e3 * pose[:3, 3]))
        rows.append(f"7,3,{number},0.9,{turn},{shift},0.1")
    file.write_text("\n".join([*rows, *lines]) + "\n")
    return file


def test_estimates_of_bop_have_add_and_recall(sample, tmp_path, capfd):
    scene = desk()
    pose = camera_pose(scene, "carton")
    turn = " ".join(map(str, pose[:3, :3].reshape(-1)))
    off = " ".join(map(str, 1e3 * pose[:3, 3] + [30, 0, 0]))
    wrong = f"7,3,1,0.2,{turn},{off},0.1"  # A second block, which the image does not have.
    file = write_estimates(tmp_path / "ours.csv", scene, [f"7,3,2,0.5,{turn},{off},0.1", wrong])
    rows = {row.object: row for row in estimate_rows(sample, file)}
    assert {row.method for row in rows.values()} == {"poses:ours"}
    diameter = math.hypot(0.12, 0.07, 0.05)
    assert rows["obj_000002"].add == pytest.approx(0.03 / diameter, rel=1e-6)
    assert rows["obj_000002"].position_mm == pytest.approx(30)
    assert 0 < rows["obj_000002"].adi <= rows["obj_000002"].add
    assert rows["obj_000001"].add < 1e-6 and rows["obj_000003"].adi < 1e-6
    figures = estimate_figures(list(rows.values()))
    assert figures["missed"] == 0 and figures["add_recall_0.1d"] == pytest.approx(2 / 3)
    missed = list(estimate_rows(sample, write_estimates(tmp_path / "few.csv", scene)))
    assert estimate_figures(missed)["missed"] == 1
    assert estimate_figures(missed)["add_s_recall_0.1d"] == pytest.approx(2 / 3)
    with pytest.raises(SystemExit, match="0"):
        cli.main(["bench", "run", "real-poses", str(sample), "--poses", str(file), "--json"])
    result = json.loads(capfd.readouterr().out)
    assert result["pose_figures"]["true_objects"] == 3 and len(result["poses"]) == 3


def test_targets_of_bop_count_though_nothing_is_estimated_for_them(tmp_path):
    """An image without estimates is missed, and a model that is no target does not count."""
    folder = write_bop(tmp_path / "desk", [desk(), desk()])
    images = sorted(json.loads((folder / "test" / "000007" / "scene_gt.json").read_text()), key=int)
    other = next(int(image) for image in images if image != "3")
    targets = [
        {"scene_id": 7, "im_id": image, "obj_id": model, "inst_count": 1}
        for image, model in ((3, 1), (3, 3), (other, 2))
    ]
    estimates = write_estimates(tmp_path / "a.csv", desk())
    assert len(list(estimate_rows(folder, estimates))) == 3  # Without a list: all of image 3.
    (folder / "test_targets_bop19.json").write_text(json.dumps(targets))
    rows = {(row.view, row.object): row for row in estimate_rows(folder, estimates)}
    missed = f"000007_{other:06d}", "obj_000002"
    assert set(rows) == {("000007_000003", f"obj_{k:06d}") for k in (1, 3)} | {missed}
    assert rows.pop(missed).add is None and all(row.add < 1e-6 for row in rows.values())
    (folder / "test_targets_bop19.json").write_text('[{"scene_id": 7, "im_id": 3}]')
    with pytest.raises(SpecError, match="target 0: obj_id must be 1 number"):
        list(estimate_rows(folder, estimates))


def test_instances_of_a_model_are_paired(tmp_path):
    folder = write_bop(tmp_path / "desk", [desk()])
    file = folder / "test" / "000007" / "scene_gt.json"
    poses = json.loads(file.read_text())
    other = {**poses["3"][0], "cam_t_m2c": poses["3"][2]["cam_t_m2c"]}
    file.write_text(json.dumps({"3": [other, poses["3"][0]]}))
    estimates = write_estimates(tmp_path / "a.csv", desk())
    estimates.write_text(estimates.read_text().replace("7,3,3,", "7,3,1,"))
    rows = list(estimate_rows(folder, estimates))
    assert [row.object for row in rows] == ["obj_000001", "obj_000001_2"]
    assert rows[0].position_mm < 1e-6 and rows[1].add < 1e-6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scene_id,im_id\n", "must name scene_id"),
        ("scene_id,im_id,obj_id,score,R,t,time\n7,3,1,a,1,2,0\n", "line 2.*no number"),
        ("scene_id,im_id,obj_id,score,R,t,time\n7,3,1,1,1 2,0 0 0,0\n", "R must be nine"),
        ("scene_id,im_id,obj_id,score,R,t,time\n7,3,1,1,1 1 1 1 1 1 1 1 1,0 0 0,0\n", "orthon"),
        ("scene_id,im_id,obj_id,score,R,t,time\n8,3,1,1,1 0 0 0 1 0 0 0 1,0 0 0,0\n", "none of"),
    ],
)
def test_broken_results_give_one_error(sample, tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(SpecError, match=message):
        list(estimate_rows(sample, tmp_path / "a.csv"))


def test_submission_is_scored_by_the_same_code(tmp_path):
    write_depth_folder(tmp_path / "data", desk())
    other = tmp_path / "boxes" / "desk"
    other.mkdir(parents=True)
    (other / "scene.json").write_text(desk().to_json())
    views, rows = score_real_views(tmp_path / "data", submission=tmp_path / "boxes", options=QUICK)
    assert [(row.method, row.stage) for row in views] == [("submission:boxes", "submitted")]
    assert all(row.error_mm < 0.3 for row in rows)
