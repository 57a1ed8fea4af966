"""Wrong evidence is refused in one line that names the likely cause."""

import json
import math

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.evidence_file import StatedEvidence, evidence_of
from neoworld_mjx.spec import Camera
from tests.support.made_up_view import HEIGHT, WIDTH, depth, labels, picture

LENS = {"fx": 300.0, "fy": 300.0, "cx": 159.5, "cy": 119.5}
GIVEN = Camera(
    width=WIDTH,
    height_px=HEIGHT,
    fovy=0.76,
    height=0.7,
    pitch=math.radians(40),
    roll=0.05,
    xy=(0.3, 0.1),
    yaw=0.8,
)


def pose():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = GIVEN.axes(), GIVEN.position()
    return matrix


def written(folder, name, values):
    path = folder / name
    if name.endswith(".npy"):
        np.save(path, values)
    elif name.endswith(".png"):
        Image.fromarray(values).save(path)
    else:
        path.write_text(json.dumps(values))
    return str(path)


def millimeters():
    return np.nan_to_num(1000 * depth()).astype(np.uint16)


def refused(stated, message):
    with pytest.raises(EvidenceError, match=message) as error:
        evidence_of(StatedEvidence(**stated), "photo.png", picture(), (WIDTH, HEIGHT))
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_right_evidence_is_accepted(tmp_path):
    stated = {
        "camera": written(tmp_path, "camera.json", LENS | {"pose": pose().tolist()}),
        "gravity": (GIVEN.axes().T @ [0, 0, -9.81]).tolist(),
        "ground": 0.0,
        "depth": written(tmp_path, "depth.png", millimeters()),
        "masks": written(tmp_path, "masks.png", labels()),
    }
    read = evidence_of(StatedEvidence(**stated), "photo.png", picture(), (WIDTH, HEIGHT))
    assert read.camera.height == pytest.approx(0.7) and read.depth is not None
    assert read.masks is not None and read.lens is None


def test_millimeters_as_meters(tmp_path):
    file = written(tmp_path, "depth.npy", millimeters().astype(np.float32))
    refused({"depth": file}, "median depth is .* m: its values are millimeters: give scale: 0.001")


def test_meters_as_millimeters(tmp_path):
    file = written(tmp_path, "depth.npy", depth())
    stated = {"file": file, "scale": 0.001}
    refused({"depth": stated}, "its values are meters already: give scale: 1")


def test_depths_that_contradict_the_height_of_the_camera(tmp_path):
    lens = LENS | {"pose": pose().tolist(), "ground": 0.0}
    units = np.nan_to_num(10_000 * depth()).astype(np.uint16)
    stated = {"file": written(tmp_path, "depth.png", units), "scale": 0.001}
    camera = written(tmp_path, "camera.json", lens)
    refused({"camera": camera, "depth": stated}, "times those of the ground seen from 0.70 m")


def test_axes_of_opengl_as_those_of_opencv(tmp_path):
    wrong = pose() @ np.diag([1, -1, -1, 1])
    camera = written(tmp_path, "camera.json", LENS | {"pose": wrong.tolist()})
    refused(
        {"camera": camera}, "looks up by 40 deg: the axes .* those of opengl: give axes: opengl"
    )


def test_axes_of_opencv_as_those_of_opengl(tmp_path):
    stated = LENS | {"pose": pose().tolist(), "axes": "opengl"}
    camera = written(tmp_path, "camera.json", stated)
    refused({"camera": camera}, "give axes: opencv")


def test_inverse_of_the_pose(tmp_path):
    camera = written(tmp_path, "camera.json", LENS | {"pose": np.linalg.inv(pose()).tolist()})
    refused({"camera": camera}, "from the base to the camera: give its inverse")


def test_pose_in_millimeters(tmp_path):
    wrong = pose()
    wrong[:3, 3] *= 1000
    camera = written(tmp_path, "camera.json", LENS | {"pose": wrong.tolist()})
    refused({"camera": camera}, "768 m from the base: is the pose in millimeters")


def test_ground_above_the_camera(tmp_path):
    camera = written(tmp_path, "camera.json", LENS | {"pose": pose().tolist(), "ground": 1.5})
    refused({"camera": camera}, "is 0.80 m below the ground")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.diag([1.1, 1.1, 1.1, 1]), "it scales by 1.1"),
        (np.diag([1, 1, -1, 1]), "it mirrors, so one axis has the wrong sign"),
        (np.diag([1, 1, 0.9, 1]), "its columns are no unit vectors at 90 deg"),
    ],
)
def test_pose_that_is_not_rigid(tmp_path, change, message):
    camera = written(tmp_path, "camera.json", LENS | {"pose": (pose() @ change).tolist()})
    refused({"camera": camera}, f"pose is not a rigid transform: {message}")


def test_transposed_pose(tmp_path):
    camera = written(tmp_path, "camera.json", LENS | {"pose": pose().T.tolist()})
    refused({"camera": camera}, "its rows and columns are swapped")


def test_image_of_another_shape(tmp_path):
    file = written(tmp_path, "depth.png", millimeters()[:200])
    refused({"depth": file}, "320 x 200 pixels and the photograph 320 x 240: it is of another view")
    file = written(tmp_path, "turned.png", np.rot90(millimeters()).copy())
    refused({"depth": file}, "turned by 90 degrees")


def test_depth_of_another_photograph(tmp_path):
    other = depth()[:, ::-1].copy()
    other = np.where(np.isfinite(other), 1.2, np.nan)
    for left, top in ((20, 20), (110, 170), (200, 40), (120, 30)):
        other[top : top + 50, left : left + 26] = 0.7
    file = written(tmp_path, "depth.npy", other)
    refused({"depth": file}, "edges are not those of the photograph: it is of another photograph")
    stated = StatedEvidence(depth=file, check=False)
    assert evidence_of(stated, "photo.png", picture(), (WIDTH, HEIGHT)).depth is not None


def test_swapped_fx_and_fy(tmp_path):
    """A picture of 16:9 that was squeezed to 4:3."""
    camera = written(tmp_path, "camera.json", LENS | {"fx": 300.0, "fy": 225.0})
    refused({"camera": camera}, "fx and fy are swapped")
    right = written(tmp_path, "right.json", LENS | {"fx": 225.0, "fy": 300.0})
    read = evidence_of(StatedEvidence(camera=right), "photo.png", picture(), (WIDTH, HEIGHT))
    assert read.camera.size == (320, 180)


def test_swapped_cx_and_cy(tmp_path):
    tall = np.ascontiguousarray(picture()[:, 100:220])
    camera = written(tmp_path, "camera.json", LENS | {"cx": 119.5, "cy": 59.5})
    with pytest.raises(EvidenceError, match="cx and cy are swapped"):
        evidence_of(StatedEvidence(camera=camera), "a.png", tall, (120, 240))


def test_focal_length_in_millimeters(tmp_path):
    camera = written(tmp_path, "camera.json", LENS | {"fx": 4.2, "fy": 4.2})
    refused({"camera": camera}, "field of view would be 17[0-9].* focal length in pixels")


def test_depth_that_is_not_registered(tmp_path):
    values = np.full((HEIGHT, WIDTH), np.nan)
    values[12:, 26:] = depth()[:-12, :-26]
    message = "fit if it is moved 8 % left and 4 % up .* not registered"
    refused({"depth": written(tmp_path, "depth.npy", values)}, message)


def test_gravity_of_the_wrong_sign(tmp_path):
    up = GIVEN.axes().T @ [0, 0, 9.81]
    refused({"gravity": up.tolist()}, "upside down or looks up .* change its sign")
    camera = written(tmp_path, "camera.json", LENS | {"pose": pose().tolist()})
    refused({"camera": camera, "gravity": up.tolist()}, "change its sign")


def test_base_frame_that_is_not_level(tmp_path):
    tilted = np.eye(4)
    tilted[:3, :3] = Camera(width=2, height_px=2, fovy=1, height=0, pitch=0.2).axes()
    level = np.eye(4)
    level[:3, :3] = Camera(width=2, height_px=2, fovy=1, height=0, pitch=0).axes()
    base = tilted @ np.linalg.inv(level) @ pose()
    camera = written(tmp_path, "camera.json", LENS | {"pose": base.tolist()})
    gravity = (GIVEN.axes().T @ [0, 0, -9.81]).tolist()
    refused({"camera": camera, "gravity": gravity}, "disagree by 11.5 deg: z of the base frame")


def test_empty_masks(tmp_path):
    file = written(tmp_path, "masks.png", 0 * labels())
    refused({"masks": file}, "has no masks: all of its pixels are 0")
    folder = tmp_path / "masks"
    folder.mkdir()
    written(folder, "mug.png", 0 * labels())
    refused({"masks": str(folder)}, "mug.png is empty")
