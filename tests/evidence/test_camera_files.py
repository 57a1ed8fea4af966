"""Files of calibrated cameras: every format gives the same camera."""

import json
import math

import numpy as np
import pytest
import yaml

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.camera_files import read_base, read_camera
from neoworld_mjx.evidence.file_camera import FileCamera, known_camera
from neoworld_mjx.spec import Camera
from neoworld_mjx.spec.pose import from_matrix

FX, FY, CX, CY = 610.0, 611.0, 321.5, 244.0
SIZE = (640, 480)
K = [[FX, 0, CX], [0, FY, CY], [0, 0, 1]]
GIVEN = Camera(
    width=640,
    height_px=480,
    fovy=2 * math.atan(240 / 610.5),
    height=0.8,
    pitch=0.6,
    roll=0.07,
    xy=(0.4, -0.3),
    yaw=1.1,
)
TO_OPENGL = np.diag([1, -1, -1, 1])


def pose_of(camera: Camera) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.axes(), camera.position()
    return matrix


def own(path):
    path.write_text(
        json.dumps({"width": 640, "height": 480, "fx": FX, "fy": FY, "cx": CX, "cy": CY})
    )


def own_yaml(path):
    path.write_text(f"fx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n")


def ros(path):
    info = {
        "image_width": 640,
        "image_height": 480,
        "camera_name": "color",
        "camera_matrix": {"rows": 3, "cols": 3, "data": np.ravel(K).tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": np.eye(3).ravel().tolist()},
    }
    path.write_text(yaml.safe_dump(info))


def ros_message(path):
    message = {"width": 640, "height": 480, "distortion_model": "plumb_bob", "D": [], "K": K}
    path.write_text(json.dumps(message))


def realsense(path):
    path.write_text(
        json.dumps(
            {"width": 640, "height": 480, "ppx": CX, "ppy": CY, "fx": FX, "fy": FY}
            | {"model": "distortion.inverse_brown_conrady", "coeffs": [0, 0, 0, 0, 0]}
        )
    )


def bop(path):
    images = {str(k): {"cam_K": np.ravel(K).tolist(), "depth_scale": 0.1} for k in (3, 7)}
    path.write_text(json.dumps(images))


def nerfstudio(path):
    frame = {"file_path": "images/frame_7.png", "transform_matrix": np.eye(4).tolist()}
    lens = {"fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5, "w": 640, "h": 480}
    path.write_text(json.dumps({**lens, "frames": [frame]}))


def colmap(path):
    path.write_text(f"# cameras\n1 PINHOLE 640 480 {FX} {FY} {CX + 0.5} {CY + 0.5}\n")


def matrix_npy(path):
    np.save(path, np.array(K))


def matrix_txt(path):
    path.write_text("\n".join(" ".join(map(str, row)) for row in K))


def matrix_csv(path):
    path.write_text("\n".join(", ".join(map(str, row)) for row in K))


FILES = {
    "camera.json": own,
    "camera.yaml": own_yaml,
    "info.yaml": ros,
    "message.json": ros_message,
    "color.json": realsense,
    "scene_camera.json": bop,
    "transforms.json": nerfstudio,
    "cameras.txt": colmap,
    "K.npy": matrix_npy,
    "cam_K.txt": matrix_txt,
    "camera_matrix.csv": matrix_csv,
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_gives_the_same_camera(tmp_path, name):
    FILES[name](tmp_path / name)
    known, lens = known_camera(read_camera(tmp_path / name, "frame_7.png"), SIZE, name)
    assert lens is None and known.focal == pytest.approx(610.5)
    assert known.principal == pytest.approx((CX + 0.5 - 320, CY + 0.5 - 240))
    assert known.pitch is None and known.base is None


def with_pose(folder, kind):
    """Write the pose of GIVEN in one of the formats; return the file."""
    matrix = pose_of(GIVEN)
    lens = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
    inverse = np.linalg.inv(matrix)
    if kind == "own":
        file, value = folder / "camera.json", lens | {"pose": matrix.tolist()}
    elif kind == "opengl":
        pose = (matrix @ TO_OPENGL).tolist()
        file, value = folder / "camera.json", lens | {"pose": pose, "axes": "opengl"}
    elif kind == "nerfstudio":
        frames = [
            {"file_path": "a/other.jpg", "transform_matrix": np.eye(4).tolist()},
            {"file_path": "a/photo.jpg", "transform_matrix": (matrix @ TO_OPENGL).tolist()},
        ]
        value = {"fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5, "frames": frames}
        file = folder / "transforms.json"
    elif kind == "bop":
        pose = {"cam_R_w2c": np.ravel(inverse[:3, :3]).tolist()}
        pose |= {"cam_t_w2c": (1000 * inverse[:3, 3]).tolist()}
        file, value = folder / "scene_camera.json", {"12": {"cam_K": np.ravel(K).tolist(), **pose}}
    elif kind == "colmap":
        w, x, y, z = from_matrix(inverse[:3, :3])
        t = " ".join(map(str, inverse[:3, 3]))
        (folder / "cameras.txt").write_text(
            f"1 SIMPLE_PINHOLE 640 480 900 320 240\n2 PINHOLE 640 480 {FX} {FY} 322 244.5\n"
        )
        (folder / "images.txt").write_text(
            f"# images\n1 1 0 0 0 0 0 0 1 other.png\n10.5 20.5 -1\n"
            f"2 {w} {x} {y} {z} {t} 2 photo.png\n1.0 2.0 3 4.0 5.0 6 7.0 8.0 9 10.0\n"
        )
        return folder
    elif kind == "npy":
        np.save(folder / "pose.npy", matrix)
        return folder / "pose.npy"
    else:
        (folder / "pose.txt").write_text("\n".join(" ".join(map(str, row)) for row in matrix))
        return folder / "pose.txt"
    file.write_text(json.dumps(value))
    return file


@pytest.mark.parametrize("kind", ["own", "opengl", "nerfstudio", "bop", "colmap", "npy", "txt"])
def test_pose_gives_angles_and_the_place_in_the_base_frame(tmp_path, kind):
    photo = "000012.png" if kind == "bop" else "photo.png"
    file = with_pose(tmp_path, kind)
    base = read_base(file, photo).model_copy(update={"ground": 0.05})
    camera = FileCamera(fx=FX, fy=FY, cx=CX, cy=CY).completed_by(base)
    known, _ = known_camera(camera, SIZE, "pose")
    assert known.pitch == pytest.approx(0.6) and known.roll == pytest.approx(0.07)
    assert known.base == pytest.approx((0.4, -0.3, 0.8)) and known.heading == pytest.approx(1.1)
    assert known.height == pytest.approx(0.75)


@pytest.mark.parametrize("kind", ["nerfstudio", "bop", "colmap"])
def test_worlds_of_reconstructions_are_no_base_frame_unless_given_as_one(tmp_path, kind):
    camera = read_camera(with_pose(tmp_path, kind), "12.png" if kind == "bop" else "photo.png")
    assert camera.pose is None and camera.fx == FX


@pytest.mark.parametrize(
    ("size", "reason"), [((640, 400), "cropped"), ((480, 640), "turned by 90 degrees")]
)
def test_crops_and_turned_photographs_are_refused_with_the_reason(tmp_path, size, reason):
    own(tmp_path / "camera.json")
    with pytest.raises(EvidenceError, match=f"640 x 480.*{size[0]} x {size[1]}.*{reason}"):
        known_camera(read_camera(tmp_path / "camera.json"), size, "camera.json")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", '{"fov": 3}', "unknown key fov"),
        ("a.json", "[[1, 2], [3]]", "not a matrix"),
        ("a.json", '{"camera_matrix": {"rows": 3}}', "no 'data'"),
        ("a.json", '{"frames": []}', "no fl_x"),
        ("a.yaml", "a: [", "not valid YAML"),
        ("a.yaml", "just text", "holds a str"),
        ("a.txt", "1 2 3", "K is 3 x 3"),
        ("a.txt", "1 two 3", "not a matrix of numbers"),
        ("a.xml", "<a/>", ".json, .yaml, .npy, .txt or .csv"),
        ("cameras.txt", "1 OPENCV_STEREO 640 480 1 2 3", "choices: SIMPLE_PINHOLE"),
        ("cameras.txt", "1 PINHOLE 640 480 1 2 3", "camera 1 is not PINHOLE with fx fy cx cy"),
    ],
)
def test_broken_files_give_one_message(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(EvidenceError, match=message) as error:
        read_camera(tmp_path / name, "photo.png")
    assert name in str(error.value) and "\n" not in str(error.value)


def test_photograph_that_is_not_in_the_file_is_named(tmp_path):
    with pytest.raises(EvidenceError, match=r"2 images \(a/other.jpg, a/photo.jpg\), none.*IMG"):
        read_camera(with_pose(tmp_path, "nerfstudio"), "IMG_1.jpg")


def test_an_image_that_is_not_in_a_file_has_the_camera_that_all_others_share(tmp_path):
    path = tmp_path / "scene_camera.json"
    bop(path)
    assert read_camera(path, "000012.png").fx == FX
    images = json.loads(path.read_text())
    images["7"]["cam_K"][0] = 2 * FX
    path.write_text(json.dumps(images))
    with pytest.raises(EvidenceError, match=r"2 images \(3, 7\), none with the number of 000012"):
        read_camera(path, "000012.png")


@pytest.mark.parametrize("size", [(640, 250), (500, 500)])
def test_a_photograph_of_any_shape_may_have_square_pixels(size):
    middle = {"cx": size[0] / 2 - 0.5, "cy": size[1] / 2 - 0.5}
    known, lens = known_camera(FileCamera(fx=600, fy=600, **middle), size, "own")
    assert lens is None and known.focal == 600


def test_a_field_of_view_is_that_of_the_height():
    known, lens = known_camera(FileCamera(fovy=math.radians(60)), SIZE, "own")
    assert lens is None and known.focal == pytest.approx(240 / math.tan(math.radians(30)))
