"""Wrong evidence is refused in one line that names the likely cause."""

import json
import math

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.consistency import check_distances, check_evidence
from neoworld_mjx.evidence.depth_image import DepthImage
from neoworld_mjx.evidence.evidence import Evidence
from neoworld_mjx.evidence.evidence_file import StatedEvidence, evidence_of
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.spec import Box2D, Camera
from tests.evidence.test_known_camera import tree as response
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


DOWN = (GIVEN.axes().T @ [0, 0, -9.81]).tolist()
FARTHER = np.array([[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]])
UP = (GIVEN.axes().T @ [0, 0, 9.81]).tolist()


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


def read(stated):
    return evidence_of(StatedEvidence(**stated), "photo.png", picture(), (WIDTH, HEIGHT))


def lens(**more):
    return LENS | {"pose": pose().tolist()} | more


def posed(matrix):
    return lens(pose=matrix.tolist())


def of_another_photograph():
    other = np.where(np.isfinite(depth()[:, ::-1]), 1.2, np.nan)
    for left, top in ((20, 20), (110, 170), (200, 40), (120, 30)):
        other[top : top + 50, left : left + 26] = 0.7
    return other


def not_registered():
    values = np.full((HEIGHT, WIDTH), np.nan)
    values[12:, 26:] = depth()[:-12, :-26]
    return values


def tilted_base():
    tilted, level = np.eye(4), np.eye(4)
    tilted[:3, :3] = Camera(width=2, height_px=2, fovy=1, height=0, pitch=0.2).axes()
    level[:3, :3] = Camera(width=2, height_px=2, fovy=1, height=0, pitch=0).axes()
    return tilted @ np.linalg.inv(level) @ pose()


def test_right_evidence_is_accepted(tmp_path):
    stated = {
        "camera": written(tmp_path, "camera.json", lens()),
        "gravity": DOWN,
        "ground": 0.0,
        "depth": written(tmp_path, "depth.png", millimeters()),
        "masks": written(tmp_path, "masks.png", labels()),
    }
    found = read(stated)
    assert found.camera.height == pytest.approx(0.7) and found.depth is not None
    assert found.masks is not None and found.lens is None
    unchecked = written(tmp_path, "other.npy", of_another_photograph())
    assert read({"depth": unchecked, "check": False}).depth is not None
    squeezed = written(tmp_path, "squeezed.json", LENS | {"fx": 225.0, "fy": 300.0})
    assert read({"camera": squeezed}).camera.size == (320, 180)  # 16:9, squeezed to 4:3.


FILES = {
    "millimeters as meters": (
        {"depth.npy": lambda: millimeters().astype(np.float32)},
        "median depth is .* m: its values are millimeters: give scale: 0.001",
    ),
    "axes of opengl": (
        {"camera.json": lambda: posed(pose() @ np.diag([1, -1, -1, 1]))},
        "looks up by 40 deg: the axes .* those of opengl: give axes: opengl",
    ),
    "axes of opencv": ({"camera.json": lambda: lens(axes="opengl")}, "give axes: opencv"),
    "inverse of the pose": (
        {"camera.json": lambda: posed(np.linalg.inv(pose()))},
        "from the base to the camera: give its inverse",
    ),
    "pose in millimeters": (
        {"camera.json": lambda: posed(pose() * FARTHER)},
        "768 m from the base: is the pose in millimeters",
    ),
    "ground above the camera": (
        {"camera.json": lambda: lens(ground=1.5)},
        "is 0.80 m below the ground",
    ),
    "scaled pose": (
        {"camera.json": lambda: posed(pose() @ np.diag([1.1, 1.1, 1.1, 1]))},
        "pose is not a rigid transform: it scales by 1.1",
    ),
    "mirrored pose": (
        {"camera.json": lambda: posed(pose() @ np.diag([1, 1, -1, 1]))},
        "it mirrors, so one axis has the wrong sign",
    ),
    "skewed pose": (
        {"camera.json": lambda: posed(pose() @ np.diag([1, 1, 0.9, 1]))},
        "its columns are no unit vectors at 90 deg",
    ),
    "transposed pose": (
        {"camera.json": lambda: posed(pose().T)},
        "its rows and columns are swapped",
    ),
    "another shape": (
        {"depth.png": lambda: millimeters()[:200]},
        "320 x 200 pixels and the photograph 320 x 240: it is of another view",
    ),
    "turned": ({"depth.png": lambda: np.rot90(millimeters()).copy()}, "turned by 90 degrees"),
    "another photograph": (
        {"depth.npy": of_another_photograph},
        "edges are not those of the photograph: it is of another photograph",
    ),
    "mirrored": ({"depth.npy": lambda: depth()[:, ::-1].copy()}, "flip it from left to right"),
    "upside down": ({"depth.npy": lambda: depth()[::-1].copy()}, "flip it upside down"),
    "half a turn": ({"depth.npy": lambda: depth()[::-1, ::-1].copy()}, "turned by 180 degrees"),
    "swapped fx and fy": (
        {"camera.json": lambda: LENS | {"fx": 300.0, "fy": 225.0}},
        "fx and fy are swapped",
    ),
    "focal length in millimeters": (
        {"camera.json": lambda: LENS | {"fx": 4.2, "fy": 4.2}},
        "field of view would be 17[0-9].* focal length in pixels",
    ),
    "depth that is not registered": (
        {"depth.npy": not_registered},
        "fit if it is moved 8 % left and 4 % up .* not registered",
    ),
    "gravity of the wrong sign": ({"gravity": UP}, "upside down or looks up .* change its sign"),
    "gravity against the pose": ({"camera.json": lens, "gravity": UP}, "change its sign"),
    "base frame that is not level": (
        {"camera.json": lambda: posed(tilted_base()), "gravity": DOWN},
        "disagree by 11.5 deg: z of the base frame",
    ),
    "empty masks": ({"masks.png": lambda: 0 * labels()}, "has no masks: all of its pixels are 0"),
}
"""Wrong evidence, by the name of its file, and the message about it."""


@pytest.mark.parametrize("kind", FILES)
def test_wrong_evidence_is_one_line_that_names_the_likely_cause(tmp_path, kind):
    given, message = FILES[kind]
    stated = {
        name.partition(".")[0]: written(tmp_path, name, value()) if callable(value) else value
        for name, value in given.items()
    }
    with pytest.raises(EvidenceError, match=message) as error:
        read(stated)
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_wrong_scales_and_masks_of_a_folder_are_named(tmp_path):
    stated = {"file": written(tmp_path, "depth.npy", depth()), "scale": 0.001}
    with pytest.raises(EvidenceError, match="its values are meters already: give scale: 1"):
        read({"depth": stated})
    units = np.nan_to_num(10_000 * depth()).astype(np.uint16)
    stated = {"file": written(tmp_path, "units.png", units), "scale": 0.001}
    camera = written(tmp_path, "camera.json", lens(ground=0.0))
    with pytest.raises(EvidenceError, match=r"times those of the ground seen from 0\.70 m"):
        read({"camera": camera, "depth": stated})
    (tmp_path / "masks").mkdir()
    written(tmp_path / "masks", "mug.png", 0 * labels())
    with pytest.raises(EvidenceError, match=r"mug\.png is empty"):
        read({"masks": str(tmp_path / "masks")})


def test_depths_are_compared_with_the_distances_of_the_response_at_any_size():
    """At half its size, at which only the boxes show something."""
    tree, values = response(), np.full((240, 320), np.nan)
    values[100:140, 150:200] = 1.0
    box = {"box2d": Box2D(x0=300.0, y0=200.0, x1=400.0, y1=280.0)}
    tree = tree.model_copy(update={"nodes": tuple(n.model_copy(update=box) for n in tree.nodes)})
    check_distances(DepthImage(values, "metric"), tree)
    with pytest.raises(EvidenceError, match=r"0\.00091 times the distances"):
        check_distances(DepthImage(0.001 * values, "metric"), tree)


def test_swapped_cx_and_cy(tmp_path):
    tall = np.ascontiguousarray(picture()[:, 100:220])
    camera = written(tmp_path, "camera.json", LENS | {"cx": 119.5, "cy": 59.5})
    with pytest.raises(EvidenceError, match="cx and cy are swapped"):
        evidence_of(StatedEvidence(camera=camera), "a.png", tall, (120, 240))


@pytest.mark.parametrize(
    ("masks", "message"),
    [
        (Masks(np.zeros((60, 80), int), {}, "array"), "array has no masks"),
        (Masks(np.ones((60, 80), int), {"cup": 1, "can": 2}, "array"), "masks of can are empty"),
    ],
)
def test_masks_that_are_no_file_are_checked(masks, message):
    with pytest.raises(EvidenceError, match=message):
        check_evidence(Evidence(masks=masks), np.zeros((60, 80, 3), np.uint8))
