"""Samples in the layouts of MessyKitchens and Aria Digital Twin, which the tests write."""

import json
from pathlib import Path

import numpy as np
import pytest
from neoworld_bench.real_poses.aria_twin import BOX_COLUMNS, POSE_COLUMNS, aria_views
from neoworld_bench.real_poses.made_views import MadeView
from neoworld_bench.real_poses.messy_kitchens import messy_views
from neoworld_bench.real_poses.pose_rows import posed_meshes, real_rows
from neoworld_bench.real_poses.real_views import format_of, score_real_views

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.errors import SpecError
from neoworld_mjx.render import visible_surface
from neoworld_mjx.spec import SceneSpec, bounds, world_poses
from neoworld_mjx.spec.pose import matrix
from tests.support.bop_sample import desk, write_ply

QUICK = RefineOptions(check_duration_s=0.1)
TURN = np.array([[0.6, -0.8, 0, 0.3], [0.8, 0.6, 0, -0.2], [0, 0, 1, 0.5], [0, 0, 0, 1]])
"""World of the data in that of the scene."""


def movable(scene: SceneSpec):
    return [item for item in scene.objects if not item.environment]


def world_matrix(scene: SceneSpec, name: str) -> np.ndarray:
    pose, result = world_poses(scene)[name], np.eye(4)
    result[:3, :3], result[:3, 3] = matrix(pose.quat), pose.pos
    return TURN @ result


def write_kitchen(folder: Path, scene: SceneSpec) -> Path:
    place = folder / "scenes" / "easy" / "scene_1"
    place.mkdir(parents=True)
    (folder / "object_models").mkdir()
    poses = {}
    for item in movable(scene):
        write_ply(folder / "object_models" / f"{item.name}.ply", *visible_surface(item.spec))
        poses[item.name] = world_matrix(scene, item.name).tolist()
    (place / "poses.json").write_text(json.dumps(poses))
    return folder


def write_recording(folder: Path, scene: SceneSpec, pushed: dict[str, float] | None = None) -> Path:
    """Write a recording in which objects are static, or move along x from 1000 to 2000 ns."""
    folder.mkdir(parents=True)
    poses = [",".join(("object_uid", "timestamp[ns]", *POSE_COLUMNS))]
    boxes = [",".join(("object_uid", "timestamp[ns]", *BOX_COLUMNS))]
    seen = ["stream_id,object_uid,timestamp[ns],visibility_ratio[%]"]
    instances = {}
    for uid, item in enumerate(movable(scene), start=100):
        pose = world_poses(scene)[item.name]
        push = (pushed or {}).get(item.name)
        times = [(-1, 0.0)] if push is None else [(1000, 0.0), (2000, push)]
        for time, x in times:
            values = [*(pose.pos + [x, 0, 0]).tolist(), *pose.quat.tolist()]
            poses.append(",".join(map(repr, (uid, time, *values))))
        low, high = bounds(item.spec)
        sides = [value for pair in zip(low, high, strict=True) for value in pair]
        boxes.append(",".join(map(str, (uid, -1, *sides))))
        instances[str(uid)] = {"instance_name": item.name, "instance_type": "object"}
        seen += [
            f"214-1,{uid},{time},{0.9 if item.name != 'can' else 0.02}" for time in (1000, 2000)
        ]
        seen.append(f"1201-1,{uid},1000,1.0")
    (folder / "scene_objects.csv").write_text("\n".join(poses) + "\n")
    (folder / "3d_bounding_box.csv").write_text("\n".join(boxes) + "\n")
    (folder / "instances.json").write_text(json.dumps(instances))
    (folder / "2d_bounding_box.csv").write_text("\n".join(seen) + "\n")
    return folder


def test_kitchen_is_perfect_whatever_its_world(tmp_path):
    data = write_kitchen(tmp_path / "kitchens", desk())
    assert format_of(data) == "messy-kitchens"
    (view,) = messy_views(data, ["easy_scene_1", "hard_scene_1"])
    assert view.name == "easy_scene_1" and view.camera is None
    head, rows = real_rows(
        view, MadeView("ours", "refined", desk(), {}), "auto", QUICK, volumes=False
    )
    assert head.align == "objects" and head.matched == 3
    assert head.scale == pytest.approx(1) and head.rotation_deg == pytest.approx(53.13, abs=0.01)
    for row in rows:
        if row.true_object:
            assert row.add_s < 1e-6 and row.icp_rot_deg < 1e-3 and row.box_iou > 1 - 1e-6
            assert row.error_mm is None
    run = tmp_path / "runs" / "easy_scene_1"
    run.mkdir(parents=True)
    (run / "scene.json").write_text(desk().to_json())
    views, _ = score_real_views(data, runs=[tmp_path / "runs"], options=QUICK, volumes=False)
    assert [row.matched for row in views] == [3]
    with pytest.raises(SpecError, match="--align scale needs a camera"):
        score_real_views(data, runs=[tmp_path / "runs"], options=QUICK, align="scale")


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        ({"mug": np.eye(4).tolist()}, "no .*mug.ply"),
        ({"../block": np.eye(4).tolist()}, "no .*block.ply"),
        ({"block": [[1, 2]]}, "4x4 matrices"),
        ({"block": {"translation": [0, 0, 0]}}, "4x4 matrices"),
        ({"block": (2 * np.eye(4)).tolist()}, "orthonormal"),
    ],
)
def test_kitchen_with_other_poses_is_refused(tmp_path, poses, message):
    data = write_kitchen(tmp_path / "kitchens", desk())
    (data / "scenes" / "easy" / "scene_1" / "poses.json").write_text(json.dumps(poses))
    with pytest.raises(SpecError, match=message):
        list(messy_views(data, ["easy_scene_1"]))


def test_copies_of_a_model_have_a_number(tmp_path):
    data = write_kitchen(tmp_path / "kitchens", desk())
    file = data / "scenes" / "easy" / "scene_1" / "poses.json"
    file.write_text(json.dumps({name: np.eye(4).tolist() for name in ("block", "block_2")}))
    (view,) = messy_views(data, ["easy_scene_1"])
    assert [item.name for item in view.objects] == ["block", "block_2"]


def test_objects_of_unknown_visibility_are_not_seen(tmp_path):
    """Recordings have lines without a number where an object is out of view."""
    data = write_recording(tmp_path / "Apartment_seq1", desk())
    file = data / "2d_bounding_box.csv"
    lines = file.read_text().splitlines()
    uid = next(line.split(",")[1] for line in lines[1:] if line.endswith("0.9"))
    for text in ("", "None"):
        changed = [
            f"{line.rpartition(',')[0]},{text}" if f",{uid}," in line else line for line in lines
        ]
        file.write_text("\n".join(changed) + "\n")
        (view,) = aria_views(tmp_path, ["Apartment_seq1_1000"])
        assert len(view.objects) == 1


def test_boxes_of_a_recording_are_those_of_the_scene(tmp_path):
    data = write_recording(tmp_path / "Apartment_seq1", desk())
    (data / "2d_bounding_box.csv").unlink()
    assert format_of(data) == "aria-twin" and format_of(tmp_path) == "aria-twin"
    (view,) = aria_views(tmp_path, ["Apartment_seq1"])
    own = posed_meshes(desk(), None)
    for item in view.objects:
        low, high = own[item.name].vertices.min(axis=0), own[item.name].vertices.max(axis=0)
        # A can's vertices do not reach its box's corners once it is turned; the blocks' do.
        tolerance = 2e-3 if item.name == "can" else 1e-9
        assert np.allclose(item.posed.min(axis=0), low, atol=tolerance)
        assert np.allclose(item.posed.max(axis=0), high, atol=tolerance)
    head, rows = real_rows(view, MadeView("ours", "refined", desk(), {}), "none", QUICK)
    assert head.matched == 3
    for row in (row for row in rows if row.true_object):
        assert row.box_iou > 0.97 and row.position_mm < 1
        # No mesh: what needs a surface is left out.
        assert row.add_s is None and row.icp_rot_deg is None and row.voxel_iou is None


def test_time_and_visibility_of_a_recording(tmp_path):
    write_recording(tmp_path / "seq", desk(), {"block": 0.2})
    names = ["seq", "seq_1400", "seq_1900", "sequence_1"]
    first, early, late = aria_views(tmp_path, names)
    assert [view.name for view in (first, early, late)] == ["seq", "seq_1400", "seq_1900"]
    assert [item.name for item in late.objects] == ["block", "carton"]
    shift = late.objects[0].pose[:3, 3] - early.objects[0].pose[:3, 3]
    assert shift == pytest.approx([0.2, 0, 0])
    assert np.allclose(early.objects[1].pose, late.objects[1].pose)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("scene_objects.csv", lambda t: t.replace("q_wo_w", "q"), "no column q_wo_w"),
        ("scene_objects.csv", lambda t: t.replace("100,-1,", "100,soon,"), "line 2.*no number"),
        ("3d_bounding_box.csv", lambda t: t.replace("100,-1,", "100,-1,nan,"), "line 2.*finite"),
        ("instances.json", lambda t: "[]", "JSON object"),
    ],
)
def test_broken_recordings_give_one_error(tmp_path, file, change, message):
    data = write_recording(tmp_path / "seq", desk())
    (data / file).write_text(change((data / file).read_text()))
    with pytest.raises(SpecError, match=message):
        list(aria_views(data, ["seq"]))
